"""Who may reach the SSH port."""

from __future__ import annotations

import pytest

from hpccomponent.config.reader import parse_config
from hpccomponent.errors import CloudError
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.ssh_networks import ssh_networks

FILE = """
version: 1
cluster: c
provider:
  type: ec2
  endpoint_url: {endpoint}
  profiles: {{small: {{image: {{id: ami-1}}, instance_type: t}}}}
auth: {{allow_from: {allow_from}}}
"""


def networks(allow_from: str, endpoint: str = "http://8.8.8.8/", public: str = "") -> set[str]:
    spec = parse_config(
        FILE.format(allow_from=allow_from, endpoint=endpoint), "c.yaml", ClusterSpec
    )
    return set(ssh_networks(spec, lambda: public))


def test_networks_are_taken_as_they_are_written() -> None:
    assert networks("[10.0.0.0/8, 192.0.2.1/32]") == {"10.0.0.0/8", "192.0.2.1/32"}


def test_auto_is_the_address_towards_a_private_endpoint() -> None:
    assert networks("[auto]", "http://127.0.0.1:8773/services/compute/") == {"127.0.0.1/32"}


def test_auto_is_the_public_address_towards_a_public_endpoint() -> None:
    assert networks("[auto, 192.0.2.0/24]", public="198.51.100.7") == {
        "198.51.100.7/32",
        "192.0.2.0/24",
    }


def test_an_address_that_cannot_be_found_out_is_asked_for() -> None:
    with pytest.raises(CloudError, match=r"public address is not .*; write the network .* into"):
        networks("[auto]", public="<html>")


def test_where_machines_are_there_no_port_is_opened() -> None:
    spec = parse_config("version: 1\ncluster: c\nprovider: {type: local}", "c", ClusterSpec)
    assert ssh_networks(spec) == frozenset()
