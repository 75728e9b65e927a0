"""Which keys may connect, and that those who are early wait for somebody to answer."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.communicator.listener import Listener
from hpccomponent.errors import UsageError
from hpccomponent.protocol.keys import make_key_pair

WAIT = 20.0


def _listens(listener: Listener) -> bool:
    host, port = listener.endpoint.removeprefix("tcp://").split(":")
    try:
        with socket.create_connection((host, int(port)), timeout=WAIT):
            return True
    except ConnectionRefusedError:
        return False


def test_an_address_of_another_machine_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="cannot listen on"):
        Listener("tcp://192.0.2.1:1")


def test_what_is_no_key_is_refused_before_anything_listens() -> None:
    with pytest.raises(UsageError, match="not a Z85 CURVE key"):
        Listener(workers={"short": "one"})


def test_an_invitation_says_all_that_a_component_must_know() -> None:
    keys = make_key_pair()
    with Listener(keys=keys) as listener:
        one, two = listener.invite("one"), listener.invite("two")
        assert (one.endpoint, one.server_key, one.worker) == (listener.endpoint, keys.public, "one")
        assert one.public_key != two.public_key


def test_a_door_that_nobody_answers_closes_with_its_block() -> None:
    with Listener() as listener:
        assert _listens(listener)
    assert not _listens(listener)


def test_who_answers_closes_it() -> None:
    with Listener() as listener:
        with CommunicatorExecutor(listener) as executor:
            assert executor.endpoint == listener.endpoint
            assert _listens(listener)
        assert not _listens(listener)


def test_nothing_heavy_is_imported_for_it() -> None:
    code = "import sys, hpcapp.backends.local_cluster; print('numpy' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    )
    assert found.stdout == "False\n"


STRANGERS = 2600  # by default libzmq keeps 2,000 events, and then waits


def test_a_crowd_at_a_door_that_nobody_answers_does_not_hold_up_its_end() -> None:
    with Listener() as listener:
        host, port = listener.endpoint.removeprefix("tcp://").split(":")
        for _ in range(STRANGERS):
            with socket.create_connection((host, int(port)), timeout=WAIT) as stranger:
                stranger.recv(10)  # the greeting: libzmq's thread is alive
                stranger.send(b"GET / HTTP/1.0\r\n\r\n".ljust(64))
    assert not _listens(listener)


FLOOD = """
import os, signal, sys
import zmq
from hpccomponent.protocol.connection import read_connection

connection = read_connection(sys.argv[1])
dealer = zmq.Context().socket(zmq.DEALER)
dealer.setsockopt(zmq.CURVE_SERVERKEY, connection.server_key.encode())
dealer.setsockopt(zmq.CURVE_PUBLICKEY, connection.public_key.encode())
dealer.setsockopt(zmq.CURVE_SECRETKEY, connection.secret_key.encode())
dealer.connect(connection.endpoint)
while dealer.poll(300, zmq.POLLOUT):  # until the master's queue is full, and this one
    dealer.send(bytes(2000))
os.kill(os.getpid(), signal.SIGKILL)
"""
MASTER = """
import subprocess, sys
from hpcapp.communicator.listener import Listener
from hpccomponent.protocol.connection import write_connection

listener = Listener()
write_connection(sys.argv[1], listener.invite("flood"))
transport = listener.answer()
flood = subprocess.Popen([sys.executable, "-P", "-c", sys.argv[2], sys.argv[1]])
while transport.receive() is None:
    transport.wait(1.0)
print(flood.wait(), flush=True)
sys.stdin.read()
while transport.receive() is not None:
    pass
transport.close()
"""
PROBES_S = 4.0  # as long as several probes take


@pytest.mark.slow
def test_a_peer_that_breaks_off_while_its_messages_wait_does_not_abort_the_master(
    tmp_path: Path,
) -> None:
    with subprocess.Popen(
        [sys.executable, "-P", "-c", MASTER, str(tmp_path / "flood.json"), FLOOD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as master:
        assert master.stdout is not None
        assert master.stdout.readline() == "-9\n"
        with pytest.raises(subprocess.TimeoutExpired):
            master.wait(PROBES_S)
        assert master.communicate()[1] == ""
    assert master.returncode == 0
