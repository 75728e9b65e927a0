"""The command as its user: every bad thing to type ends with one line and the right code."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
import pytest
from process_tree import are_gone
from stopping import await_stop, go_on

from hpcapp import cli
from hpcapp.cli import main
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh
from hpccomponent.cli.terminal import echo
from hpccomponent.errors import CloudError, ConfigError, TaskError

StartCommand = Callable[..., "subprocess.Popen[str]"]
WriteCloud = Callable[..., Path]
Run = Callable[..., tuple[int, str, str]]


def said(stderr: str) -> str:
    """Return the one line of an error; more than one, or a traceback, is a failure."""
    lines = [line for line in stderr.splitlines() if line.startswith("hpcapp: ")]
    assert len(lines) == 1, stderr
    assert "Traceback" not in stderr
    assert "internal error" not in stderr
    return lines[0]


def left_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


FLAGS = [
    (["--grid", "64", "--depth", "6"], "--depth takes the place of --grid"),
    (["--depth", "6", "--voxel-size", "1"], "--voxel-size takes the place of --depth"),
    (["--grid", "8"], "--grid"),
    (["--grid", "many"], "--grid"),
    (["--voxel-size", "0"], "--voxel-size"),
    (["--voxel-size", "nan"], "give a number from 1.1e-16 to 9e+15"),
    (["--voxel-size", "inf"], "give a number from 1.1e-16 to 9e+15"),
    (["--voxel-size", "1e-10"], "choose one that gives 16 to 4096"),
    (["--delta", "0.2"], "--delta means nothing to --method hierarchical"),
    (["--method", "paper", "--detail", "2"], "--detail means nothing to --method paper"),
    (["--method", "paper", "--patches", "9", "--cone", "paper"], "takes the place of --cone"),
    (["--method", "paper", "--patches", "9", "--max-points", "5"], "--max-points"),
    (["--method", "paper", "--patches", "9000"], "9000 patches"),
    (["--method", "paper", "--delta", "nan"], "delta"),
    (["--smoothness", "nan"], "smoothness"),
    (["--workers", "0"], "--workers"),
    (["--backend", "serial", "--workers", "2"], "choose another --backend"),
    (["--backend", "cloud"], "unknown backend 'cloud'"),
    (["--policy", "fair"], "--policy"),
    (["--dept", "8"], "Did you mean"),
]


@pytest.mark.parametrize(("flags", "words"), FLAGS, ids=[" ".join(flags) for flags, _ in FLAGS])
def test_flags_that_make_no_sense_are_usage_errors(
    run: Run, sphere_file: Path, flags: list[str], words: str
) -> None:
    code, stdout, stderr = run("reconstruct", str(sphere_file), "-o", "mesh.ply", *flags)
    assert (code, stdout) == (2, "")
    assert words in said(stderr)
    assert left_in(sphere_file.parent) == {"sphere.ply"}


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("", "names no file"),
        ("folder/", "names no file"),
        (".", "no suffix"),
        ("mesh", "no suffix"),
        ("mesh.docx", ".docx"),
        ("sphere.ply", "is the input itself"),
        ("link.ply", "is the input itself"),
        ("nowhere/mesh.ply", "create the folder"),
        ("folder.ply", "is not a file"),
        ("x" * 300 + ".ply", "cannot be written"),
        ("/proc/mesh.ply", "cannot be written"),
    ],
)
def test_a_bad_place_is_found_out_before_the_work(
    run: Run, sphere_file: Path, output: str, words: str
) -> None:
    (sphere_file.parent / "folder.ply").mkdir()
    (sphere_file.parent / "link.ply").symlink_to(sphere_file)
    before = sphere_file.read_bytes()
    code, _, stderr = run("reconstruct", str(sphere_file), "-o", output)
    assert code == 2
    assert words in said(stderr)
    assert "read: done" not in stderr
    assert sphere_file.read_bytes() == before
    assert left_in(sphere_file.parent) == {"sphere.ply", "folder.ply", "link.ply"}


HEADER = "ply\nformat ascii 1.0\nelement vertex {}\n" + "".join(
    f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")
)
ROW = "0.5 1 2 0 0 1\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "content", "code", "words"),
    [
        ("empty.ply", "", 3, "empty"),
        ("text.ply", "hello\n" * 9, 3, "not a PLY file"),
        ("long.ply", HEADER.format(4_000_000_000) + "end_header\n" + ROW * 20, 3, "truncated"),
        ("short.ply", HEADER.format(12) + "end_header\n" + ROW * 20, 3, "one place"),
        ("word.ply", HEADER.format(1) + "end_header\n0 1 two 0 0 1\n", 3, "word.ply:11"),
        ("comma.ply", HEADER.format(1) + "end_header\n0,5 1 2 0 0 1\n", 3, "decimal point"),
        ("none.ply", HEADER.format(0) + "end_header\n", 3, "no points"),
        ("nine.xyz", ROW * 9, 3, "at least 10"),
        ("same.xyz", ROW * 20, 3, "one place"),
        ("line.xyz", "".join(f"{i} 0 0 0 0 1\n" for i in range(20)), 3, "one line"),
        ("nan.xyz", "nan 1 2 0 0 1\n" * 20, 3, "no usable points"),
        ("zero.xyz", "0 1 2 0 0 0\n" * 20, 3, "one place"),
        ("bare.xyz", "0 1 2\n" * 20, 3, "one place"),
        ("huge.xyz", "".join(f"{i}e300 {i * i}e298 2 0 0 1\n" for i in range(20)), 3, "scale"),
        ("scan.las", "LASF", 3, "cut"),
        ("scan.abc", ROW * 20, 2, "is read from"),
        ("with\nline.ply", "", 3, "with | line.ply"),
    ],
)
def test_bad_points_are_input_errors(
    run: Run, tmp_path: Path, name: str, content: str, code: int, words: str
) -> None:
    (tmp_path / name).write_text(content)
    found, stdout, stderr = run("reconstruct", name, "-o", "mesh.ply")
    assert (found, stdout) == (code, "")
    assert words in said(stderr)
    assert left_in(tmp_path) == {name}


def test_a_missing_file_a_folder_and_a_pipe_are_named(run: Run, tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.ply")
    for name, code in (("missing.ply", 3), ("folder.ply", 2), ("pipe.ply", 3)):
        found, _, stderr = run("reconstruct", name, "-o", "mesh.ply")
        assert found == code
        assert name in said(stderr)


def test_unusable_points_are_dropped_counted_and_reported(
    run: Run, sphere: PointCloud, write_cloud: WriteCloud
) -> None:
    assert sphere.normals is not None
    positions, normals = sphere.positions.copy(), sphere.normals.copy()
    positions[:3] = np.nan
    positions[3] = np.inf
    normals[4:9] = 0.0
    path = write_cloud(positions, normals)
    code, stdout, stderr = run("reconstruct", str(path), "-o", "m.ply", "--grid", "32", "--json")
    assert code == 0
    counts = {
        "non_finite_points": 4,
        "bad_normals": 5,
        "duplicates": 0,
        "outliers": 0,
        "strays": 0,
        "lone_lines": 0,
    }
    assert json.loads(stdout)["dropped"] == counts
    assert "dropped 4 points" in stderr
    assert "dropped 5 points" in stderr


def test_the_report_tells_what_was_done(run: Run, sphere_file: Path, tmp_path: Path) -> None:
    arguments = ("reconstruct", str(sphere_file), "-o", "mesh.ply", "--grid", "32", "--json")
    code, stdout, _ = run(*arguments)
    report = json.loads(stdout)
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert code == 0
    assert report["watertight"]
    assert (report["components"], report["genus"], report["warnings"]) == (1, 0, [])
    assert (report["vertices"], report["faces"]) == (len(mesh.vertices), len(mesh.faces))
    assert {"method", "points", "patches", "backend", "workers", "bytes_sent", "bytes_received"} < {
        *report
    }
    assert next(iter(report["stages"])) == "read"
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.abs(radii - 1.0).max() < 0.03
    assert left_in(tmp_path) == {"sphere.ply", "mesh.ply"}


def test_normals_that_point_inwards_are_not_a_silent_result(
    run: Run, sphere: PointCloud, write_cloud: WriteCloud
) -> None:
    assert sphere.normals is not None
    path = write_cloud(sphere.positions, -sphere.normals)
    code, stdout, stderr = run("reconstruct", str(path), "-o", "m.ply", "--grid", "32", "--json")
    assert code == 0
    assert "face inwards" in stderr
    assert "face inwards" in json.loads(stdout)["warnings"][0]


def test_info_and_simulate_speak_of_one_scan(run: Run) -> None:
    assert run("simulate", "--shape", "sphere", "--points", "500", "-o", "scan.ply")[0] == 0
    code, stdout, _ = run("info", "scan.ply", "--json")
    assert code == 0
    assert json.loads(stdout)["points"] == 500
    assert "points" in run("info", "scan.ply")[1]
    code, _, stderr = run("simulate", "--shape", "cube-ish", "-o", "other.ply")
    assert code == 2
    assert "sphere" in said(stderr)


def test_without_a_verb_the_help_is_shown(run: Run) -> None:
    code, _, stderr = run()
    assert code == 2
    assert "Mesh:\n  reconstruct" in stderr
    assert run("reconstrukt")[0] == 2
    assert run("--version")[1].startswith("hpcapp ")


def test_help_lists_every_option_and_default(run: Run) -> None:
    code, stdout, _ = run("reconstruct", "--help")
    assert code == 0
    assert "[default: auto]" in " ".join(stdout.split())
    assert "[default: hierarchical]" in " ".join(stdout.split())


def test_a_closed_reader_gets_no_traceback(start_command: StartCommand, sphere_file: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    for arguments in (["info", str(sphere_file)], ["reconstruct", "--help"]):
        with start_command(*arguments, stdout=writer) as process:
            assert process.communicate()[1] == ""
        assert process.returncode == 1
    os.close(writer)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full here")
def test_full_streams(start_command: StartCommand, sphere_file: Path, tmp_path: Path) -> None:
    job = ("reconstruct", str(sphere_file), "--grid", "16", "-o")
    with open("/dev/full", "w") as full:
        with start_command(*job, "-", stdout=full) as process:
            stderr = process.communicate()[1]
        assert process.returncode == 1
        assert "standard output: No space left" in said(stderr)
        with start_command(*job, "mesh.ply", stderr=full) as process:
            process.communicate()
    assert process.returncode == 0
    assert left_in(tmp_path) == {"sphere.ply", "mesh.ply"}


def test_closed_streams_do_no_harm(
    start_command: StartCommand, sphere_file: Path, tmp_path: Path
) -> None:
    def close_all() -> None:
        os.closerange(0, 3)

    job = ("reconstruct", str(sphere_file), "--grid", "16", "-o")
    with start_command(*job, "mesh.ply", preexec_fn=close_all) as process:
        process.wait()
    assert process.returncode == 0
    assert len(read_mesh(tmp_path / "mesh.ply").faces)
    with start_command(*job, "-", preexec_fn=close_all) as process:
        process.wait()
    assert process.returncode == 2


def test_a_mesh_goes_to_standard_output(
    start_command: StartCommand, sphere_file: Path, tmp_path: Path
) -> None:
    with (
        (tmp_path / "piped.ply").open("wb") as sink,
        start_command("reconstruct", "sphere.ply", "-o", "-", "--grid", "16", stdout=sink) as p,
    ):
        p.communicate()
    assert p.returncode == 0
    assert len(read_mesh(tmp_path / "piped.ply").faces)
    assert left_in(tmp_path) == {"sphere.ply", "piped.ply"}


ORDERS = "\x1b]0;title\x07 \x9b2J \u202e \x7f"  # set the title, clear the screen, turn the line


@click.command()
@click.argument("way")
def speak(way: str) -> None:
    """Say somebody else's words in one of the ways in which a verb says them."""
    words = f"{ORDERS}\nhpcapp: all is well"
    match way:
        case "log":
            logging.getLogger("hpcapp").warning("worker %s has failed", words)
        case "error":
            raise TaskError(f"worker-1: {words}", words)
        case "excerpt":
            raise CloudError("it does not start", "", words)
        case "usage":
            raise click.UsageError(words)
        case "config":
            raise ConfigError(f"a.yaml:1:1: {ORDERS}")
        case "system":
            raise OSError(2, words, words)
        case "bug":
            raise LookupError(words)
        case "output":
            echo(words)


@pytest.mark.parametrize("debug", [False, True])
@pytest.mark.parametrize(
    "way", ["log", "error", "excerpt", "usage", "config", "system", "bug", "output"]
)
def test_no_escape_code_of_others_reaches_the_terminal(
    way: str, debug: bool, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(cli.SHIPPED, "speak", f"{__name__}:speak")
    monkeypatch.setitem(sys.modules, __name__, sys.modules[speak.callback.__module__])
    _, out, err = run(*["--debug"][: int(debug)], "speak", way)
    assert r"\x1b]0;title\x07 \x9b2J \u202e \x7f" in out + err
    assert not set(ORDERS) - set(" ]0;title2J") & set(out + err)
    if not debug and way != "output":  # nor does a line look like one of ours
        assert "hpcapp: all is well" not in err.splitlines()


def test_columns_of_a_file_are_shown_visibly(run: Run, tmp_path: Path) -> None:
    rows = "\n".join(" ".join(map(str, row)) for row in np.random.default_rng(1).random((50, 4)))
    (tmp_path / "a\x1b]0;t\x07.ply").write_text(
        "ply\nformat ascii 1.0\ncomment crs \x9bm\u202e\nelement vertex 50\nproperty float x\n"
        f"property float y\nproperty float z\nproperty float q\x1b]0;t\x07\nend_header\n{rows}\n"
    )
    code, out, err = run("info", "a\x1b]0;t\x07.ply")
    assert code == 0
    assert not set("\x1b\x07\x9b\u202e") & set(out + err)
    assert r"q\x1b]0;t\x07 attribute" in out
    assert r"\x9bm\u202e" in out
    code, out, err = run("info", "nowhere\x1b]0;t\x07.ply")
    assert (code, out) == (3, "")
    assert r"nowhere\x1b]0;t\x07.ply" in said(err)


BACKENDS = (
    ["--backend", "threads"],
    ["--backend", "processes"],
    ["--backend", "zmq", "--workers", "2"],
)


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS, ids=" ".join)
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_end_in_mid_job_leaves_nothing(
    start_command: StartCommand,
    stop_after: Callable[[str], None],
    sphere_file: Path,
    tmp_path: Path,
    backend: list[str],
    signum: signal.Signals,
) -> None:
    stop_after("fit: done")
    job = ("reconstruct", "sphere.ply", "-o", "mesh.ply", "--grid", "256", *backend)
    with start_command(*job) as process:
        helpers = await_stop(process, "fit: done")
        assert bool(helpers) == (backend[-1] != "threads")
        if signum == signal.SIGINT:  # as a terminal sends it
            os.killpg(process.pid, signum)
        go_on(process, signum)
        stderr = process.communicate()[1]
    assert are_gone(helpers)
    assert "Traceback" not in stderr
    if signum != signal.SIGKILL:
        assert process.returncode == 130
        own = [line for line in stderr.splitlines() if line.startswith("hpcapp: ")]
        assert own[-1] == "hpcapp: interrupted"  # before it: that the end takes its time
        assert left_in(tmp_path) == {"sphere.ply"}


def test_an_interrupt_while_the_command_is_imported(start_command: StartCommand) -> None:
    """A plug-in verb's import stands for any: the interpreter has come that far."""
    script = (
        "import os, signal, sys; sys.modules['hpcapp.cli'] = None\n"
        "import builtins; real = builtins.__import__\n"
        "def interrupting(name, *rest):\n"
        "    if name == 'hpcapp.cli': os.kill(os.getpid(), signal.SIGINT)\n"
        "    return real(name, *rest)\n"
        "builtins.__import__ = interrupting\n"
        "from hpcapp.__main__ import main; main()\n"
    )
    with start_command("--version") as process:  # the same interpreter and environment
        process.communicate()
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "hpcapp: interrupted\n")


def test_a_command_within_another_process_leaves_its_signals_alone() -> None:
    """The thread that counts signals would be found by the check for leaks."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(SystemExit):
        main(["--version"])
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_an_interrupt_while_a_class_names_its_attributes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python 3.11 makes a RuntimeError of it, as in the midst of an import of numpy."""

    class Naming:
        def __set_name__(self, owner: type, name: str) -> None:
            raise KeyboardInterrupt

    def name(*_: object, **__: object) -> None:
        type("Named", (), {"attribute": Naming()})

    monkeypatch.setattr(cli.hpcapp, "main", name)
    with pytest.raises(SystemExit) as left:
        cli.main(["info", "scan.ply"])
    assert left.value.code == 130
    assert capsys.readouterr().err == "hpcapp: interrupted\n"
