"""The door: who may come in, and that those who are early wait for somebody to answer."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from hpcapp.communicator.door import Door
from hpcapp.communicator.executor import CommunicatorExecutor
from hpccomponent.errors import UsageError
from hpccomponent.protocol.keys import make_key_pair

WAIT = 20.0


def _listens(door: Door) -> bool:
    host, port = door.endpoint.removeprefix("tcp://").split(":")
    try:
        with socket.create_connection((host, int(port)), timeout=WAIT):
            return True
    except ConnectionRefusedError:
        return False


def test_an_address_of_another_machine_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="cannot listen on"):
        Door("tcp://192.0.2.1:1")


def test_what_is_no_key_is_refused_before_anything_listens() -> None:
    with pytest.raises(UsageError, match="not a Z85 CURVE key"):
        Door(allowed_keys=["short"])


def test_an_invitation_says_all_that_a_component_must_know() -> None:
    keys = make_key_pair()
    with Door(keys=keys) as door:
        one, two = door.invite("one"), door.invite("two")
        assert (one.endpoint, one.server_key, one.worker) == (door.endpoint, keys.public, "one")
        assert one.public_key != two.public_key


def test_a_door_that_nobody_answers_closes_with_its_block() -> None:
    with Door() as door:
        assert _listens(door)
    assert not _listens(door)


def test_who_answers_closes_it() -> None:
    with Door() as door:
        with CommunicatorExecutor(door) as executor:
            assert executor.endpoint == door.endpoint
            assert _listens(door)
        assert not _listens(door)


def test_nothing_heavy_is_imported_for_it() -> None:
    code = "import sys, hpcapp.local_machines; print('numpy' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    )
    assert found.stdout == "False\n"
