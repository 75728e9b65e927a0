"""What each kind of cloud knows: every call and parameter that not all of them know hangs on this.

A Eucalyptus fails a call that carries one unknown parameter, and answers some calls with an empty
reply instead of an error; so nothing is tried out, all is looked up here.
"""

from __future__ import annotations

from hpccomponent.dataclass import dataclass
from hpcdeploy.spec.provider import CloudSpec


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a cloud knows.

    Parameters
    ----------
    api_version : str, optional
        Of the EC2 interface as boto3 ships it; boto3 then refuses what is younger. Its latest by
        default.
    tags_at_launch : bool
        ``TagSpecifications`` of RunInstances. Where it is missing, machines are found by their
        group's name and known by their client token, and tagged afterwards.
    tags_on_parts : bool
        Whether they may be for volumes, network interfaces and spot requests too.
    tags_on_access : bool
        ``TagSpecifications`` of ImportKeyPair and CreateSecurityGroup.
    tags_on_groups : bool
        Whether CreateTags takes security groups.
    network_interfaces, spot, imds_v2 : bool
        ``NetworkInterfaces``, ``InstanceMarketOptions``, ``MetadataOptions`` of RunInstances.
    ends_when_shut_down : bool
        Whether ``InstanceInitiatedShutdownBehavior`` is heeded: a Eucalyptus accepts and ignores
        it, so that a machine that switches itself off still exists.
    instance_types : bool
        Whether DescribeInstanceTypes answers as Amazon does.
    """

    api_version: str | None
    tags_at_launch: bool = False
    tags_on_parts: bool = False
    tags_on_access: bool = False
    tags_on_groups: bool = False
    network_interfaces: bool = False
    spot: bool = False
    ends_when_shut_down: bool = False
    imds_v2: bool = False
    dry_run: bool = False
    latest_console: bool = False
    instance_types: bool = False
    ipv6: bool = False


# A version that a cloud does not know is no error there: it takes its own.
_TABLE = {
    "aws": Capabilities(None, *[True] * 12),
    "euca-4.0": Capabilities("2014-09-01", tags_on_groups=True),
    "euca-4.1": Capabilities("2014-10-01", tags_on_groups=True, network_interfaces=True),
    "euca-4.2": Capabilities("2015-04-15", tags_on_groups=True, network_interfaces=True),
    "euca-4.3": Capabilities("2015-10-01", tags_on_groups=True, network_interfaces=True),
    "euca-4.4": Capabilities("2016-09-15", tags_on_groups=True, network_interfaces=True),
    "euca-5.0": Capabilities(
        "2016-11-15", tags_at_launch=True, tags_on_groups=True, network_interfaces=True
    ),
    "euca-5.1": Capabilities(
        "2016-11-15", tags_at_launch=True, tags_on_groups=True, network_interfaces=True
    ),
    "generic": Capabilities("2016-11-15"),
}


def capabilities_of(cloud: CloudSpec) -> Capabilities:
    """Return what a cloud knows; ``auto`` is the least of its type."""
    return _TABLE[cloud.known_capabilities]
