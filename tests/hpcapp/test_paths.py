"""No path that is given to a command makes it hang, or ends it with a traceback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., tuple[int, str, str]]

LOCAL = "version: 1\ncluster: paths\nprovider: {type: local}\nworkers: {count: 1}\n"


@pytest.fixture
def place(tmp_path: Path, sphere_file: Path) -> Path:
    """A folder with a pipe, a socket, a folder and a link to itself under every suffix."""
    for suffix in ("ply", "xyz", "yaml", "json"):
        os.mkfifo(tmp_path / f"pipe.{suffix}")
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(str(tmp_path / f"socket.{suffix}"))
        (tmp_path / f"folder.{suffix}").mkdir()
        (tmp_path / f"loop.{suffix}").symlink_to(f"loop.{suffix}")
        (tmp_path / f"device.{suffix}").symlink_to("/dev/zero")
    sphere_file.rename(tmp_path / "good.ply")
    return tmp_path


def _run(place: Path, *words: str, home: str | None = None) -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ) if home is None else {**os.environ, "HOME": home}
    return subprocess.run(
        [sys.executable, "-m", "hpcapp", *words], cwd=place, env=environment, text=True,
        stdin=subprocess.DEVNULL, capture_output=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["pipe", "socket", "folder", "loop", "device", "~no-such-user/x"])
@pytest.mark.parametrize(
    "words",
    [
        "info {}.ply",
        "reconstruct {}.ply -o mesh.ply",
        "reconstruct good.ply --grid 32 -o {}.ply",
        "reconstruct good.ply --grid 32 -o mesh.ply --temp-dir {}.ply/x",
        "reconstruct good.ply --grid 32 -o mesh.ply --cluster {}.json",
        "reconstruct good.ply --grid 32 -o mesh.ply --cluster {}.yaml",
        "simulate --shape sphere --points 1000 -o {}.ply",
        "validate {}.yaml",
        "plan {}.yaml",
        "submit {}.yaml good.ply -o mesh.ply",
    ],
)
def test_what_is_no_file_is_one_clear_line(place: Path, run: Run, words: str, kind: str) -> None:
    if (kind == "folder" and "--temp-dir" in words) or (kind == "loop" and " -o {}" in words):
        pytest.skip("that will do")
    code, _, said = run(*words.format(kind).split())
    assert code in (2, 3), said
    [line] = said.splitlines()
    assert kind.partition("/")[0] in line or "the folder cannot be made" in line
    assert "Traceback" not in line
    assert "internal error" not in line
    assert not (place / "~no-such-user").exists()


@pytest.mark.parametrize("flag", ["--events", "--trace"])
def test_what_is_watched_goes_to_a_pipe_that_somebody_reads(
    place: Path, run: Run, flag: str
) -> None:
    words = ("reconstruct", "good.ply", "--grid", "32", "-o", "mesh.ply", flag, "pipe.json")
    code, _, said = run(*words)
    assert code == 2
    assert "pipe.json: cannot be written" in said
    reader = os.open(place / "pipe.json", os.O_RDONLY | os.O_NONBLOCK)
    try:
        code, _, said = run(*words)
        assert code == 0, said
        assert b'": "extract"' in os.read(reader, 1 << 16)
    finally:
        os.close(reader)


@pytest.mark.parametrize("name", ["-", "/dev/stdin", "/dev/fd/0"])
def test_an_empty_standard_input_is_one_clear_line(place: Path, name: str) -> None:
    done = _run(place, "info", name)
    assert done.returncode == 3
    assert "the standard input is empty" in done.stderr


@pytest.mark.usefixtures("place")
def test_a_mesh_does_not_replace_the_standard_output(run: Run) -> None:
    code, _, said = run("reconstruct", "good.ply", "-o", "/dev/stdout")
    assert code == 2
    assert "give -o - for a PLY there" in said


@pytest.mark.slow
@pytest.mark.parametrize("home", ["", "/proc"])
def test_a_home_that_is_empty_or_cannot_be_written(place: Path, home: str) -> None:
    (place / "cluster.yaml").write_text(LOCAL)
    words = ("reconstruct", "good.ply", "--grid", "32", "-o", "mesh.ply", "--backend", "zmq")
    assert _run(place, *words, "--workers", "1", home=home).returncode == 0
    assert _run(place, "plan", "cluster.yaml", home=home).returncode == 0
    if home:
        done = _run(place, "up", "cluster.yaml", "-y", home=home)
        assert done.returncode == 2
        assert "set XDG_STATE_HOME to a folder that can be written" in done.stderr.splitlines()[-1]
