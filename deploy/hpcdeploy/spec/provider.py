"""The block ``provider`` of a cluster file: what differs from cloud to cloud."""

from __future__ import annotations

import re
from typing import Annotated, ClassVar, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from hpccomponent.config.reader import ConfigModel
from hpcdeploy.spec.prices import read_prices

CAPABILITIES = Literal[
    "auto",
    "aws",
    "euca-4.0",
    "euca-4.1",
    "euca-4.2",
    "euca-4.3",
    "euca-4.4",
    "euca-5.0",
    "euca-5.1",
    "generic",
]
PROFILE_NAME = r"^[a-z][\w-]*$"
USER_NAME = r"^[^\s@:-][^\s@:]*$"
JUMP = (
    r"(?:(?P<user>[^\s@:,\[\]-][^\s@:,\[\]]*)@)?"
    r"(?:\[(?P<address>[0-9a-fA-F:.]+)\]|(?P<name>[^\s@:,\[\]-][^\s@:,\[\]]*))"
    r"(?::(?P<port>[0-9]{1,5}))?"
)
"""``[USER@]HOST[:PORT]``, an IPv6 address in brackets."""
EVERYWHERE = frozenset(
    {
        "version",
        "cluster",
        "provider",
        "head.component",
        "workers.count",
        "workers.min",
        "communicator.port",
        "env.python",
    }
)
"""The keys beside the provider's block that count with every provider."""
OVER_SSH = frozenset(
    {
        "auth.ssh_user",
        "auth.ssh_private_key",
        "auth.ssh_port",
        "auth.ssh_proxy_jump",
        "env.package",
        "env.setup",
        "env.packages",
        "env.wheelhouse",
    }
)
"""Those that count where machines are logged in to, and something is installed there."""
MADE = frozenset(
    {
        "head.profile",
        "workers.profile",
        "auth.allow_from",
        "limits.lease",
        "limits.idle",
        "limits.boot",
        "limits.max_hourly_cost",
        "limits.max_total_cost",
        "data.s3",
        "tags",
    }
)
"""Those that count where machines are made and paid for."""
LEGAL_REGION = re.compile(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?")
"""What boto3 takes for a region: a label of a host name."""


def _check_endpoint(url: str) -> str:
    """Return the URL of a service; raise ValueError where it is none."""
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or re.search(r"\s", url):
        raise ValueError("should be a URL such as https://cloud.example:8773/services/compute/")
    if parts.username or parts.query or parts.fragment:
        raise ValueError("should be a URL without user, password and query; see credentials")
    parts.port  # noqa: B018 - raises ValueError where it is none
    return url


Endpoint = Annotated[str, AfterValidator(_check_endpoint)]
Subnet = Annotated[str, Field(pattern=r"^(auto|subnet-\w+)$")]
SubnetId = Annotated[str, Field(pattern=r"^subnet-\w+$")]


def _as_tuple(one_or_more: str | tuple[str, ...]) -> tuple[str, ...]:
    return (one_or_more,) if isinstance(one_or_more, str) else one_or_more


def _at_least_one(what: str) -> AfterValidator:
    """Refuse no name at all, and empty ones."""

    def check(names: str | tuple[str, ...]) -> str | tuple[str, ...]:
        if not names or not all(_as_tuple(names)):
            raise ValueError(f"should name at least one {what}")
        return names

    return AfterValidator(check)


class Credentials(ConfigModel):
    """Where the keys of the cloud are; at most one of the three, the environment otherwise.

    Parameters
    ----------
    profile : str, optional
        Of the AWS configuration, ``~/.aws``.
    euca_ini : str, optional
        A file of euca2ools.
    eucarc : str, optional
        A shell file of exports, as a Eucalyptus hands out.
    """

    profile: str | None = None
    euca_ini: str | None = None
    eucarc: str | None = None


class Image(ConfigModel):
    """The image that machines boot: by its id, by a parameter, or by owner and name.

    Parameters
    ----------
    id : str, optional
        ``ami-...`` or ``emi-...``; another one in each region.
    ssm : str, optional
        A parameter of the cloud's parameter store that holds the id: those below
        ``/aws/service/`` are the publishers' own, in every region.
    owner : str, optional
        ``self``, ``amazon``, or the number of an account.
    name : str, optional
        Of the owner's image, with ``*`` for any text; the newest that fits is taken.
    """

    id: str | None = Field(default=None, pattern=r"^[ae]mi-\w+$")
    ssm: str | None = Field(default=None, pattern=r"^/[\w./-]+$")
    owner: str | None = Field(default=None, pattern=r"^(self|amazon|aws-marketplace|\d{12})$")
    name: str | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _named_once(self) -> Image:
        ways = [self.id, self.ssm, self.owner if self.owner is not None else self.name]
        if sum(way is not None for way in ways) != 1:
            raise ValueError("should have an id, or ssm, or owner and name")
        if (self.owner is None) != (self.name is None):
            raise ValueError("should have an owner and a name")
        return self


class Profile(ConfigModel):
    """A kind of machine.

    Parameters
    ----------
    instance_type : str or tuple of str
        In the order in which they are tried.
    disk_gb : int
        Of the root disk, 10^9 bytes; the image's own by default.
    public_ip : bool, optional
        Whether machines get a public address; by default as the subnet says.
    iam_instance_profile : str, optional
        Name or ARN of a role's profile that the machines have.
    market : str
        ``spot_with_fallback`` takes a machine on demand where no spot machine is to be had.
    zone : str or tuple of str, optional
        Availability zones, in the order in which they are tried; the cloud's choice by default.
    hourly_cost : float, optional
        Of one machine on demand, in dollars; by default from the table that ships.
    """

    image: Image
    instance_type: Annotated[str | tuple[str, ...], _at_least_one("instance type")]
    disk_gb: int | None = Field(default=None, ge=1, le=16384)
    public_ip: bool | None = None
    iam_instance_profile: str | None = Field(
        default=None, pattern=r"^([\w+=,.@-]{1,128}|arn:[\w-]+:iam::\d{12}:instance-profile/.+)$"
    )
    market: Literal["on_demand", "spot", "spot_with_fallback"] = "on_demand"
    zone: Annotated[str | tuple[str, ...], _at_least_one("zone")] | None = None
    hourly_cost: float | None = Field(default=None, ge=0)

    @property
    def zones(self) -> tuple[str, ...]:
        """The zones, best first; none where the cloud may choose."""
        return () if self.zone is None else _as_tuple(self.zone)

    @property
    def instance_types(self) -> tuple[str, ...]:
        """The instance types, best first."""
        return _as_tuple(self.instance_type)


class Host(ConfigModel):
    """A machine that is there.

    Parameters
    ----------
    address : str
        Name or address; a name of ``~/.ssh/config`` is followed.
    user : str, optional
        By default ``auth.ssh_user``.
    port : int, optional
        By default ``auth.ssh_port``.
    private_address : str, optional
        Where the other machines reach it; by default its address.
    """

    address: str = Field(pattern=r"^[^\s@-][^\s@]*$")
    user: str | None = Field(default=None, pattern=USER_NAME)
    port: int | None = Field(default=None, ge=1, le=65535)
    private_address: str | None = Field(default=None, pattern=r"^[^\s@-][^\s@]*$")


def _as_host(host: object) -> object:
    """Read ``[USER@]HOST[:PORT]`` as the mapping that it is short for."""
    if not isinstance(host, str):
        return host
    match = re.fullmatch(JUMP, host)
    if match is None:
        raise ValueError(
            "should be [USER@]HOST[:PORT], an IPv6 address in brackets, or a mapping with address"
        )
    values = {
        "address": match["address"] or match["name"],
        "user": match["user"],
        "port": int(match["port"]) if match["port"] else None,
    }
    return {key: value for key, value in values.items() if value is not None}


class _Provider(ConfigModel):
    """What is asked of every block before its provider is opened, answered for fixed machines."""

    makes_machines: ClassVar[bool] = False
    """Whether machines are made and paid for: in a network and with a lease of the cluster's own,
    and they let in whoever has the cluster's SSH key. Fixed machines let in their users' keys."""
    is_here: ClassVar[bool] = False
    """Whether a node is a folder of this machine, run by this very interpreter."""
    is_shared: ClassVar[bool] = True
    """Whether other people's clusters may be met there."""
    honours: ClassVar[frozenset[str]] = EVERYWHERE
    """The keys beside the block that count; any other in the file is a mistake."""
    nature: ClassVar[str] = ""
    """Why the other keys do not count."""

    @property
    def fixed_hosts(self) -> tuple[Host, ...]:
        """The hosts that the block names, the head first; none where it names none."""
        return ()

    @property
    def address_kind(self) -> str:
        """By which of their addresses machines are reached; see `MachineSeen.address`."""
        return "auto"

    @property
    def subnets(self) -> tuple[str, ...]:
        """The subnets that machines are made in, best first; none where the default will do."""
        return ()

    @property
    def has_spot(self) -> bool:
        """Whether there are spot machines."""
        return False


class _Fixed(_Provider):
    """What all machines have that are there anyway."""

    @property
    def cloud(self) -> None:
        """None: there are no keys and endpoints of one."""
        return None


class _Cloud(_Provider):
    """What every EC2-compatible cloud has.

    Parameters
    ----------
    region : str
        The cloud's own name for it.
    signing_region : str, optional
        What requests are signed for, where the region's name is no legal one.
    ca_bundle : str, optional
        A file of certificates, relative to the cluster file.
    subnet : str or tuple of str
        ``auto``, or ids of one VPC, in the order in which they are tried.
    address : str
        Where machines are reached: ``public``, ``private``, or ``auto``: by the public address
        where there is one.
    capabilities : str
        Which calls and parameters the cloud knows; ``auto`` by the type.
    """

    region: str = Field(default="us-east-1", min_length=1)
    signing_region: str | None = Field(default=None, pattern=f"^{LEGAL_REGION.pattern}$")
    endpoint_url: Endpoint | None = None
    s3_endpoint_url: Endpoint | None = None
    credentials: Credentials = Credentials()
    ca_bundle: str | None = None
    subnet: Annotated[Subnet | tuple[SubnetId, ...], _at_least_one("subnet")] = "auto"
    address: Literal["auto", "public", "private"] = "auto"
    capabilities: CAPABILITIES = "auto"
    profiles: dict[Annotated[str, Field(pattern=PROFILE_NAME)], Profile] = Field(min_length=1)

    makes_machines: ClassVar[bool] = True
    honours: ClassVar[frozenset[str]] = EVERYWHERE | OVER_SSH | MADE
    auto_capabilities: ClassVar[str]
    """What ``capabilities: auto`` stands for: the least that a cloud of the type knows."""
    has_parameter_store: ClassVar[bool] = False
    """Whether an image may be named by a parameter."""
    names_regions_freely: ClassVar[bool] = False
    """Whether a region may bear a name that no request can be signed for."""
    is_known_to_boto3: ClassVar[bool] = False
    """Whether boto3 finds its endpoints and the user's keys by itself."""
    is_free: ClassVar[bool] = False
    """Whether a machine that no price is given for costs nothing."""

    @property
    def cloud(self) -> Self:
        """The block itself: its region, keys and endpoints."""
        return self

    @property
    def address_kind(self) -> str:
        """By which of their addresses machines are reached."""
        return self.address

    @property
    def subnets(self) -> tuple[str, ...]:
        """The subnets, best first; none where the cloud's default will do."""
        return () if self.subnet == "auto" else _as_tuple(self.subnet)

    @property
    def known_capabilities(self) -> str:
        """The capabilities, with ``auto`` resolved."""
        return self.auto_capabilities if self.capabilities == "auto" else self.capabilities

    @property
    def has_spot(self) -> bool:
        """Whether the cloud has spot machines; elsewhere their calls do nothing, silently."""
        return self.known_capabilities == "aws"

    @property
    def sets_public_ip(self) -> bool:
        """Whether the cloud can be told which machines get a public address."""
        return self.known_capabilities not in ("euca-4.0", "generic")

    @property
    def has_list_prices(self) -> bool:
        """Whether Amazon's list prices are the cloud's."""
        return self.capabilities == "aws"

    def hourly(self, profile: Profile, instance_type: str) -> float | None:
        """Return what a machine costs an hour on demand, in dollars; None where that is unknown."""
        if profile.hourly_cost is not None:
            return profile.hourly_cost
        if self.has_list_prices:
            return read_prices().hourly(instance_type, self.region, profile.disk_gb)
        return 0.0 if self.is_free else None

    def dearest(self, instance_type: str) -> float | None:
        """Return what a machine costs an hour at most, whichever profile it was launched by."""
        named = (p for p in self.profiles.values() if instance_type in p.instance_types)
        prices = [self.hourly(profile, instance_type) for profile in named]
        if not prices and self.has_list_prices:
            return read_prices().hourly(instance_type, self.region)
        known = [price for price in prices if price is not None]
        return max(known) if known and len(known) == len(prices) else None

    def priced_by(self, profile: Profile) -> str:
        """Return where the prices of `hourly` come from; empty where none is known."""
        if profile.hourly_cost is not None:
            return "the file's hourly_cost"
        if self.has_list_prices:
            return f"Amazon's list of {read_prices().as_of}, on demand, with disk and address"
        nobody = "default: a Eucalyptus bills nobody unless hourly_cost says so"
        return nobody if self.is_free else ""

    @property
    def signed_region(self) -> str:
        """The region that requests are signed for."""
        return self.signing_region or "eucalyptus"


class AwsSpec(_Cloud):
    """Amazon EC2."""

    auto_capabilities: ClassVar[str] = "aws"
    has_parameter_store: ClassVar[bool] = True
    is_known_to_boto3: ClassVar[bool] = True

    type: Literal["aws"]

    @property
    def has_list_prices(self) -> bool:
        """True, whatever its capabilities."""
        return True

    @property
    def signed_region(self) -> str:
        """The region that requests are signed for; by default the region itself."""
        return self.signing_region or self.region


class EucalyptusSpec(_Cloud):
    """A Eucalyptus cloud; ``auto`` uses what all versions from 4.0 on know."""

    auto_capabilities: ClassVar[str] = "euca-4.0"
    names_regions_freely: ClassVar[bool] = True
    is_free: ClassVar[bool] = True

    type: Literal["eucalyptus"]
    region: str = Field(default="eucalyptus", min_length=1)


class Ec2Spec(_Cloud):
    """Any other cloud that speaks EC2."""

    auto_capabilities: ClassVar[str] = "generic"

    type: Literal["ec2"]
    endpoint_url: Endpoint


class SshSpec(_Fixed):
    """Machines that are there, reached by SSH; the first is the head."""

    honours: ClassVar[frozenset[str]] = EVERYWHERE | OVER_SSH
    nature: ClassVar[str] = "its hosts are neither made nor paid for"

    type: Literal["ssh"]
    hosts: tuple[Annotated[Host, BeforeValidator(_as_host)], ...] = Field(min_length=1)

    @property
    def fixed_hosts(self) -> tuple[Host, ...]:
        """The hosts, the head first."""
        return self.hosts


class LocalSpec(_Fixed):
    """No machine but this one: every node is a folder with processes of its own."""

    is_here: ClassVar[bool] = True
    is_shared: ClassVar[bool] = False
    nature: ClassVar[str] = "its nodes are folders that run this very installation"

    type: Literal["local"]


CloudSpec = AwsSpec | EucalyptusSpec | Ec2Spec
ProviderSpec = Annotated[
    AwsSpec | EucalyptusSpec | Ec2Spec | SshSpec | LocalSpec, Field(discriminator="type")
]
