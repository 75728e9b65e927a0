from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hpccomponent.errors import ConfigError
from hpccomponent.inventory import (
    Inventory,
    InventoryWorker,
    dump_inventory,
    hold_cluster,
    read_inventory,
)
from hpccomponent.protocol.keys import make_key_pair, write_secret


@pytest.fixture
def inventory() -> Inventory:
    master = make_key_pair()
    workers = tuple(
        InventoryWorker(name, "10.0.0.5", make_key_pair().public) for name in ("head", "worker-1")
    )
    return Inventory("bunny", "tcp://10.0.0.4:7070", master.public, master.secret, workers)


@pytest.fixture
def path(tmp_path: Path, inventory: Inventory) -> Path:
    path = tmp_path / "inventory.json"
    write_secret(path, dump_inventory(inventory))
    return path


def test_it_comes_back(path: Path, inventory: Inventory) -> None:
    assert read_inventory(path) == inventory


def test_the_secret_is_not_shown_and_not_left_open(path: Path, inventory: Inventory) -> None:
    assert inventory.server_secret_key not in repr(inventory)
    path.chmod(0o644)
    with pytest.raises(ConfigError, match=r"inventory\.json.*chmod 600"):
        read_inventory(path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": 2}, "version: 2 is not 1"),
        ({"cluster": 5}, "cluster: 5 is not a name"),
        ({"bind": "10.0.0.4:7070"}, "bind: '10.0.0.4:7070' is not tcp"),
        ({"server_secret_key": "x"}, "server_secret_key: not a Z85"),
        ({"workers": {}}, "workers: not a list"),
        ({"workers": [5]}, r"workers\[0\]: not an object"),
        ({"workers": [{"name": "a", "address": "b"}]}, "public_key: is missing"),
        ({"workers": [{"name": "", "address": "b", "public_key": "x"}]}, "name: '' is not text"),
        ({"workers": [{"name": "a", "address": "b", "public_key": "x"}]}, "public_key: not a Z85"),
        ({"further": 1}, "further: is not known"),
    ],
)
def test_a_wrong_entry_is_named(path: Path, changes: dict[str, object], words: str) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(ConfigError, match=words):
        read_inventory(path)


HOLDER = """
import sys
from hpccomponent.inventory import hold_cluster
with hold_cluster(sys.argv[1], print):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_one_master_at_a_time_holds_a_cluster(path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-P", "-c", HOLDER, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with hold_cluster(path, on_wait=holder.kill):  # what has to wait ends the other
            assert holder.wait() == -signal.SIGKILL
