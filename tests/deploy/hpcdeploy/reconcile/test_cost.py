"""What a cluster costs is estimated from above, and held to the limits of its file."""

from __future__ import annotations

import pytest

from hpccomponent.config.reader import parse_config
from hpccomponent.errors import UsageError
from hpcdeploy.reconcile.cost import check_limits, describe_cost, estimate_cost
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.prices import read_prices

AWS = """
  type: aws
  profiles:
    small: {image: {id: ami-1}, instance_type: m6i.large, disk_gb: 20}
    fast: {image: {id: ami-1}, instance_type: [c6a.xlarge, c6i.xlarge], market: spot}
"""


def spec_of(provider: str, limits: str = "{}", count: int = 3) -> ClusterSpec:
    text = (
        f"version: 1\ncluster: c\nprovider:{provider.rstrip()}\nhead: {{profile: small}}\n"
        f"workers: {{profile: fast, count: {count}}}\nlimits: {limits}"
    )
    return parse_config(text, "c.yaml", ClusterSpec)


def test_the_dearest_type_on_demand_is_counted() -> None:
    cost = estimate_cost(spec_of(AWS, "{lease: 3h}"))
    prices = read_prices()
    head = prices.hourly("m6i.large", "us-east-1", 20)
    worker = prices.hourly("c6i.xlarge", "us-east-1")
    assert head is not None
    assert worker is not None
    assert [line.instance_type for line in cost.lines] == ["m6i.large", "c6i.xlarge"]
    assert cost.hourly == pytest.approx(head + 3 * worker)
    assert cost.total_at_most == pytest.approx(3 * cost.hourly)
    assert cost.priced_as_of == prices.as_of


def test_another_number_of_workers_can_be_asked_for() -> None:
    spec = spec_of(AWS)
    assert estimate_cost(spec, workers=0).hourly == estimate_cost(spec).lines[0].hourly
    assert estimate_cost(spec, workers=5).lines[1].count == 5


@pytest.mark.parametrize(
    "limits", ["{max_hourly_cost: 0.6}", "{max_total_cost: 1.2}", "{lease: 1m, idle: 1m}", "{}"]
)
def test_a_cluster_within_the_limits_passes(limits: str) -> None:
    spec = spec_of(AWS.replace("m6i", "t3"), limits, count=2)
    cost = estimate_cost(spec)
    assert 0.3 < cost.hourly < 0.6
    check_limits(spec, cost)


@pytest.mark.parametrize(
    ("limits", "complaint"),
    [
        ("{max_hourly_cost: 0.5}", r"costs an estimated \$0\.63.. an hour, .*max_hourly_cost"),
        ("{lease: 10h, max_total_cost: 5}", r"\$6\.3. within the lease, .*max_total_cost"),
    ],
)
def test_a_cluster_beyond_a_limit_is_refused(limits: str, complaint: str) -> None:
    spec = spec_of(AWS, limits)
    with pytest.raises(UsageError, match=complaint) as caught:
        check_limits(spec, estimate_cost(spec))
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("limits", ["{max_hourly_cost: 9}", "{max_total_cost: 9}"])
def test_an_unknown_price_is_refused_only_where_there_is_a_limit(limits: str) -> None:
    strange = AWS.replace("[c6a.xlarge, c6i.xlarge]", "[c6i.xlarge, x9.large]")
    spec = spec_of(strange)
    cost = estimate_cost(spec)
    assert [line.instance_type for line in cost.unknown] == ["x9.large"]
    told = describe_cost(cost)
    price = "give provider.profiles.fast.hourly_cost"
    assert f"cost: workers: 3 x x9.large, no price is known: {price}" in told
    assert any("not known in all; what is known together $0.1032" in line for line in told)
    check_limits(spec, cost)
    with pytest.raises(UsageError, match=r"x9\.large .*give provider\.profiles\.fast\.hourly_cost"):
        check_limits(spec_of(strange, limits), cost)


@pytest.mark.parametrize(
    ("kind", "hourly"),
    [
        ("type: eucalyptus", 0.0),  # bills nobody by itself
        ("type: ec2\n  endpoint_url: http://cloud.example/", None),
        ("type: ec2\n  endpoint_url: http://cloud.example/\n  capabilities: aws", 0.17),
    ],
)
def test_amazons_prices_are_amazons_only(kind: str, hourly: float | None) -> None:
    worker = estimate_cost(spec_of(AWS.replace("type: aws", kind))).lines[1]
    assert worker.hourly == (None if hourly is None else pytest.approx(hourly, abs=0.01))


def test_a_given_price_takes_the_place_of_the_table() -> None:
    kind = "type: ec2\n  endpoint_url: http://cloud.example/"
    provider = AWS.replace("type: aws", kind)
    provider = provider.replace("disk_gb: 20", "hourly_cost: 0.5").replace(
        "market: spot", "hourly_cost: 2"
    )
    assert estimate_cost(spec_of(provider)).hourly == 6.5


@pytest.mark.parametrize("provider", ["\n  type: local", "\n  type: ssh\n  hosts: [{address: a}]"])
def test_machines_that_are_there_cost_nothing(provider: str) -> None:
    spec = spec_of(provider, "{max_hourly_cost: 0}")
    cost = estimate_cost(spec)
    assert cost.hourly == 0
    check_limits(spec, cost)
    assert describe_cost(cost) == ["cost: none that is known of: the machines are there anyway"]


def test_what_has_no_price_is_never_written_as_nothing() -> None:
    strange = AWS.replace("m6i.large", "x9.large").replace("c6a.xlarge, c6i.xlarge", "x9.huge")
    told = describe_cost(estimate_cost(spec_of(strange)))
    assert told[-1] == "cost: not known"
    assert "$0" not in " ".join(told)


def test_a_machine_that_no_profile_names_has_the_list_price_where_there_is_a_list() -> None:
    elsewhere = AWS.replace("type: aws", "type: ec2\n  endpoint_url: http://cloud.example/")
    aws, generic = (spec_of(provider).provider.cloud for provider in (AWS, elsewhere))
    assert aws is not None
    assert generic is not None
    prices = read_prices()
    assert aws.dearest("m5.large") == prices.hourly("m5.large", "us-east-1")
    assert aws.dearest("m6i.large") == prices.hourly("m6i.large", "us-east-1", 20)
    assert aws.dearest("x9.large") is None
    assert generic.dearest("m5.large") is None
    assert generic.dearest("m6i.large") is None
