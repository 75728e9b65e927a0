"""Ray, by a real one that runs on this machine."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from process_tree import are_gone, descendants

from hpcapp.backends.engines import RAY
from hpcapp.backends.selection import Backend, open_executor
from hpcapp.kernels.build import kernel_id
from hpcapp.workforce import map_batches
from hpccomponent.errors import NoWorkersError, TaskError, UsageError

# Ray keeps threads as long as it runs. It is not imported here: that is the backend's to do.
pytestmark = [
    pytest.mark.leaks_allowed,
    pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed"),
]

StartCommand = Callable[..., "subprocess.Popen[str]"]
PROGRAM = """
import sys
from hpcapp.backends.selection import open_executor

if __name__ == "__main__":
    with open_executor("ray", workers=2) as backend:
        print(backend.executor.submit(pow, 2, 3).result(), flush=True)
        sys.stdin.read()
"""
SHARE = """
import sys
from hpcapp.backends.selection import open_executor

if __name__ == "__main__":
    with open_executor("ray", workers=2) as backend:
        print(flush=True)
        sys.stdin.readline()
        backend.workforce.share(bytes(1 << 20))
"""
HIDE_RAY = """
import sys

sys.modules["ray"] = None
"""


@pytest.fixture(scope="module")
def backend(tasks: ModuleType) -> Iterator[Backend]:
    with open_executor("ray", workers=2) as opened:
        yield opened


def find_processes(word: str) -> list[int]:
    """Return the processes whose command line names something."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and word.encode() in (folder / "cmdline").read_bytes():
                found.append(int(folder.name))
        except OSError:  # it has ended
            continue
    return found


@pytest.mark.slow
def test_the_command_gives_the_same_bytes_and_leaves_nothing(
    sphere_file: Path, tmp_path: Path, start_command: StartCommand
) -> None:
    for name, options in (("ray.ply", ["ray", "--workers", "2"]), ("here.ply", ["serial"])):
        command = start_command(
            "reconstruct", str(sphere_file), "-o", name, "--grid", "32", "--backend", *options
        )
        printed, said = command.communicate()
        assert command.returncode == 0, said
        assert "raylet" not in printed + said
    assert (tmp_path / "ray.ply").read_bytes() == (tmp_path / "here.ply").read_bytes()
    assert not list(tmp_path.glob("hpcapp-*"))


@pytest.mark.slow
def test_nothing_is_left_of_a_killed_master() -> None:
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp") as folder:  # a short path
        with subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM],
            env={**os.environ, "TMPDIR": folder},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as master:
            assert master.stdout is not None
            assert master.stdout.readline() == "8\n"
            below = descendants(master.pid)
            master.kill()
        assert len(below) > 4
        assert are_gone(below)
        assert os.listdir(folder) == []


@pytest.mark.slow
def test_a_master_that_ray_ends_with_itself_says_why() -> None:
    """Ray's agents take its raylet along, and that whoever asks for an object."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", SHARE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as master:
        assert master.stdout is not None
        assert master.stdout.readline() == "\n"
        below = descendants(master.pid)
        (agent,) = below & set(find_processes("DashboardAgent"))
        (raylet,) = below & set(find_processes("raylet/raylet"))
        gone = os.pidfd_open(raylet)
        os.kill(agent, signal.SIGKILL)
        assert select.select([gone], [], [], 60.0)[0]
        os.close(gone)
        _, said = master.communicate("\n")
    assert master.returncode == 1
    assert "Ray has ended under the job" in said
    assert "Traceback" not in said
    assert are_gone(below)


@pytest.mark.slow
def test_tasks_of_a_killed_worker_run_again(
    backend: Backend, tasks: ModuleType, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    released = str(tmp_path / "released")
    started = [str(tmp_path / name) for name in ("one", "two")]
    futures = [backend.executor.submit(tasks.announce_and_wait, name, released) for name in started]
    for name in started:
        tasks.wait_for_file(name)
    victim = int(Path(started[0]).read_text())
    os.kill(victim, signal.SIGKILL)
    Path(released).touch()
    assert victim not in {future.result(60) for future in futures}
    assert "died" not in "".join(capfd.readouterr())


def test_what_a_task_raises_is_the_tasks(backend: Backend, tasks: ModuleType) -> None:
    with pytest.raises(TaskError, match="ValueError: no luck") as caught:
        map_batches(backend.workforce, tasks.fail, [("no luck",)])
    assert "\n" not in str(caught.value)


def test_a_shared_value_comes_to_every_task(backend: Backend, tasks: ModuleType) -> None:
    value = np.random.default_rng(1).standard_normal(900_000)
    shared = backend.workforce.share(value)
    assert shared is not value
    batches = [(number, ("nested", shared)) for number in range(4)]
    for number, (word, found) in map_batches(backend.workforce, tasks.echo, batches):
        assert (word, number in range(4)) == ("nested", True)
        assert found.tobytes() == value.tobytes()
    assert map_batches(backend.workforce, tasks.total, [(shared,)]) == [tasks.total(value)]


def test_a_result_can_be_written_to(backend: Backend, tasks: ModuleType) -> None:
    (found,) = map_batches(backend.workforce, tasks.echo, [(np.zeros(100_000),)])
    found[0] = 1.0
    assert found.sum() == 1.0


def test_workers_compute_on_one_thread(backend: Backend, tasks: ModuleType) -> None:
    _, _, threads = backend.executor.submit(tasks.read_process).result(60)
    assert threads == "1"


def test_nothing_listens_beyond_loopback(backend: Backend) -> None:
    inodes = set()
    for process in [os.getpid(), *find_processes(f"_{os.getpid()}/sockets/raylet")]:
        for descriptor in (Path("/proc") / str(process) / "fd").iterdir():
            if descriptor.is_symlink() and "socket:" in os.readlink(descriptor):
                inodes.add(os.readlink(descriptor)[len("socket:[") : -1])
    addresses = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                addresses.append(fields[1].rpartition(":")[0])
    assert addresses
    assert all(address.endswith("0100007F") for address in addresses)


def test_a_process_uses_one_ray_at_a_time(backend: Backend) -> None:
    with pytest.raises(UsageError, match="uses Ray already"), open_executor("ray", workers=1):
        pass


def test_no_workers_are_none(backend: Backend) -> None:
    with pytest.raises(UsageError, match="cannot have 0 workers"), open_executor("ray", workers=0):
        pass


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_where_nothing_listens_is_named(scheme: str) -> None:
    with (
        pytest.raises(NoWorkersError, match=r"no Ray answers at 127.0.0.1:9 .*; start one with"),
        open_executor(f"ray={scheme}127.0.0.1:9"),
    ):
        pass


def test_an_address_where_something_else_listens_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def answer() -> None:
            with server.accept()[0] as connection:
                connection.sendall(b"SSH-2.0-OpenSSH_9.9\r\n")
                connection.recv(100)

        thread = threading.Thread(target=answer)
        thread.start()
        with (
            pytest.raises(NoWorkersError, match="something else listens there"),
            open_executor(f"ray=127.0.0.1:{port}"),
        ):
            pass
        thread.join()


@pytest.mark.parametrize("name", ["ray=", "ray=host", "ray=http://host:1", "ray=auto:1x"])
def test_what_is_no_address_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match="names no Ray; write ray, ray=auto"), open_executor(name):
        pass


def test_addresses_are_told_from_a_ray_of_this_machine() -> None:
    found = {name: RAY.fullmatch(name) for name in ("ray", "ray=auto", "ray=h:1", "ray=ray://h:1")}
    assert [match and match[1] for match in found.values()] == [None, "auto", "h:1", "ray://h:1"]


def test_without_ray_the_command_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(HIDE_RAY)
    done = subprocess.run(
        [sys.executable, "-m", "hpcapp", "reconstruct", "a.ply", "-o", "b.ply", "--backend", "ray"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("hpcapp: Ray is not installed here; ")
    assert done.stderr.endswith(" -m pip install 'ray[client]>=2.52'\n")


class StandingRay:
    """A Ray of one node on loopback, as ``ray start`` starts it.

    Parameters
    ----------
    folder : pathlib.Path
        Gets the log.
    variables : dict
        Environment of all its processes.
    """

    def __init__(self, folder: Path, variables: dict[str, str]) -> None:
        self._place = tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp")  # its sockets' paths
        with (
            socket.create_server(("127.0.0.1", 0)) as one,
            socket.create_server(("127.0.0.1", 0)) as two,
        ):
            self.port, self.client_port = one.getsockname()[1], two.getsockname()[1]
        command = [
            sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block",
            "--node-ip-address=127.0.0.1", f"--port={self.port}", "--num-cpus=2",
            f"--ray-client-server-port={self.client_port}", "--include-dashboard=false",
            "--object-store-memory=100000000", f"--temp-dir={self._place.name}",
        ]  # fmt: skip
        quiet = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
        with (folder / "log").open("wb") as log:
            self.head = subprocess.Popen(
                command, env={**os.environ, **quiet, **variables}, stdout=log, stderr=log
            )

    def wait_until_it_listens(self) -> None:
        for port in (self.port, self.client_port):
            while True:
                with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                    break
                with suppress(subprocess.TimeoutExpired):  # between two looks
                    raise AssertionError(f"Ray has not started: {self.head.wait(0.05)}")

    def close(self) -> None:
        self.head.terminate()
        self.head.wait()
        self._place.cleanup()


@pytest.fixture
def start_ray(tmp_path: Path) -> Iterator[Callable[..., StandingRay]]:
    """Give a function that starts a Ray."""
    started: list[StandingRay] = []

    def start(**variables: str) -> StandingRay:
        started.append(StandingRay(tmp_path, variables))
        started[-1].wait_until_it_listens()
        return started[-1]

    yield start
    for ray in started:
        ray.close()


@pytest.mark.slow
def test_a_ray_that_runs_gives_the_same_bytes(
    start_ray: Callable[..., StandingRay],
    sphere_file: Path,
    tmp_path: Path,
    start_command: StartCommand,
) -> None:
    ray = start_ray()
    backends = {"there": f"ray=ray://127.0.0.1:{ray.client_port}", "here": "serial"}
    for name, backend in backends.items():
        command = start_command(
            "reconstruct", str(sphere_file), "-o", f"{name}.ply", "--grid", "32",
            "--backend", backend,
        )  # fmt: skip
        _, said = command.communicate()
        assert command.returncode == 0, said
    meshes = {(tmp_path / f"{name}.ply").read_bytes() for name in backends}
    assert len(meshes) == 1


@pytest.mark.slow
def test_a_worker_of_another_build_refuses_and_says_why(
    start_ray: Callable[..., StandingRay], sphere_file: Path, start_command: StartCommand
) -> None:
    other = "native" if kernel_id().startswith("portable") else "portable"
    ray = start_ray(HPCAPP_BUILD=other)
    command = start_command(
        "reconstruct", str(sphere_file), "-o", "mesh.ply", "--grid", "32",
        "--backend", f"ray=127.0.0.1:{ray.port}",
    )  # fmt: skip
    _, said = command.communicate()
    assert command.returncode == 1
    assert f"computes with {other}-" in said
    assert "install the same build" in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_a_worker_without_hpcapp_is_named(
    start_ray: Callable[..., StandingRay],
    sphere_file: Path,
    tmp_path: Path,
    start_command: StartCommand,
) -> None:
    (tmp_path / "sitecustomize.py").write_text(
        'import sys\nsys.modules["hpcapp.backends"] = None\n'
    )
    ray = start_ray(PYTHONPATH=str(tmp_path))
    command = start_command(
        "reconstruct", str(sphere_file), "-o", "mesh.ply", "--grid", "32",
        "--backend", f"ray=127.0.0.1:{ray.port}",
    )  # fmt: skip
    _, said = command.communicate()
    assert command.returncode == 1
    assert "install the same build of hpcapp on every node" in said
    assert "Traceback" not in said
