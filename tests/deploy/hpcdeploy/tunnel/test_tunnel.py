"""A master that is not on the head: real workers, a real relay, a real SSH connection."""

from __future__ import annotations

import json
import logging
import os
import shlex
import socket
import struct
import threading
import urllib.request
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import paramiko
import pytest
import zmq
from heads import install_python, when_said
from machines.servers import USER, Machines, Server

from hpcapp.backends.cluster import listen_inventory
from hpcapp.dashboard.server import open_dashboard
from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.timeline import Timeline
from hpccomponent.errors import CloudError
from hpccomponent.inventory import hold_cluster
from hpcdeploy.jobs.display import ForwardingDisplay, JobDisplay, JobEvent
from hpcdeploy.jobs.queries import Jobs
from hpcdeploy.login.local_shell import LocalShell
from hpcdeploy.login.ssh.connect import connect
from hpcdeploy.login.ssh.shell import SshShell
from hpcdeploy.login.ssh.target import SshTarget
from hpcdeploy.tunnel import tunnel
from hpcdeploy.tunnel.relay import WANTED
from hpcdeploy.tunnel.tunnel import lead_workers

FOLDER = "hpcapp/standing"


@pytest.fixture(scope="module", autouse=True)
def _keep_the_thread_of_zero_copy_sends() -> None:
    """Make pyzmq start the one thread that it keeps for the process, before leaks are counted."""
    with zmq.Context() as context, context.socket(zmq.PAIR) as one, context.socket(zmq.PAIR) as two:
        one.bind("inproc://warm-up")
        two.connect("inproc://warm-up")
        one.send(bytes(1 << 20), copy=False)
        two.recv()


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with Machines.open(tmp_path) as machines:
        yield machines


@pytest.fixture
def head(machines: Machines) -> Server:
    server = machines.add()
    install_python(server.home / FOLDER)
    return server


@pytest.fixture
def shell(head: Server, tmp_path: Path) -> Iterator[SshShell]:
    key = paramiko.RSAKey.generate(2048)
    key.write_private_key_file(str(tmp_path / "id"))
    head.keys.append(f"ssh-rsa {key.get_base64()}")
    target = SshTarget(head.address, head.port, USER, (str(tmp_path / "id"),), (head.known,))
    with ExitStack() as closer:
        connection = connect(target, closer)
        with SshShell("head", connection, closer.pop_all()) as shell:
            yield shell


def submit(executor: Any, right: float) -> Any:
    return executor.submit("quadrature.estimate", "wave", np.zeros(1), np.array([right]))


def test_workers_reach_a_master_elsewhere(
    shell: SshShell, head: Server, tmp_path: Path, standing_cluster: Callable[..., Any]
) -> None:
    cluster = standing_cluster(head.home / FOLDER)
    copy = tmp_path / "copy.json"
    shell.get(f"{FOLDER}/inventory.json", copy)
    copy.chmod(0o600)
    lead = partial(lead_workers, shell, FOLDER)
    results = []
    for _ in range(2):  # one master after the other, over one connection
        with listen_inventory(copy, lead=lead) as master:
            executor, workers = master.executor, master.gather()
            assert workers == 2
            assert executor.endpoint != cluster.endpoint
            futures = [submit(executor, right) for right in range(20)]
            results.append([future.result(60).tolist() for future in futures])
            large = np.random.default_rng(7).random(300_000)
            sums: Any = executor.submit("quadrature.estimate", "wave", large, large + 1.0).result(
                60
            )
            assert len(sums) >= 2
    assert results[0] == results[1]
    assert not any("secret" in command for command in head.commands)


def test_a_relay_that_says_nothing_is_given_up(
    shell: SshShell, head: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tunnel, "ANSWER_S", 0.2)
    (head.home / FOLDER / "venv/bin/python").write_text("#!/bin/sh\nexec sleep 1000\n")
    with (
        pytest.raises(CloudError, match="the relay on the head has not said its port within 0 s"),
        lead_workers(shell, FOLDER, "tcp://127.0.0.1:1"),
    ):
        pass


def test_a_relay_that_says_something_else_without_an_end_is_given_up(
    shell: SshShell, head: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tunnel, "ANSWER_S", 0.2)
    (head.home / FOLDER / "venv/bin/python").write_text(
        "#!/bin/sh\nwhile echo no port; do sleep 0.01; done\n"
    )
    with (
        pytest.raises(CloudError, match="not said its port within 0 s") as caught,
        lead_workers(shell, FOLDER, "tcp://127.0.0.1:1"),
    ):
        pass
    assert set(caught.value.excerpt.splitlines()) == {"no port"}


class Line(str):
    """A line whose end can be seen."""


class Talkative(LocalShell):
    """A head whose relay goes on talking once it has said its port."""

    def __init__(self, home: Path, port: int) -> None:
        super().__init__("head", home)
        self._port = port
        self.is_led, self.has_talked, self.is_over = (threading.Event() for _ in range(3))
        self.lines: list[weakref.ref[Line]] = []

    def follow(self, command: str, on_line: Callable[[str], None]) -> int:
        on_line(json.dumps({"port": self._port}))
        self.is_led.wait(60)
        for _ in range(1000):
            line = Line("talk")
            self.lines.append(weakref.ref(line))
            on_line(line)
        del line
        self.has_talked.set()
        self.is_over.wait(60)
        return 0


def test_what_a_relay_says_besides_is_not_kept(relay: socket.socket, tmp_path: Path) -> None:
    shell = Talkative(tmp_path, relay.getsockname()[1])
    with lead_workers(shell, FOLDER, "tcp://127.0.0.1:9"), relay.accept()[0]:
        shell.is_led.set()
        assert shell.has_talked.wait(60)
        assert all(line() is None for line in shell.lines)
        shell.is_over.set()


def test_a_master_elsewhere_waits_for_its_turn(
    shell: SshShell,
    head: Server,
    standing_cluster: Callable[..., Any],
    caplog: pytest.LogCaptureFixture,
) -> None:
    cluster = standing_cluster(head.home / FOLDER, running=0)
    with ExitStack() as ownership:
        ownership.enter_context(hold_cluster(cluster.inventory, pytest.fail))
        with (
            when_said(caplog, "in use by another program", ownership.close),
            lead_workers(shell, FOLDER, "tcp://127.0.0.1:9"),
        ):
            pass


@pytest.fixture
def relay(tmp_path: Path) -> Iterator[socket.socket]:
    """Yield what stands where a relay listens, of a head that is ``tmp_path``."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60)
        os.mkfifo(tmp_path / "ended")
        said = json.dumps({"port": server.getsockname()[1]})
        install_python(tmp_path / FOLDER, f"echo {shlex.quote(said)}\nexec cat {tmp_path}/ended")
        yield server


@contextmanager
def lead_from(relay: socket.socket, home: Path, endpoint: str) -> Iterator[socket.socket]:
    """Lead workers to a master; yield the control connection."""
    with (
        lead_workers(LocalShell("head", home), FOLDER, endpoint),
        relay.accept()[0] as control,
        (home / "ended").open("w"),
    ):
        control.settimeout(60)
        yield control


def test_a_way_to_no_master_is_closed(relay: socket.socket, tmp_path: Path) -> None:
    with lead_from(relay, tmp_path, "tcp://127.0.0.1:9") as control:
        control.send(WANTED)
        with relay.accept()[0] as way:
            way.settimeout(60)
            assert way.recv(1) == b""


def test_a_way_that_is_cut_is_said(
    relay: socket.socket, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    said = threading.Event()
    with (
        when_said(caplog, "its workers are lost", said.set),
        lead_from(relay, tmp_path, "tcp://127.0.0.1:9") as control,
    ):
        control.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        control.close()  # it is reset
        assert said.wait(60)


def test_a_head_without_a_relay_is_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(CloudError, match=r"the relay ended \(127\).*not found.*hpcapp doctor"),
        lead_workers(LocalShell("head", tmp_path), FOLDER, "tcp://127.0.0.1:9"),
    ):
        pass


def test_a_cluster_that_was_not_set_up_is_one_line(tmp_path: Path) -> None:
    install_python(tmp_path / FOLDER)
    with (
        pytest.raises(CloudError, match=r"inventory\.json: cannot be read"),
        lead_workers(LocalShell("head", tmp_path), FOLDER, "tcp://127.0.0.1:9"),
    ):
        pass


def test_a_page_on_the_head_is_reached_through_ssh(
    shell: SshShell, caplog: pytest.LogCaptureFixture
) -> None:
    job = WatchedJob(Timeline(), "far away")
    display = ForwardingDisplay(JobDisplay(), Jobs(shell, "standing").forward)
    with caplog.at_level(logging.INFO, "hpcapp"), open_dashboard("127.0.0.1:0", job) as there:
        display.show_event(JobEvent(dashboard=there))
        here = caplog.messages[-1].removeprefix("dashboard: ")
        assert urlsplit(here).port != urlsplit(there).port
        assert urlsplit(here).query == urlsplit(there).query
        with urllib.request.urlopen(here, timeout=60) as answer:  # noqa: S310 - loopback
            assert b"far away" in answer.read()
