"""Claims: what lies on a machine that is one of a cluster, whoever wrote it."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.providers.fixed import Claim
from hpcdeploy.providers.local import LocalProvider
from hpcdeploy.spec.layout import clusters_folder
from hpcdeploy.spec.names import NodeName, Owner

CLAIM = Claim("bunny", 2, "0a1b2c3d4e5f", datetime(2026, 11, 1, tzinfo=UTC), "anna@lab", "worker-1")
LIES: list[dict[str, Any]] = [
    {"cluster": "../../x"},
    {"cluster": 7},
    {"generation": -1},
    {"generation": 1.5},
    {"generation": "2"},
    {"generation": 10**400},
    {"incarnation": "$(reboot)"},
    {"incarnation": None},
    {"launched": "yesterday"},
    {"launched": "2026-11-01T00:00:00"},
    {"node": "worker-1; reboot"},
    {"node": "worker-01"},
    {"owner": ["anna"]},
    {"owner": "a" * 10_000},
]


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def write(text: str) -> Path:
    claim = clusters_folder() / "bunny/nodes/worker-1/machine.json"
    claim.parent.mkdir(parents=True)
    claim.write_text(text)
    return claim


def test_a_claim_comes_back() -> None:
    assert Claim.from_json(CLAIM.to_json()) == CLAIM
    write(CLAIM.to_json())
    [machine] = LocalProvider().observe("bunny").machines
    assert (machine.cluster, machine.name) == ("bunny", NodeName("worker-1", 2))
    assert (machine.launched, machine.owner) == (CLAIM.launched, Owner("anna@lab"))


def test_the_claim_of_an_earlier_release_is_read() -> None:
    told = json.loads(CLAIM.to_json())
    del told["node"], told["owner"]
    write(json.dumps(told))
    [machine] = LocalProvider().observe("bunny").machines
    assert machine.name == NodeName("worker-1", 2)


@pytest.mark.parametrize(
    "text",
    [
        *(json.dumps(json.loads(CLAIM.to_json()) | lie) for lie in LIES),
        "",
        "[]",
        "{}",
        "[" * 99_999,
    ],
)
def test_a_claim_that_is_none_is_one_line(text: str) -> None:
    write(text)
    with pytest.raises(CloudError, match=r"worker-1/machine\.json: cannot be read") as caught:
        LocalProvider().observe("bunny")
    assert "\n" not in str(caught.value)
