"""One head and three workers: up, up again, a job, down; and no secret anywhere on the way."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from shared_data import FOLDER
from testbed.chaos import ProcessList
from testbed.sites import OPTIONS, POINTS, Site, make_mesh

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def shared_points() -> Path:
    """Return the cloud of the paper's Figure 7 where it is at hand, else the small one."""
    path = FOLDER / "bunny_263256.ply"
    return path if path.is_file() else POINTS


def test_head_and_three_workers(site: Site, tmp_path: Path) -> None:
    points = shared_points()
    options = OPTIONS if points == POINTS else OPTIONS[2:]
    site.write(workers={"count": 3})
    said = []
    with ProcessList() as command_lines:
        said.append(site.succeed("up", "-y"))
        assert len(site.bed.cloud.living) == 4

        calls = len(site.bed.cloud.calls)
        said.append(site.succeed("up", "-y"))
        assert [c.action for c in site.bed.cloud.calls[calls:] if c.changes] == []

        said.append(site.succeed("status", "--json"))
        said.append(site.succeed("submit", points, "-o", "mesh.ply", "--", *options))
        said.append(site.succeed("logs"))
        assert (site.bed.home / "mesh.ply").read_bytes() == make_mesh(points, tmp_path, *options)

        secrets = read_secrets(site)
        shown = {f"output {n}": done.stdout + done.stderr for n, done in enumerate(said)}
        shown["journal"] = (site.state / "journal.jsonl").read_text()
        shown |= what_machines_show(site)
        site.end()
    shown |= {f"command line {n}": line for n, line in enumerate(command_lines)}
    shown |= {f"request {n}": str(c.parameters) for n, c in enumerate(site.bed.cloud.calls)}
    shown |= {f"user-data of {i.id}": i.user_data.decode() for i in site.bed.cloud.instances}
    found = [(name, where) for name, s in secrets.items() for where in shown if s in shown[where]]
    assert found == []


def read_secrets(site: Site) -> dict[str, str]:
    """Return every secret of a cluster by what it is: its keys, and the cloud's."""
    pairs = json.loads((site.state / "keys.json").read_text())
    secrets = {f"CURVE key of {name}": pair["secret"] for name, pair in pairs.items()}
    assert secrets
    key = (site.state / "id").read_text().splitlines()
    assert "PRIVATE KEY" in key[0]
    secrets |= {"SSH key": key[len(key) // 2], "key of the cloud": site.bed.cloud.secret_key}
    modes = {(site.state / name).stat().st_mode & 0o077 for name in ("keys.json", "id")}
    assert modes == {0}
    return secrets


def what_machines_show(site: Site) -> dict[str, str]:
    """Return consoles, logs, and all that anybody on a machine may read in the login's home."""
    shown = {}
    for machine in site.bed.machines():
        shown[f"console of {machine.name}"] = machine.console()
        find = "find /home/admin/hpcapp -name '*.log*' -type f -exec cat {} +"
        shown[f"logs on {machine.name}"] = machine.run(find)
        readable = "find /home/admin/hpcapp -name '*.json' -type f -perm /077 -exec cat {} +"
        shown[f"readable on {machine.name}"] = machine.run(readable)
    return shown
