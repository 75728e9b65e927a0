"""The verbs of jobs on a cluster of this machine: the command, loaders, runners, all real."""

from __future__ import annotations

import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from heads import ON_WORKERS, WAITING, held_cluster, write_sphere

from hpccomponent.errors import HpcError
from hpcdeploy.jobs.cluster_job import new_mesh_here
from hpcdeploy.spec.job_folder import JobState, JobStatus

OPTIONS = ("--grid", "32")
SUBMIT = ("submit", "cluster.yaml", "sphere.xyz", "-o")
Run = Callable[..., "subprocess.CompletedProcess[str]"]


class Place:
    """A folder with a cluster file, points, and the command."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        (folder / "cluster.yaml").write_text(
            f"version: 1\ncluster: mine\nprovider: {{type: local}}\nworkers: {{count: 1}}\n"
            f"communicator: {{port: {port}}}\n"
        )
        write_sphere(folder / "sphere.xyz")
        self.state = folder / "state/hpcapp/clusters/mine"
        self.head = self.state / "nodes/head/hpcapp/mine"
        self.summary = ""

    def start(self, *words: str, stdout: int = subprocess.PIPE) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "hpcapp", *words],
            cwd=self.folder,
            env={**os.environ, "XDG_STATE_HOME": str(self.folder / "state")},
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def run(self, *words: str, code: int = 0) -> tuple[str, str]:
        process = self.start(*words)
        output, errors = process.communicate(timeout=200)
        assert process.returncode == code, errors
        return output, errors

    def same(self, mesh: str) -> bool:
        return (self.folder / mesh).read_bytes() == (self.folder / "local.ply").read_bytes()

    def ownership(self) -> AbstractContextManager[None]:
        """Hold the cluster, so that jobs run and get no further."""
        return held_cluster(self.head / "inventory.json")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    place = Place(tmp_path_factory.mktemp("place"))
    _, errors = place.run("reconstruct", "sphere.xyz", "-o", "local.ply", *OPTIONS)
    place.summary = errors.splitlines()[-1].removeprefix("local.ply: ")
    yield place
    place.run("down", "cluster.yaml")


@pytest.fixture(scope="module")
def cluster(place: Place) -> Place:
    place.run("up", "cluster.yaml", "-y")
    return place


@pytest.mark.slow
def test_a_job_on_a_cluster_that_is_not_up_leaves_nothing(place: Place) -> None:
    output, errors = place.run(
        "reconstruct", "sphere.xyz", "-o", "mesh.ply", *OPTIONS, *ON_WORKERS, "--cluster",
        "cluster.yaml", "--json",
    )  # fmt: skip
    report = json.loads(output)
    assert (report["backend"], report["grid"], report["workers"]) == ("cluster", 32, 2)
    assert "2 of 2 workers" in errors
    assert "watertight, 1 piece" in report["summary"]
    assert place.same("mesh.ply")
    assert not place.state.exists()


@pytest.mark.slow
def test_a_job_that_fails_takes_the_cluster_down_too(place: Place) -> None:
    _, errors = place.run(
        "reconstruct", "sphere.xyz", "-o", "none.ply", "--voxel-size", "1e-9", "--cluster",
        "cluster.yaml", code=2,
    )  # fmt: skip
    assert errors.splitlines()[-1].startswith("hpcapp: job 1 failed: --voxel-size")
    assert not (place.folder / "none.ply").exists()
    assert not place.state.exists()


def test_points_that_will_not_do_bring_nothing_up(place: Place) -> None:
    (place.folder / "nothing.xyz").write_text("")
    for points, said in (
        ("nothing.xyz", "no points"),
        ("missing.xyz", "cannot be read"),
    ):
        _, errors = place.run(
            "reconstruct", points, "-o", "none.ply", "--cluster", "cluster.yaml", code=3
        )
        assert errors.startswith(f"hpcapp: {points}")
        assert said in errors
        assert len(errors.splitlines()) == 1
    assert not place.state.exists()


@pytest.mark.slow
def test_a_job_is_submitted_listed_attached_to_and_fetched(cluster: Place) -> None:
    output, errors = cluster.run(
        "submit", "cluster.yaml", "sphere.xyz", "-o", "there.ply", "--detach", "--json", "--",
        *OPTIONS, *ON_WORKERS,
    )  # fmt: skip
    job = json.loads(output)["job"]
    assert f"hpcapp attach cluster.yaml {job}" in errors
    _, errors = cluster.run("attach", "cluster.yaml", job)
    *_, hint, last = errors.splitlines()
    assert f"hpcapp fetch cluster.yaml {job}" in hint
    local = cluster.summary
    assert last == f"there.ply: {local}"
    output, _ = cluster.run("jobs", "cluster.yaml", "--json")
    [status] = [line for line in map(json.loads, output.splitlines()) if line["job"] == job]
    assert (status["state"], status["title"]) == ("done", "sphere.xyz")
    command = "hpcapp submit cluster.yaml sphere.xyz -o there.ply -- --grid 32 --backend zmq"
    assert status["command"] == command
    assert (status["cost"], status["seconds"] >= 0) == (None, True)
    heading, *rows = cluster.run("jobs", "cluster.yaml")[0].splitlines()
    assert heading.split()[:6] == ["JOB", "STATE", "SUBMITTED", "(UTC)", "TIME", "COST"]
    [row] = [row for row in rows if row.split()[0] == job]
    assert row.split()[1] == "done"
    assert row.split()[5:] == ["-", "sphere.xyz", "->", "there.ply"]
    output, _ = cluster.run("fetch", "cluster.yaml", job, "--json")
    assert json.loads(output)["command"] == command
    assert cluster.same("there.ply")
    cluster.run("fetch", "cluster.yaml", job, "-o", "nowhere/m.ply", code=2)
    assert not (cluster.folder / "nowhere").exists()
    assert "write: done" in cluster.run("logs", "cluster.yaml", job)[0]
    assert "write: done" in cluster.run("logs", "-f", "cluster.yaml", job)[0]
    _, errors = cluster.run(
        "submit", "cluster.yaml", "sphere.xyz", "-o", "direct.ply", "--", *OPTIONS
    )
    assert errors.splitlines()[-1] == f"direct.ply: {local}"
    assert cluster.same("direct.ply")


@pytest.mark.slow
def test_the_command_of_a_job_can_be_pasted_into_a_shell(cluster: Place, tmp_path: Path) -> None:
    """From the folder that it was typed in, and from another one, with names that need quotes."""
    name = "a scan; it's $HOME"
    (cluster.folder / f"{name}.xyz").write_bytes((cluster.folder / "sphere.xyz").read_bytes())
    words = ("submit", "cluster.yaml", f"{name}.xyz", "-o", f"{name}.ply")
    output, _ = cluster.run(*words, "--json", "--", *OPTIONS)
    told = json.loads(output)["command"]
    assert shlex.split(told) == ["hpcapp", *words, "--", *OPTIONS]
    cluster.run("reconstruct", "sphere.xyz", "-o", "r.ply", *OPTIONS, "--cluster", "cluster.yaml")
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    state = str(cluster.folder / "state")
    env = {**os.environ, "PATH": programs, "XDG_STATE_HOME": state}
    listed = subprocess.run(
        ["hpcapp", "jobs", cluster.folder / "cluster.yaml", "--json"],
        cwd=tmp_path, env=env, check=True, stdout=subprocess.PIPE,
    ).stdout.splitlines()  # fmt: skip
    submitted, reconstructed = (json.loads(line)["command"] for line in listed[-2:])
    (cluster.folder / "r.ply").unlink()
    (cluster.folder / f"{name}.ply").unlink()
    for line, folder in ((told, cluster.folder), (submitted, tmp_path), (reconstructed, tmp_path)):
        subprocess.run(["/bin/sh", "-c", line], cwd=folder, env=env, check=True)
    assert cluster.same("r.ply")
    assert cluster.same(f"{name}.ply")


@pytest.mark.slow
def test_a_head_chooses_no_place_on_this_machine(cluster: Place) -> None:
    """The head's word is a name for a new mesh in this folder, or nothing is written at all."""
    cluster.run(*SUBMIT, "named.ply", "--", *OPTIONS)
    place = max((cluster.head / "jobs").glob("[0-9]*"), key=lambda path: int(path.name))
    told = json.loads((place / "status.json").read_text())
    (cluster.folder / "mine.ply").write_text("mine")
    there = sorted(path for path in cluster.folder.rglob("*") if cluster.state not in path.parents)
    for name, code, said in (
        ("../../.bashrc", 4, "status.json is damaged"),
        ("mine.ply", 2, "mine.ply is there already; give -o mine.ply to replace it"),
        ("a\x1b[2J.ply", 2, "no name for a new file"),
    ):
        (place / "status.json").write_text(json.dumps(told | {"mesh": name}))
        (place / Path(name).name).write_text("the head's")
        _, errors = cluster.run("fetch", "cluster.yaml", place.name, code=code)
        [line] = errors.splitlines()
        assert said in line
        assert "\x1b" not in line
    now = sorted(path for path in cluster.folder.rglob("*") if cluster.state not in path.parents)
    assert now == there
    assert (cluster.folder / "mine.ply").read_text() == "mine"
    (place / "status.json").write_text(json.dumps(told))
    cluster.run("fetch", "cluster.yaml", place.name, "-o", "mine.ply")
    assert cluster.same("mine.ply")


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["cluster.yaml"], "is there already"),
        ([".x.ply", "-rf.ply", "~.ply", "a\u202eb.ply", ""], "no name for a new file"),
        (["sitecustomize.py", "Makefile"], "a mesh is written to"),
    ],
)
def test_a_name_that_a_head_tells_is_that_of_a_new_mesh_here(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, names: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cluster.yaml").touch()
    for name in names:
        with pytest.raises(HpcError, match=said):
            new_mesh_here(JobStatus("1", JobState.DONE, mesh=name))


@pytest.mark.slow
def test_points_and_mesh_may_have_names_that_are_not_utf_8(cluster: Place) -> None:
    odd = os.fsdecode(b"\xff\xfe")
    (cluster.folder / f"{odd}.xyz").write_bytes((cluster.folder / "sphere.xyz").read_bytes())
    cluster.run(
        "submit", "cluster.yaml", f"{odd}.xyz", "-o", f"{odd}.ply", "--detach", "--", *OPTIONS
    )
    _, errors = cluster.run("attach", "cluster.yaml")
    assert r"\xff\xfe.ply: " in errors
    assert r"\xff\xfe.xyz -> \xff\xfe.ply" in cluster.run("jobs", "cluster.yaml")[0]
    _, errors = cluster.run("fetch", "cluster.yaml", code=2)
    assert "name one by -o" in errors
    cluster.run("fetch", "cluster.yaml", "-o", f"{odd}.ply")
    assert cluster.same(f"{odd}.ply")


@pytest.mark.slow
def test_what_a_head_says_reaches_the_terminal_visibly(cluster: Place) -> None:
    cluster.run(*SUBMIT, "said.ply", "--", *OPTIONS)
    place = max((cluster.head / "jobs").glob("[0-9]*"), key=lambda path: int(path.name))
    told = json.loads((place / "status.json").read_text())
    lie = {"title": "\x1b[2J\na \u202eb", "state": "failed", "exit_code": 1, "reason": "\x9b0m"}
    (place / "status.json").write_text(json.dumps(told | lie))
    (place / "log").write_text("\x1b]0;title\x07line\n")
    for verb, code in (("jobs", 0), ("logs", 0), ("attach", 1), ("fetch", 1)):
        words = [verb, "cluster.yaml", *([] if verb == "jobs" else [place.name])]
        said = "".join(cluster.run(*words, code=code))
        assert not set("\x1b\x07\x9b\u202e") & set(said)
        assert r"\x9b0m" in said or r"\x1b]0;title\x07line" in said
    listed = cluster.run("jobs", "cluster.yaml")[0].splitlines()
    assert r"\x1b[2J\na \u202eb" in listed[-1]
    (place / "status.json").write_text("{")
    output, errors = cluster.run("jobs", "cluster.yaml", code=4)
    assert len(output.splitlines()) > 1
    assert "damaged" in output.splitlines()[-1]
    assert errors.startswith(f"hpcapp: job {place.name}: its status.json is damaged")
    (place / "status.json").write_text(json.dumps(told))


@pytest.mark.slow
def test_output_of_exec_is_visible_on_a_terminal_and_as_it_is_in_a_pipe(cluster: Place) -> None:
    words = ("exec", "cluster.yaml", "--", "printf", r"'\033[31mred\033[0m\n'")
    assert cluster.run(*words)[0] == "head: \x1b[31mred\x1b[0m\n"
    ours, theirs = os.openpty()
    with os.fdopen(ours, "rb") as screen:
        process = cluster.start(*words, stdout=theirs)
        os.close(theirs)
        assert screen.readline() == b"head: \\x1b[31mred\\x1b[0m\r\n"
        process.communicate(timeout=60)
    assert process.returncode == 0


def test_a_cluster_that_was_up_stays_up(cluster: Place) -> None:
    cluster.run("reconstruct", "sphere.xyz", "-o", "m.ply", *OPTIONS, "--cluster", "cluster.yaml")
    assert cluster.same("m.ply")
    assert (cluster.head / "inventory.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_job_outlives_the_client(cluster: Place, number: signal.Signals) -> None:
    with cluster.ownership():
        client = cluster.start(*SUBMIT, "m.ply", "--", *ON_WORKERS)
        assert client.stderr is not None
        assert any(WAITING in line for line in client.stderr)
        client.send_signal(number)
        _, errors = client.communicate(timeout=60)
        if number == signal.SIGINT:
            assert client.returncode == 130
            assert "hpcapp attach cluster.yaml" in errors
        output, _ = cluster.run("jobs", "cluster.yaml", "--json")
        job = json.loads(output.splitlines()[-1])
        assert job["state"] == "running"
        cluster.run("cancel", "cluster.yaml")
        _, errors = cluster.run("attach", "cluster.yaml", job["job"], code=1)
        assert f"hpcapp: job {job['job']} was cancelled" in errors


@pytest.mark.slow
def test_the_page_of_a_job_is_led_to(cluster: Place) -> None:
    with cluster.ownership():
        output, errors = cluster.run(
            *SUBMIT, "m.ply", "--detach", "--dashboard", "--json", "--", *OPTIONS, *ON_WORKERS
        )
        job = json.loads(output)["job"]
        assert f"hpcapp attach cluster.yaml {job} --dashboard" in errors
        client = cluster.start("attach", "cluster.yaml", job, "--dashboard")
        assert client.stderr is not None
        line = next(line for line in client.stderr if line.startswith("dashboard: "))
        address = line.split()[1]
        with urllib.request.urlopen(address, timeout=60) as answer:  # noqa: S310 - loopback
            assert b"m.ply" in answer.read()
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(address.partition("?")[0], timeout=60)  # noqa: S310
    _, errors = client.communicate(timeout=200)
    assert client.returncode == 0, errors


@pytest.mark.slow
def test_a_job_without_a_page_says_so(cluster: Place) -> None:
    cluster.run(*SUBMIT, "m.ply", "--detach", "--", *OPTIONS)
    _, errors = cluster.run("attach", "cluster.yaml", "--dashboard")
    assert "submit it with --dashboard" in errors or "is done" in errors


@pytest.mark.slow
def test_what_cannot_be_is_one_line_and_no_job(cluster: Place) -> None:
    before, _ = cluster.run("jobs", "cluster.yaml")
    for words, code, said in (
        (("jobs", "missing.yaml"), 2, "missing.yaml"),
        (("fetch", "cluster.yaml", "99"), 2, "there is no job 99"),
        (("submit", "cluster.yaml", "missing.xyz", "-o", "m.ply"), 3, "missing.xyz"),
        ((*SUBMIT, "m.ply", "--", "--grid", "6"), 2, "'6' is not auto, nor from 16"),
        ((*SUBMIT, "m.ply", "--", "--grd", "64"), 2, "No such option '--grd'"),
        ((*SUBMIT, "m.ply", "--", "--workers", "2"), 2, "--cluster and --workers exclude"),
        ((*SUBMIT, "m.ply", "--", "--delta", "0"), 2, "--delta means nothing to --method hier"),
        ((*SUBMIT, "m.ply", "--", "-o", "x.ply"), 2, "--output is not for the job on the head"),
        ((*SUBMIT, "m.ply", "--", "--json"), 2, "--json is not for the job on the head"),
        ((*SUBMIT, "m.ply", "--", "more"), 2, "submit takes one file of points"),
        ((*SUBMIT, "-"), 2, "-o - names no file"),
        ((*SUBMIT, "m.xyz"), 2, "a mesh is written to .ply"),
        ((*SUBMIT, "nowhere/m.ply"), 2, "create the folder"),
        ((*SUBMIT, "m.3dtiles"), 2, "one file comes from a cluster"),
        (
            ("reconstruct", "sphere.xyz", "-o", "m.tiles", "--cluster", "cluster.yaml"), 2,
            "one file comes from a cluster",
        ),
        (
            ("reconstruct", "sphere.xyz", "-o", "m.ply", "--cluster", "cluster.yaml", "--workers",
             "2"), 2, "--cluster and --workers exclude",
        ),
    ):  # fmt: skip
        _, errors = cluster.run(*words, code=code)
        [line] = errors.splitlines()
        assert said in line
    assert cluster.run("jobs", "cluster.yaml")[0] == before


@pytest.mark.slow
def test_down_ends_the_jobs_that_run_and_wait(cluster: Place) -> None:
    with cluster.ownership():
        for _ in range(2):
            cluster.run(*SUBMIT, "m.ply", "--detach", "--", *ON_WORKERS)
        with cluster.start("attach", "cluster.yaml") as client:
            output, _ = cluster.run("jobs", "cluster.yaml", "--json")
            runners = [json.loads(line)["runner"] for line in output.splitlines()[-2:]]
            cluster.run("down", "cluster.yaml")
            client.communicate(timeout=60)
    assert not cluster.state.exists()
    for runner in runners:
        assert not runner or not Path(f"/proc/{runner}").exists()
