"""Components as processes: how they start, and that they always end."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq
from contract_tasks import wait_for_file

from hpccomponent.protocol.connection import Connection, write_connection
from hpccomponent.protocol.keys import make_key_pair
from hpccomponent.protocol.messages import (
    Refused,
    Register,
    Registered,
    decode_component_message,
    encode_message,
)
from hpccomponent.runtime.component import CONNECT_AGAIN_S

Start = Callable[..., "subprocess.Popen[str]"]


class Master:
    """A ROUTER that the test speaks through."""

    def __init__(self, router: zmq.Socket[bytes], public: str) -> None:
        self.router = router
        self.public = public
        self.endpoint = f"tcp://127.0.0.1:{router.bind_to_random_port('tcp://127.0.0.1')}"

    def hear_register(self) -> tuple[bytes, Register]:
        assert self.router.poll(30_000)
        identity, frame = self.router.recv_multipart()
        message = decode_component_message(frame)
        assert isinstance(message, Register)
        return identity, message


@pytest.fixture
def master() -> Iterator[Master]:
    keys = make_key_pair()
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.setsockopt(zmq.LINGER, 0)
        router.setsockopt(zmq.CURVE_SERVER, 1)
        router.setsockopt(zmq.CURVE_SECRETKEY, keys.secret.encode())
        yield Master(router, keys.public)


@pytest.fixture
def start(master: Master, tmp_path: Path) -> Iterator[Start]:
    started: list[subprocess.Popen[str]] = []

    def start(
        *arguments: str, pass_fds: tuple[int, ...] = (), endpoint: str = master.endpoint
    ) -> subprocess.Popen[str]:
        keys = make_key_pair()
        connection = Connection(endpoint, master.public, keys.public, keys.secret, "w")
        write_connection(tmp_path / "connection.json", connection)
        command = [sys.executable, "-P", "-m", "hpccomponent"]
        command += ["--connection", str(tmp_path / "connection.json"), *arguments]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, pass_fds=pass_fds)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def children(pid: int) -> list[int]:
    """The list that the kernel keeps of them may lack some: so each process is asked."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if int((process / "stat").read_text().rsplit(")", 1)[1].split()[1]) == pid:
                found.append(int(process.name))
    return found


def forward(source: socket.socket, sink: socket.socket) -> None:
    """Pass on all that comes."""
    with contextlib.suppress(OSError):
        while part := source.recv(65536):
            sink.sendall(part)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_it_introduces_itself_with_its_build(master: Master, start: Start) -> None:
    start("--build", "portable")
    identity, register = master.hear_register()
    assert identity.startswith(b"w/")
    assert register.build == "portable"
    assert register.numerics.startswith("portable-")
    assert register.cores >= 1


def test_sigterm_ends_it_and_its_worker(master: Master, start: Start) -> None:
    component = start()
    master.hear_register()
    (worker,) = children(component.pid)
    component.send_signal(signal.SIGINT)  # the terminal's Ctrl-C is not for it
    component.terminate()
    assert component.wait() == 0
    assert not is_alive(worker)


def test_the_end_of_the_lifeline_ends_it(master: Master, start: Start) -> None:
    reading, writing = os.pipe()
    component = start("--lifeline-fd", str(reading), pass_fds=(reading,))
    os.close(reading)
    master.hear_register()
    os.close(writing)
    assert component.wait() == 0


def test_a_killed_component_takes_its_worker_along(master: Master, start: Start) -> None:
    component = start()
    master.hear_register()
    (worker,) = children(component.pid)
    component.kill()
    component.wait()
    gone = os.pidfd_open(worker) if is_alive(worker) else None
    if gone is not None:
        poller = zmq.Poller()
        poller.register(gone, zmq.POLLIN)
        assert poller.poll(10_000), "the worker outlived its component"
        os.close(gone)


def test_a_worker_imports_its_tasks_while_it_waits_for_the_first(
    master: Master, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the import of some of them does."""
    imported = tmp_path / "imported"
    (tmp_path / "leaves.py").write_text("raise SystemExit(3)")
    (tmp_path / "works.py").write_text(f"import pathlib; pathlib.Path({str(imported)!r}).touch()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    component = start("--task", "one=leaves:f", "--task", "two=works:f")
    master.hear_register()
    wait_for_file(str(imported))
    assert len(children(component.pid)) == 1


def test_a_refused_component_says_why_and_asks_not_to_be_started_again(
    master: Master, start: Start
) -> None:
    component = start()
    identity, _ = master.hear_register()
    master.router.send_multipart([identity, encode_message(Refused("wrong release"))])
    assert component.wait() == 2
    assert component.stderr is not None
    assert "wrong release" in component.stderr.read()


def test_a_handshake_that_was_broken_off_is_made_again_once(master: Master, start: Start) -> None:
    """A master that is slow to answer ends it; what comes after that works, and is left alone."""
    host, port = master.endpoint.removeprefix("tcp://").split(":")
    with socket.create_server(("127.0.0.1", 0)) as way:
        start(endpoint=f"tcp://127.0.0.1:{way.getsockname()[1]}")
        way.accept()[0].close()
        (one, _), other = way.accept(), socket.create_connection((host, int(port)))
        with one, other:
            for ends in ((one, other), (other, one)):
                threading.Thread(target=forward, args=ends, daemon=True).start()
            master.hear_register()
            way.settimeout(CONNECT_AGAIN_S + 1.0)
            with pytest.raises(TimeoutError):
                way.accept()
            for end in (one, other):
                end.shutdown(socket.SHUT_RDWR)


def test_a_silent_master_is_left(master: Master, start: Start) -> None:
    component = start()
    identity, _ = master.hear_register()
    welcome = Registered("s", 0.1, 0.5, 1 << 20)
    master.router.send_multipart([identity, encode_message(welcome)])
    assert component.wait() == 5
    assert component.stderr is not None
    assert "silent" in component.stderr.read()


def test_junk_from_the_master_is_dropped(master: Master, start: Start) -> None:
    component = start()
    identity, _ = master.hear_register()
    master.router.send_multipart([identity, b"junk"])
    master.router.send_multipart([identity, b"", b"x", b"y"])
    master.router.send_multipart([identity, encode_message(Refused("the end"))])
    assert component.wait() == 2


def test_usage_and_configuration_errors_exit_2(start: Start, tmp_path: Path) -> None:
    component = start("--task", "malformed")
    assert component.wait() == 2
    assert component.stderr is not None
    assert "NAME=module:function" in component.stderr.read()
    (tmp_path / "connection.json").unlink()
    command = [sys.executable, "-P", "-m", "hpccomponent", "--connection", str(tmp_path / "none")]
    missing = subprocess.run(command, capture_output=True, text=True, check=False)
    assert missing.returncode == 2
    assert "Traceback" not in missing.stderr
    assert missing.stderr.count("\n") == 1


@pytest.mark.parametrize("module", ["hpccomponent.__main__", "hpccomponent.runtime.worker"])
def test_start_up_imports_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    listed = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    heavy = {"scipy", "pydantic", "skimage", "rich", "click", "yaml", "asyncio"}
    if "worker" not in module:
        heavy |= {"numpy"}
    assert heavy.isdisjoint(listed)
