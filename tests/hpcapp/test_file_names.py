"""Names of files are bytes: every input and every output may have one that is not UTF-8."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

StartCommand = Callable[..., "subprocess.Popen[str]"]
Run = Callable[..., tuple[int, str, str]]


def test_file_names_are_bytes(start_command: StartCommand, sphere_file: Path) -> None:
    odd = os.fsdecode(b"\xff sph\xe9re.ply")
    sphere_file.rename(sphere_file.with_name(odd))
    with start_command("reconstruct", odd, "-o", os.fsdecode(b"\xfe.ply"), "--grid", "16") as p:
        p.communicate()
    assert p.returncode == 0
    assert {path.name for path in sphere_file.parent.iterdir()} == {odd, os.fsdecode(b"\xfe.ply")}


ODD = os.fsdecode(b"\xff\xfe")
NAMED = [
    ("in.xyz", "-o", f"{ODD}.ply", "--report", "m.html"),
    ("in.xyz", "-o", "m.ply", "--report", f"{ODD}.html", "--png", f"{ODD}.png"),
    (f"{ODD}.xyz", "-o", f"{ODD}.glb", "--trace", f"{ODD}.json", "--events", f"{ODD}.ev", "--json"),
    (f"{ODD}.xyz", "-o", f"{ODD}.3dtiles", "--temp-dir", "d"),
    (f"{ODD}.xyz", "-o", f"{ODD}.d/m.tiles", "--report", "m.html", "--json", "--details"),
    (f"{ODD}.xyz", "-o", "m.ply", "--resume", "--temp-dir", "d"),
    (f"{ODD}.xyz", "-o", f"{ODD}.ply", "--backend", "zmq", "--workers", "1", "--temp-dir", "d"),
]


@pytest.mark.parametrize("words", NAMED)
def test_every_output_may_have_a_name_that_is_not_utf_8(
    words: tuple[str, ...], run: Run, tmp_path: Path
) -> None:
    points = np.random.default_rng(7).normal(size=(1500, 3))
    np.savetxt("in.xyz", points / np.linalg.norm(points, axis=1, keepdims=True))
    Path(f"{ODD}.xyz").write_bytes(Path("in.xyz").read_bytes())
    Path(f"{ODD}.d").mkdir()
    Path("d").mkdir()
    code, out, err = run("reconstruct", "--grid", "16", *words)
    assert code == 0, err
    if "--json" in words:
        assert json.loads(out)["input"]["files"] == [f"{ODD}.xyz"]
    for flag, name in pairwise(words):
        assert not flag.startswith("-o") or Path(name).exists()
        assert not flag.startswith("--report") or b"3D" in Path(name).read_bytes()


def test_a_folder_of_which_workers_cannot_be_told_is_named(run: Run) -> None:
    np.savetxt("in.xyz", np.random.default_rng(7).normal(size=(1500, 3)))
    code, _, err = run("reconstruct", "in.xyz", "-o", "m.ply", "--temp-dir", f"{ODD}.d")
    assert code == 2
    assert err.splitlines()[-1].startswith(r"hpcapp: --temp-dir \xff\xfe.d: its path is not UTF-8")


@pytest.mark.parametrize("suffix", [".ply", ".xyz", ".las", ".laz", ".e57", ".npz"])
def test_points_of_every_format_may_have_such_names(run: Run, suffix: str) -> None:
    np.savetxt("in.xyz", np.random.default_rng(7).normal(size=(100, 3)))
    Path(ODD).mkdir()
    place = f"{ODD}/{ODD}{suffix}"
    for words in (
        ("convert", "in.xyz", "-o", place),
        ("info", place, "--png", f"{ODD}.png"),
        ("convert", place, "-o", "m.ply"),
    ):
        code, _, err = run(*words)
        assert code == 0, err


def test_a_path_that_is_printed_can_be_opened(start_command: StartCommand, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "in.xyz", np.random.default_rng(7).normal(size=(100, 3)))
    with start_command(
        "view", "in.xyz", "-o", f"{ODD}.html", "--no-open", errors="surrogateescape"
    ) as p:
        out, _ = p.communicate()
    assert (tmp_path / out.rstrip("\n")).exists()
