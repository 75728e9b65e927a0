"""Jobs on a head that is a folder, with real loaders, runners and verbs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from heads import ON_WORKERS, WAITING, held_cluster, install_python, when_said, write_sphere
from simulated import FILE, make_cluster, make_spec, stub_set_up
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError, InputError, JobError, UsageError
from hpcdeploy.jobs import cluster_job
from hpcdeploy.jobs.display import JobDisplay, JobEvent
from hpcdeploy.jobs.queries import Jobs
from hpcdeploy.login.access import Access
from hpcdeploy.login.local_shell import LocalShell
from hpcdeploy.provider import MachineSeen, State, Tags
from hpcdeploy.reconcile.converge import bring_up
from hpcdeploy.reconcile.cost import estimate_cost
from hpcdeploy.reconcile.status import describe_cluster
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.job_folder import JobState, JobStatus
from hpcdeploy.spec.names import Desired, NodeName

PATIENCE_S = 60.0
OPTIONS = ("--grid", "32")


class Seen(JobDisplay):
    """Remembers what it was shown; tells the first log line that holds `word` to `on_word`."""

    def __init__(self, word: str = "", on_word: Callable[[], object] = lambda: None) -> None:
        self.lines: list[str] = []
        self.events: list[JobEvent] = []
        self._word, self._on_word = word, on_word

    def show_log(self, line: str) -> None:
        self.lines.append(line)
        if self._word and self._word in line:
            self._word = ""
            self._on_word()

    def show_event(self, event: JobEvent) -> None:
        self.events.append(event)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make the cluster's folder on a head as `up` leaves it, but for the inventory."""
    folder = tmp_path / "home/hpcapp/standing"
    install_python(folder)
    return folder


@pytest.fixture
def jobs(tmp_path: Path, folder: Path) -> Iterator[Jobs]:
    jobs = Jobs(LocalShell("head", tmp_path / "home"), "standing")
    yield jobs
    for status in jobs.all():
        jobs.cancel(status.job)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    return write_sphere(tmp_path / "sphere.xyz")


@pytest.fixture
def held(folder: Path, standing_cluster: Callable[..., Any]) -> Iterator[None]:
    """A cluster without workers, that another program holds."""
    standing_cluster(folder, running=0)
    with held_cluster(folder / "inventory.json"):
        yield


def test_a_job_gives_the_bytes_of_a_local_run(
    jobs: Jobs, folder: Path, points: Path, tmp_path: Path, standing_cluster: Callable[..., Any]
) -> None:
    standing_cluster(folder)
    status = jobs.submit("reconstruct", points, "mesh.ply", (*OPTIONS, *ON_WORKERS))
    assert (status.job, status.title) == ("1", "sphere.xyz")
    seen = Seen()
    status = jobs.follow("1", seen)
    assert (status.state, status.exit_code) == (JobState.DONE, 0), seen.lines
    assert any("2 of 2 workers" in line for line in seen.lines)
    assert JobEvent("write", 0, 0) in seen.events
    report = jobs.fetch(status, tmp_path / "mesh.ply")
    assert report["watertight"] is True
    subprocess.run(
        [sys.executable, "-P", "-m", "hpcapp", "reconstruct", points, "-o", "local.ply", *OPTIONS],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "mesh.ply").read_bytes() == (tmp_path / "local.ply").read_bytes()
    assert jobs.log("1") == seen.lines
    again = jobs.submit("reconstruct", points, "mesh.ply", ("--grid", "20", *ON_WORKERS))
    assert jobs.follow(again.job, Seen()).state is JobState.DONE
    assert len(list((folder / "points").iterdir())) == 1


def test_nobody_else_may_read_what_a_job_leaves(
    jobs: Jobs, folder: Path, points: Path, held: None
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    for path in [folder / "points", folder / "jobs", folder / "jobs/1/job.json"]:
        assert path.stat().st_mode & 0o077 == 0


def test_a_job_that_fails_says_why_with_the_exit_code_of_its_verb(
    jobs: Jobs, folder: Path, points: Path, tmp_path: Path, standing_cluster: Callable[..., Any]
) -> None:
    standing_cluster(folder, running=0)
    nothing = tmp_path / "nothing.xyz"
    nothing.write_text("")
    for path, options, kind in (
        (points, ("--no-such-option",), UsageError),
        (nothing, (), InputError),
    ):
        status = jobs.submit("reconstruct", path, "mesh.ply", options)
        status = jobs.follow(status.job, Seen())
        assert status.state is JobState.FAILED
        with pytest.raises(kind, match=f"job {status.job} failed: "):
            jobs.fetch(status, tmp_path / "mesh.ply")
    assert not (tmp_path / "mesh.ply").exists()


def test_jobs_run_one_after_the_other_in_their_order(
    jobs: Jobs, folder: Path, points: Path, held: None
) -> None:
    for _ in range(3):
        jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    seen = Seen(WAITING, lambda: jobs.cancel("1"))
    assert jobs.follow("1", seen).state is JobState.CANCELLED
    jobs.cancel("3")
    seen = Seen(WAITING, lambda: jobs.cancel("2"))
    status = jobs.follow("2", seen)
    assert seen.lines[0] == "waiting for job 1"
    assert (status.state, status.exit_code) == (JobState.CANCELLED, 130)
    assert [job.state for job in jobs.all()] == [JobState.CANCELLED] * 3
    assert jobs.all()[2].started == ""


def test_a_cancelled_job_leaves_no_process_and_no_mesh(
    jobs: Jobs, folder: Path, points: Path, held: None, tmp_path: Path
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    seen = Seen(WAITING, lambda: jobs.cancel("1"))
    status = jobs.follow("1", seen)
    assert not list((folder / "jobs/1").glob("*mesh*"))
    with pytest.raises(JobError, match="job 1 was cancelled"):
        jobs.fetch(status, tmp_path / "mesh.ply")
    assert members(status.runner) == []
    assert jobs.cancel("1") == status  # once more does nothing


def members(group: int) -> list[int]:
    """Return the living processes of a process group."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, number = path.read_text().rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(number) == group and state != "Z":
            found.append(int(path.parent.name))
    return found


@pytest.mark.slow
def test_a_frozen_job_can_be_cancelled(
    jobs: Jobs, points: Path, held: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    runner: list[int] = []

    def freeze_and_cancel() -> None:
        runner.append(jobs.find("1").runner)
        for pid in members(runner[0]):
            if pid != runner[0]:
                os.kill(pid, signal.SIGSTOP)
        jobs.cancel("1")

    assert jobs.follow("1", Seen(WAITING, freeze_and_cancel)).state is JobState.CANCELLED
    assert members(runner[0]) == []


def test_a_killed_runner_takes_its_verb_along_and_the_status_says_so(
    jobs: Jobs, folder: Path, points: Path, held: None
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)

    def kill() -> None:
        os.kill(jobs.find("1").runner, signal.SIGKILL)

    status = jobs.follow("1", Seen(WAITING, kill))
    assert (status.state, status.exit_code) == (JobState.FAILED, 1)
    assert "its runner was killed" in status.reason
    assert members(status.runner) == []
    seen = Seen(WAITING, lambda: jobs.cancel("2"))  # the next one has its turn
    assert jobs.follow("2", seen).state is JobState.CANCELLED


def test_a_job_outlives_the_client_that_follows_it(
    jobs: Jobs, folder: Path, points: Path, held: None
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    command = [sys.executable, "-P", "-m", "hpcdeploy.jobs.runner", "--folder", str(folder)]
    client = subprocess.Popen([*command, "follow", "1"], stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    with client.stdout as output:
        assert any(WAITING in line for line in output)
    assert client.wait(PATIENCE_S) == 0  # the connection is gone, and it goes too
    assert jobs.find("1").state is JobState.RUNNING
    seen = Seen(WAITING, lambda: jobs.cancel("1"))  # another client sees all from the beginning
    assert jobs.follow("1", seen).state is JobState.CANCELLED


def test_what_is_not_there_is_named(jobs: Jobs, tmp_path: Path, folder: Path) -> None:
    with pytest.raises(UsageError, match="no job was submitted yet"):
        jobs.find(None)
    with pytest.raises(InputError, match=r"missing\.ply: cannot be read"):
        jobs.submit("reconstruct", tmp_path / "missing.ply", "mesh.ply")
    for ask in (jobs.cancel, jobs.log):
        with pytest.raises(UsageError, match="there is no job '7'"):
            ask("7")
    with pytest.raises(CloudError, match=r"job 7 cannot be followed .*there is no job '7'"):
        jobs.follow("7", Seen())


def test_a_head_that_was_not_set_up_is_named(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    with pytest.raises(CloudError, match=r"head: .*not found"):
        Jobs(LocalShell("head", tmp_path / "home"), "standing").all()


def test_a_status_of_a_later_release_is_read() -> None:
    status = JobStatus("1", JobState.DONE, mesh="mesh.ply")
    assert JobStatus.from_json(json.dumps(json.loads(status.to_json()) | {"new": 1})) == status


LIES: list[dict[str, Any]] = [
    {"mesh": "../../.bashrc"},
    {"mesh": "/etc/cron.d/mine"},
    {"mesh": ".."},
    {"mesh": "a\0b"},
    {"mesh": 7},
    {"mesh": None},
    {"job": "../../1"},
    {"job": "1; rm -rf ~"},
    {"job": 1},
    {"state": "finished"},
    {"state": []},
    {"runner": -1},
    {"runner": 1.5},
    {"runner": 10**400},
    {"exit_code": "0"},
    {"exit_code": -9},
    {"ended": "\x1b[2J"},
    {"ended": "2026-01-01"},
    {"mesh_sha256": "0" * 63 + "/"},
    {"title": "a" * 100_000},
]
NO_STATUS = ["", "{", "[]", "7", "null", '{"job": "1"}', '{"job": NaN}', "[" * 100_000, "\udcff"]


def honest(number: str = "1") -> dict[str, Any]:
    return json.loads(JobStatus(number, JobState.DONE, "sphere.xyz", "mesh.ply").to_json())  # type: ignore[no-any-return]


def written(folder: Path, number: str, text: str) -> None:
    """Leave a job on the head, as if it had been there before."""
    place = folder / "jobs" / number
    place.mkdir(parents=True)
    (place / "status.json").write_bytes(text.encode(errors="surrogateescape"))
    (place / "report.json").write_text('{"summary": "a mesh"}')
    (place / "log").write_text("what it has said\n")


@pytest.mark.parametrize("text", [*NO_STATUS, *(json.dumps(honest() | lie) for lie in LIES)])
def test_a_damaged_status_hides_no_other_job(jobs: Jobs, folder: Path, text: str) -> None:
    for number in ("1", "2", "3"):
        written(folder, number, text if number == "2" else json.dumps(honest(number)))
    (folder / "jobs/2nd").mkdir()  # nor does what somebody has put beside them
    first, damaged, last = jobs.all()
    assert (first.state, last.state) == (JobState.DONE, JobState.DONE)
    assert (damaged.job, damaged.state) == ("2", JobState.DAMAGED)
    assert "status.json is damaged" in damaged.reason
    assert "\n" not in damaged.reason
    assert jobs.log("2") == ["what it has said"]
    with pytest.raises(CloudError, match=r"job 2: its status\.json is damaged"):
        jobs.fetch(jobs.find("2"), folder / "mesh.ply")


@pytest.fixture
def answers(folder: Path) -> Callable[[str], None]:
    """Put a head in place of ours that answers every question with the same."""

    def answer(text: str) -> None:
        (folder / "answer").write_text(text)
        (folder / "venv/bin/python").write_text(f"#!/bin/sh\nexec cat {folder}/answer\n")

    return answer


@pytest.mark.parametrize(
    "line", [*NO_STATUS[1:-1], *(json.dumps(honest() | lie) for lie in LIES if "title" not in lie)]
)
def test_a_head_that_lies_is_one_row_or_one_error(
    folder: Path, tmp_path: Path, line: str, answers: Callable[[str], None]
) -> None:
    jobs = Jobs(LocalShell("head", tmp_path / "home"), "standing")
    answers(f"{line}\n{json.dumps(honest('2'))}\n")
    lie, true = jobs.all()
    assert lie.state is JobState.DAMAGED
    assert lie.job in ("1", "?")
    assert true.state is JobState.DONE
    answers(line)
    with pytest.raises(CloudError, match="head: its answer is no status of a job"):
        jobs.cancel("1")


def test_what_a_head_says_of_a_job_that_is_followed_is_not_trusted(
    folder: Path, tmp_path: Path, answers: Callable[[str], None]
) -> None:
    jobs = Jobs(LocalShell("head", tmp_path / "home"), "standing")
    lies: list[Any] = [
        {"log": 7},
        {"log": ["a"]},
        {"event": {"stage": "fit", "done": -1, "total": 2}},
        {"event": {"stage": "fit", "done": 1e400, "total": 2}},
        {"event": {"stage": "fit", "done": 10**30, "total": 2}},
        {"event": {"stage": ["fit"], "done": 1, "total": 2}},
        {"event": {"stage": "\x1b]0;mine\x07", "done": 1, "total": 2}},
        {"event": {"dashboard": "http://127.0.0.1:99999999/?token=a"}},
        {"event": {"dashboard": "http://127.0.0.1:99999/?token=a"}},
        {"event": {"dashboard": "http://127.0.0.1:65536/?token=a"}},
        {"event": {"dashboard": "http://127.0.0.1:0/?token=a"}},
        {"event": {"dashboard": "javascript:alert(1)"}},
        {"event": {"dashboard": "http://127.0.0.1:80/?token=a\x1b[2J"}},
        {"event": 3},
        {"status": honest() | {"mesh": "../x"}},
        [1],
        None,
    ]
    true = [{"log": "a line"}, {"event": {"stage": "fit", "done": 1, "total": 2}}]
    answers("\n".join(map(json.dumps, [*lies, *true, {"status": honest()}])))
    seen = Seen()
    assert jobs.follow("1", seen).state is JobState.DONE
    assert (seen.lines, seen.events) == (["a line"], [JobEvent("fit", 1, 2)])
    answers("\n".join(map(json.dumps, [*true, *lies])))
    with pytest.raises(CloudError, match="head: job 1 cannot be followed"):
        jobs.follow("1", Seen())


@pytest.mark.parametrize("text", ["", "{", "[]", '{"summary": 7}', "{}", "[" * 100_000])
def test_a_damaged_report_is_named_with_the_way_to_the_mesh(
    jobs: Jobs, folder: Path, tmp_path: Path, text: str
) -> None:
    written(folder, "1", json.dumps(honest()))
    (folder / "jobs/1/report.json").write_text(text)
    with pytest.raises(CloudError, match=r"job 1: its report is damaged .*jobs/1/mesh\.ply"):
        jobs.fetch(jobs.find("1"), tmp_path / "mesh.ply")


def test_an_unfinished_job_cannot_be_fetched(
    jobs: Jobs, points: Path, held: None, tmp_path: Path
) -> None:
    status = jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    with pytest.raises(JobError, match="hpcapp attach"):
        jobs.fetch(status, tmp_path / "mesh.ply")


def test_who_watches_is_told_once_of_workers_that_the_limits_forbid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster_job, "LOOK_S", 0.01)
    stub_set_up(monkeypatch, tmp_path / "state")
    cloud, spec = MemoryProvider(), make_spec(1)
    limits = spec.limits.model_copy(update={"max_hourly_cost": 0.5})
    cluster = make_cluster(spec.model_copy(update={"limits": limits}), cloud)
    bring_up(cluster, print)
    [head] = [machine for machine in cluster.machines() if machine.name == NodeName("head")]
    cloud.tag([head], Tags(desired=Desired(2, 5)))
    looked, look = os.pipe()
    ended = JobStatus("1", JobState.DONE)

    class Watched:
        def follow(self, job: str, display: JobDisplay) -> JobStatus:
            for _ in range(10):
                os.read(looked, 1)
            return ended

    def note(moment: str, call: str) -> None:
        if call == "observe":
            os.write(look, b".")

    cloud.hook = note
    jobs: Any = Watched()
    with caplog.at_level("INFO", "hpcapp"):
        assert cluster_job.watch(cluster, jobs, JobStatus("1", JobState.RUNNING)) == ended
    cloud.hook = None
    os.close(looked)
    os.close(look)
    said = [(record.levelname, record.getMessage()) for record in caplog.records]
    grew = "cluster bunny grew from 1 to 5 workers, by the last hpcapp scale or up"
    assert said.count(("INFO", grew)) == 1
    [warning] = [line for level, line in said if level == "WARNING"]
    assert warning.startswith("warning: lost workers are not replaced: ")
    assert "max_hourly_cost" in warning


def test_a_job_is_priced_by_the_cluster_as_it_was_scaled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stub_set_up(monkeypatch, tmp_path / "state")
    cloud, spec = MemoryProvider(), make_spec(1)
    bring_up(make_cluster(spec.scaled(4), cloud), lambda _: None)
    cluster = make_cluster(spec, cloud)
    hourly = cluster_job.make_request(cluster, ["submit", "x"]).hourly_cost
    assert hourly == pytest.approx(estimate_cost(spec, workers=4).hourly)
    assert describe_cluster(cluster, ask_machines=False)["hourly_cost"] == pytest.approx(hourly)


def test_a_worker_that_vanishes_is_replaced_while_somebody_watches(
    jobs: Jobs,
    points: Path,
    held: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(cluster_job, "LOOK_S", 0.05)
    set_up = stub_set_up(monkeypatch, tmp_path / "state")
    cloud = MemoryProvider()
    cluster = make_cluster(make_spec(2), cloud)
    bring_up(cluster, lambda _: None)
    status = jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    set_up.during = lambda: jobs.cancel(status.job)

    with when_said(caplog, WAITING, lambda: cloud.interrupt("worker-1")):
        status = cluster_job.watch(cluster, jobs, status)
    assert status.state is JobState.CANCELLED  # so the job was still watched when it came
    names = {machine.name for machine in cluster.machines()}
    assert names == {NodeName("head"), NodeName("worker-1", 2), NodeName("worker-2")}
    assert "worker-1" in set_up.calls[-1]


def test_a_cluster_is_taken_away_from_under_a_worker_that_is_being_set_up(
    jobs: Jobs,
    points: Path,
    held: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A machine that does not let us in is waited for, and the journal held, for many minutes."""
    cloud = MemoryProvider()
    log_in = Access.open

    def let_in(access: Access, machine: MachineSeen, timeout_s: float | None = None) -> object:
        is_head = machine.name == NodeName("head")
        return ExitStack() if is_head else log_in(access, machine, timeout_s)

    def set_up(
        spec: ClusterSpec, machines: Sequence[MachineSeen], access: Access, report: object
    ) -> dict[str, str]:
        late = [machine for machine in machines if machine.name.generation > 1]
        if late:
            jobs.cancel("1")
            with pytest.raises(CloudError, match="no longer waited for"):
                access.open(late[0], timeout_s=600.0)
        return {machine.id: "it does not let us in" for machine in late}

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(cluster_job, "LOOK_S", 0.05)
    monkeypatch.setattr(cluster_job, "open_jobs", lambda cluster: jobs)
    monkeypatch.setattr("hpcdeploy.providers.open_provider", lambda spec, base: cloud)
    monkeypatch.setattr(Access, "open", let_in)
    monkeypatch.setattr("hpcdeploy.install.bootstrap.set_up", set_up)
    monkeypatch.setattr("hpcdeploy.install.user_data.user_data", lambda *about: "#!")
    file = tmp_path / "cluster.yaml"
    file.write_text(FILE.format(cluster="bunny", count=1, least=0, market="on_demand"))
    with (
        when_said(caplog, WAITING, lambda: cloud.interrupt("worker-1")),
        pytest.raises(JobError, match="job 1 was cancelled"),
    ):
        cluster_job.run_on_cluster(file, "reconstruct", points, tmp_path / "mesh.ply", ON_WORKERS)
    seen = cloud.observe("bunny")
    assert not seen.lives
    assert {machine.state for machine in seen.machines} == {State.GONE}
