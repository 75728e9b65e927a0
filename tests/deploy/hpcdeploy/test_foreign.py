"""What others made survives `down` and `reap` on every cloud, whatever it is called."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from cloud import RSA_KEY, StrictCloud
from cloud.parameters import PROFILES
from simulated import open_file, stub_set_up
from simulated.memory import MemoryProvider

from hpccomponent.errors import CloudError, LeftoverError
from hpcdeploy.providers.ec2.names import key_pair_name
from hpcdeploy.providers.ec2.observe import GroupSeen
from hpcdeploy.reconcile.cluster import Cluster, describe_elsewhere
from hpcdeploy.reconcile.converge import bring_up, take_down
from hpcdeploy.reconcile.reap import reap
from hpcdeploy.spec.names import Owner, draw_incarnation
from hpcdeploy.spec.polling import Polling, utc_now
from hpcdeploy.spec.provider import Credentials

POLLING = Polling(poll_s=0.01, settle_s=0.01, end_s=30.0, backoff_s=())


@pytest.fixture(params=PROFILES)
def cloud(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[StrictCloud]:
    with StrictCloud(request.param) as cloud:
        for name, text in cloud.environment().items():
            monkeypatch.setenv(name, text)
        stub_set_up(monkeypatch, tmp_path)
        yield cloud


@pytest.fixture
def cluster(cloud: StrictCloud, tmp_path: Path) -> Cluster:
    path = tmp_path / "cluster.yaml"
    price: dict[str, object] = {"hourly_cost": 0.1} if cloud.profile == "generic" else {}
    block = cloud.provider_block(small=price)
    spec_text = {"version": 1, "cluster": "bunny", "provider": block, "workers": {"count": 0}}
    path.write_text(json.dumps(spec_text))
    return open_file(path, RSA_KEY)


def add_foreign_pairs(cloud: StrictCloud) -> list[str]:
    """Make key pairs that are called as ours are, or nearly so."""
    names = [
        "hpcapp-bunny",
        "hpcapp-bunny-laptop",
        "hpcapp-laptop",
        key_pair_name("bunny", draw_incarnation(utc_now() - timedelta(days=2))),
        key_pair_name("other", draw_incarnation(utc_now() - timedelta(days=2))),
    ]
    for name in names:
        cloud.model.backend.import_key_pair(name, RSA_KEY.encode(), {})
    return sorted(names)


def ignore(line: str) -> None:
    del line


@pytest.mark.slow
def test_down_takes_our_key_pair_alone(cloud: StrictCloud, cluster: Cluster) -> None:
    foreign = add_foreign_pairs(cloud)
    take_down(cluster, ignore, polling=POLLING)
    assert cloud.key_pairs == foreign
    bring_up(cluster, ignore, polling=POLLING)
    assert len(cloud.key_pairs) == len(foreign) + 1
    assert all(instance.public_key.split() == RSA_KEY.split() for instance in cloud.living)
    take_down(cluster, ignore, polling=POLLING)
    assert cloud.left() == foreign


@pytest.mark.slow
def test_reap_takes_our_key_pair_alone(cloud: StrictCloud, cluster: Cluster) -> None:
    foreign = add_foreign_pairs(cloud)
    reap(cluster.provider, ignore, POLLING)
    bring_up(cluster, ignore, polling=POLLING)
    tomorrow = replace(POLLING, now=lambda: utc_now() + timedelta(days=1))
    reap(cluster.provider, ignore, tomorrow)
    assert cloud.left() == foreign


@pytest.mark.parametrize("cloud", ["aws", "euca-4.0"], indirect=True)
def test_the_group_stays_as_proof_until_the_key_pair_is_gone(
    cloud: StrictCloud, cluster: Cluster
) -> None:
    bring_up(cluster, ignore, polling=POLLING)
    cloud.no_rights = {"DeleteKeyPair"}
    with pytest.raises(LeftoverError, match="key pair hpcapp-bunny-"):
        take_down(cluster, ignore, polling=POLLING)
    assert [group.name for group in cloud.groups] == ["hpcapp-bunny"]
    cloud.no_rights = set()
    take_down(cluster, ignore, polling=POLLING)
    assert cloud.left() == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "description", ["my own", "hpcapp cluster bunny", "hpcapp cluster x life y"]
)
def test_a_foreign_group_with_our_name_is_never_taken_for_ours(
    cloud: StrictCloud, cluster: Cluster, description: str
) -> None:
    cloud.model.backend.create_security_group("hpcapp-bunny", description, {})
    with pytest.raises(CloudError, match="hpcapp-bunny exists and is not hpcapp's"):
        bring_up(cluster, ignore, polling=POLLING)
    take_down(cluster, ignore, polling=POLLING)
    reap(cluster.provider, ignore, replace(POLLING, now=lambda: utc_now() + timedelta(days=9)))
    assert cloud.left() == ["hpcapp-bunny"]
    assert [group.description for group in cloud.groups] == [description]


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"region": "eu-west-1"}, {"credentials": {"profile": "other"}}])
def test_down_after_a_change_of_place_says_where_something_was_made(
    cloud: StrictCloud, cluster: Cluster, change: dict[str, Any]
) -> None:
    """The other region, or account, lists nothing: that proves nothing of this one."""
    bring_up(cluster, ignore, polling=POLLING)
    provider = cluster.spec.provider.model_copy(
        update={k: Credentials(**v) if k == "credentials" else v for k, v in change.items()}
    )
    there = replace(cluster, spec=cluster.spec.model_copy(update={"provider": provider}))
    nothing: Any = replace(there, provider=MemoryProvider())
    for _ in range(2):
        said = r"nothing is left where .* leads, but cluster bunny was made in (aws|euc|ec2)"
        with pytest.raises(LeftoverError, match=said):
            take_down(nothing, ignore, polling=POLLING)
        assert len(cloud.living) == 1
    assert "cluster bunny was made in" in describe_elsewhere(there)
    with pytest.raises(CloudError):
        bring_up(replace(nothing, provider=Refusing()), ignore, polling=POLLING)
    take_down(cluster, ignore, polling=POLLING)
    assert cloud.left() == []
    assert describe_elsewhere(there) == ""


class Refusing(MemoryProvider):
    def create_group(self, cluster: str, incarnation: str, owner: Owner) -> GroupSeen:
        raise CloudError("refused")
