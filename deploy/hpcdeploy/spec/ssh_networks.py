"""Which networks may reach the SSH port: ``auth.allow_from``, with ``auto`` resolved."""

from __future__ import annotations

import ipaddress
import socket
import urllib.request
from collections.abc import Callable
from urllib.parse import urlsplit

from hpccomponent.errors import CloudError
from hpcdeploy.spec.cluster import ClusterSpec

PUBLIC_ADDRESS_URL = "https://checkip.amazonaws.com"


def _ask_public_address() -> str:
    with urllib.request.urlopen(PUBLIC_ADDRESS_URL, timeout=10) as answer:
        return str(answer.read(64).decode("ascii").strip())


def ssh_networks(
    spec: ClusterSpec, ask_public_address: Callable[[], str] = _ask_public_address
) -> frozenset[str]:
    """Return the networks (CIDR) that may reach a cluster's SSH port; none where there is no cloud.

    ``auto`` is this machine's address as the cloud sees it: of the interface towards an endpoint in
    a private network, and else the public IPv4 one, which a service on the internet tells. Raises
    CloudError where it is not to be found out.
    """
    cloud = spec.provider.cloud
    if cloud is None:
        return frozenset()
    networks = set()
    for entry in spec.auth.allow_from:
        if entry != "auto":
            networks.add(entry)
            continue
        try:
            address = _address_towards(cloud.endpoint_url) or ask_public_address()
            networks.add(str(ipaddress.IPv4Network(address)))
        except (OSError, ValueError) as error:
            raise CloudError(
                f"this machine's public address is not to be found out ({error})",
                "write the network that you come from into auth.allow_from",
            ) from None
    return frozenset(networks)


def _address_towards(endpoint_url: str | None) -> str:
    """Return this machine's address on the way to an endpoint in a private network, or nothing."""
    if endpoint_url is None:
        return ""
    parts = urlsplit(endpoint_url)
    *_, target = socket.getaddrinfo(
        parts.hostname, parts.port or 443, socket.AF_INET, socket.SOCK_DGRAM
    )[0]
    if ipaddress.ip_address(target[0]).is_global:
        return ""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(target)  # sends nothing, only chooses the way
        return str(probe.getsockname()[0])
