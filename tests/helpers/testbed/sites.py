"""A test bed with a cluster file on its laptop, and the verbs that work on it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml

from testbed.cloud import TestBed
from testbed.network import missing

CLUSTER = "bunny"
POINTS = Path(__file__).parents[3] / "examples/knot.ply"
OPTIONS = ("--grid", "48", "--backend", "zmq")


def reason_to_skip() -> str:
    """Return why no test bed with the wheels of this environment can be had; nothing else."""
    if reason := missing():
        return reason
    say = "import sys, venv; print(*sys.version_info[:2], sep='.')"
    done = subprocess.run(
        ["/usr/bin/python3", "-c", say], capture_output=True, text=True, check=False
    )
    ours = f"{sys.version_info.major}.{sys.version_info.minor}"
    if done.stdout.strip() != ours:
        return f"the machines' Python is {done.stdout.strip() or 'without venv'}, ours {ours}"
    return ""


@dataclass
class Site:
    """A test bed, and the cluster file on its laptop."""

    bed: TestBed
    wheels: Path
    __test__ = False

    @property
    def file(self) -> Path:
        return self.bed.home / "cluster.yaml"

    @property
    def state(self) -> Path:
        return self.bed.home / ".local/state/hpcapp/clusters" / CLUSTER

    def write(self, provider: dict[str, object] | None = None, **blocks: object) -> None:
        """Write the cluster file; but for the provider's block it is the same on every machine."""
        content: dict[str, object] = {
            "version": 1,
            "cluster": CLUSTER,
            "provider": provider or self.bed.cloud.provider_block(),
            "workers": {"count": 1},
            "auth": {"ssh_user": "admin"},
            "env": {"wheelhouse": str(self.wheels)},
        }
        self.file.write_text(yaml.safe_dump(content | blocks))

    def hpcapp(
        self, verb: str, *more: object, **keywords: object
    ) -> subprocess.CompletedProcess[str]:
        """Run a verb on the cluster file."""
        return self.bed.run("hpcapp", verb, self.file.name, *map(str, more), **keywords)

    def start(self, verb: str, *more: object) -> subprocess.Popen[str]:
        """Start a verb on the cluster file."""
        return self.bed.start("hpcapp", verb, self.file.name, *map(str, more))

    def succeed(self, verb: str, *more: object) -> subprocess.CompletedProcess[str]:
        """Run a verb that must end well."""
        done = self.hpcapp(verb, *more)
        assert done.returncode == 0, f"{verb}: {done.stdout}\n{done.stderr}"
        return done

    def end(self) -> None:
        """Take the cluster down; nothing of it may be left."""
        self.succeed("down")
        assert self.bed.left() == []


MakeSite = Callable[..., Site]


def make_mesh(points: Path, folder: Path, *options: str) -> bytes:
    target = folder / "local.ply"
    subprocess.run(
        [sys.executable, "-P", "-m", "hpcapp", "reconstruct", points, "-o", target, *options],
        check=True,
        capture_output=True,
    )
    return target.read_bytes()
