"""`hpcapp up` killed with -9 at every API call and set-up step in turn, on the strict cloud."""

from __future__ import annotations

import itertools
import json
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from cloud import StrictCloud
from killing import Killer

NODES = ["head", "worker-1", "worker-2"]


class Scene:
    """A strict cloud, a cluster file on it, and commands that may be killed."""

    def __init__(self, cloud: StrictCloud, killer: Killer, folder: Path) -> None:
        self.cloud, self.killer = cloud, killer
        self.file = folder / "cluster.yaml"
        spec = {
            "version": 1,
            "cluster": "bunny",
            "provider": cloud.provider_block(),
            "workers": {"count": 2},
        }
        self.file.write_text(json.dumps(spec))
        killer.environment = {**cloud.environment(), "XDG_STATE_HOME": str(folder)}
        cloud.hook = killer.on_call

    def run(self, verb: str, kill_at: int | None = None) -> int:
        options = ["-y"] if verb == "up" else []
        if kill_at is not None:
            options.append("--skip-checks")  # they change nothing, and half of the calls are theirs
        code, self.said = self.killer.run(verb, str(self.file), *options, kill_at=kill_at)
        return code

    def nodes(self) -> list[str]:
        """The names of all machines that cost something, by the tokens that they came by."""
        return sorted(node for node in NODES for i in self.cloud.living if f"-{node}-" in i.token)


@pytest.fixture
def killer() -> Iterator[Killer]:
    with Killer() as killer:
        yield killer


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("profile", "first", "apart"), [("aws", 1, 1), ("euca-4.0", 2, 5), ("euca-5.1", 3, 5)]
)
def test_up_killed_at_every_step_leaves_no_orphan_and_no_duplicate(
    profile: str, first: int, apart: int, killer: Killer, tmp_path: Path
) -> None:
    """After one step the next command is `up`, after the next `down`.

    A new cloud for each: moto keeps every machine that ever was, and slows down.
    """
    for at in itertools.count(first, apart):
        with StrictCloud(profile) as cloud:
            scene = Scene(cloud, killer, tmp_path)
            code = scene.run("up", kill_at=at)
            assert code in (0, -signal.SIGKILL), f"step {at}: {scene.said}"
            step = f"killed at step {at}, {killer.steps[-1]}"
            if at % 2:
                assert scene.run("up") == 0, f"{step}: {scene.said}"
                assert scene.nodes() == NODES, step
            assert scene.run("down") == 0, f"{step}: {scene.said}"
            assert cloud.left() == [], step
        if code == 0:
            break
    assert at > 40
