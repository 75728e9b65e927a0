from __future__ import annotations

import json
from pathlib import Path

import pytest

from hpccomponent.errors import ConfigError, OutputError
from hpccomponent.protocol.connection import Connection, read_connection, write_connection
from hpccomponent.protocol.keys import is_key, make_key_pair


@pytest.fixture
def connection() -> Connection:
    master, worker = make_key_pair(), make_key_pair()
    return Connection("tcp://127.0.0.1:5", master.public, worker.public, worker.secret, "w-1")


def test_it_comes_back_and_is_for_its_owner_only(tmp_path: Path, connection: Connection) -> None:
    path = tmp_path / "connection.json"
    write_connection(path, connection)
    assert read_connection(path) == connection
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_keys_are_keys_and_secrets_are_not_shown(connection: Connection) -> None:
    assert is_key(connection.server_key)
    assert not is_key(b"bytes")
    assert connection.secret_key not in repr(connection)
    pair = make_key_pair()
    assert pair.secret not in repr(pair)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_a_file_that_others_may_read_is_refused(
    tmp_path: Path, connection: Connection, mode: int
) -> None:
    path = tmp_path / "connection.json"
    write_connection(path, connection)
    path.chmod(mode)
    with pytest.raises(ConfigError, match=r"connection\.json.*chmod 600"):
        read_connection(path)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"endpoint": None}, "endpoint"),
        ({"endpoint": "127.0.0.1"}, "endpoint"),
        ({"server_key": "short"}, "server_key"),
        ({"secret_key": 5}, "secret_key"),
        ({"worker": ""}, "worker"),
        ({"worker": "a\nb"}, "worker"),
        ({"version": 2}, "version"),
        ({"further": 1}, "further"),
    ],
)
def test_a_wrong_entry_is_named(
    tmp_path: Path, connection: Connection, changes: dict[str, object], key: str
) -> None:
    path = tmp_path / "connection.json"
    write_connection(path, connection)
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(ConfigError, match=f"connection.json: {key}"):
        read_connection(path)


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"\xff\xfe"])
def test_what_is_no_json_object_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "connection.json"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=r"connection\.json"):
        read_connection(path)


def test_missing_entries_and_files_are_named(tmp_path: Path, connection: Connection) -> None:
    path = tmp_path / "connection.json"
    with pytest.raises(ConfigError, match="No such file"):
        read_connection(path)
    write_connection(path, connection)
    entries = json.loads(path.read_text())
    del entries["server_key"]
    path.write_text(json.dumps(entries))
    with pytest.raises(ConfigError, match="server_key: is missing"):
        read_connection(path)


def test_writing_into_nowhere_is_an_output_error(tmp_path: Path, connection: Connection) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_connection(tmp_path / "missing" / "connection.json", connection)
