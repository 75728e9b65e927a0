"""Prices follow the list where AWS publishes it, and are unknown where nothing is known."""

from __future__ import annotations

import pytest

from hpcdeploy.spec.prices import read_prices


@pytest.mark.parametrize(
    ("instance_type", "listed"),
    [  # as AWS publishes them for Linux in us-east-1
        ("t3.nano", 0.0052),
        ("t3.medium", 0.0416),
        ("t3a.micro", 0.0094),
        ("m5.24xlarge", 4.608),
        ("m6i.large", 0.096),
        ("m6a.4xlarge", 0.6912),
        ("m7i.48xlarge", 9.6768),
        ("c5.18xlarge", 3.06),
        ("c6a.48xlarge", 7.344),
        ("c6i.xlarge", 0.17),
        ("c7i.2xlarge", 0.357),
        ("r5.12xlarge", 3.024),
        ("r6i.32xlarge", 8.064),
    ],
)
def test_every_size_of_a_family_follows_from_one_number(instance_type: str, listed: float) -> None:
    prices = read_prices()
    hourly = prices.hourly(instance_type, "us-east-1", disk_gb=0)
    assert hourly == pytest.approx(listed + prices.public_address)


def test_disk_and_region_are_counted() -> None:
    prices = read_prices()
    here = prices.hourly("m5.large", "us-east-1", disk_gb=730)
    assert here == pytest.approx(0.096 + 0.08 + 0.005)
    dearer = prices.hourly("m5.large", "sa-east-1", disk_gb=730)
    assert dearer == pytest.approx((0.096 + 0.08) * 1.6 + 0.005)


@pytest.mark.parametrize(
    ("instance_type", "region"),
    [
        ("x9.large", "us-east-1"),
        ("m5.metal", "us-east-1"),
        ("m5", "us-east-1"),
        ("m5.large", "moon-west-1"),
    ],
)
def test_of_what_is_not_in_the_table_no_price_is_known(instance_type: str, region: str) -> None:
    assert read_prices().hourly(instance_type, region) is None
