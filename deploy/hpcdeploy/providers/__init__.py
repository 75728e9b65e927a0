"""One module for each kind of cloud, behind the interface in ``hpcdeploy.provider``."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import cast

from hpcdeploy.provider import Provider
from hpcdeploy.spec.cluster import ClusterSpec

__all__ = ["open_provider"]

_OPENERS = {
    "aws": "ec2.provider:open_ec2",
    "eucalyptus": "ec2.provider:open_ec2",
    "ec2": "ec2.provider:open_ec2",
    "ssh": "ssh_hosts:SshHosts",
    "local": "local:open_local",
}


def open_provider(spec: ClusterSpec, base: Path) -> Provider:
    """Return the provider of a cluster; its module, and boto3 with it, is imported only now.

    Raises CloudError where the cloud's keys are not to be found, or it cannot be reached.
    """
    module, _, function = _OPENERS[spec.provider.type].partition(":")
    return cast(Provider, getattr(import_module(f"{__name__}.{module}"), function)(spec, base))
