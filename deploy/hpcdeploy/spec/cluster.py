"""The cluster file: every key and its default."""

from __future__ import annotations

import os
import re
from ipaddress import IPv4Network
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from hpccomponent.config.reader import ConfigModel, read_config
from hpccomponent.errors import ConfigError
from hpccomponent.units import parse_duration
from hpcdeploy.spec.checks import find_misfits
from hpcdeploy.spec.names import HEAD, MOST_WORKERS, NAME_PATTERN
from hpcdeploy.spec.provider import (
    JUMP,
    USER_NAME,
    Profile,
    ProviderSpec,
)


def parse_network(text: str) -> str:
    """Return a network as clouds write it, in CIDR form; ``auto`` stays.

    Raises ValueError where it is no IPv4 network.

    Examples
    --------
    >>> parse_network("192.0.2.7")
    '192.0.2.7/32'
    """
    if text == "auto":
        return text
    try:
        return str(IPv4Network(text))
    except ValueError as error:
        if "host bits" in str(error):
            raise ValueError(f"should be the network {IPv4Network(text, strict=False)}") from None
        raise ValueError("should be auto or an IPv4 network such as 192.0.2.0/24") from None


def check_python(text: str) -> str:
    """Return a requirement of Python; raise ValueError unless it is ``>=3.N``, N of 11 or more."""
    match = re.fullmatch(r">=3\.(\d{1,2})", text)
    if match is None or int(match[1]) < 11:
        raise ValueError('should be ">=3.11" or a later one, hpcapp needs 3.11')
    return text


def check_tag(key: str) -> str:
    """Return the key of a user's own tag; raise ValueError where it is ours or the cloud's.

    Those begin with a reserved prefix. Nor may it be empty or longer than 127 characters.
    """
    if key.lower().startswith(("hpcapp:", "aws:", "euca:")) or not 0 < len(key) <= 127:
        raise ValueError("should be 1 to 127 characters and not begin with hpcapp:, aws: or euca:")
    return key


Duration = Annotated[float, BeforeValidator(parse_duration)]


def check_jump(text: str) -> str:
    """Return a machine on the way as it is; raise ValueError unless ``[USER@]HOST[:PORT]``."""
    match = re.fullmatch(JUMP, text)
    if match is None or not 0 < int(match["port"] or 22) < 65536:
        raise ValueError("should be [USER@]HOST[:PORT], an IPv6 address in brackets")
    return text


Network = Annotated[str, AfterValidator(parse_network)]
Jump = Annotated[str, AfterValidator(check_jump)]
Python = Annotated[str, AfterValidator(check_python)]
Tag = Annotated[str, AfterValidator(check_tag)]
TagValue = Annotated[str, Field(max_length=255)]


class HeadSpec(ConfigModel):
    """The machine of the HPC App.

    Parameters
    ----------
    profile : str, optional
        Of the provider's profiles; the only one by default.
    component : bool
        Whether it works too.
    """

    profile: str | None = None
    component: bool = True


class Workers(ConfigModel):
    """The machines that work.

    Parameters
    ----------
    profile : str, optional
        Of the provider's profiles; the only one by default.
    count : int, optional
        By default all hosts that are left, for `ssh`; 1 for others.
    min : int, optional
        With fewer, `up` fails; by default `count`.
    """

    profile: str | None = None
    count: int | None = Field(default=None, ge=0, le=MOST_WORKERS)
    min: int | None = Field(default=None, ge=0)


class Communicator(ConfigModel):
    """Where workers find the HPC App.

    Parameters
    ----------
    port : int
        On the head's private address.
    """

    port: int = Field(default=7070, ge=1024, le=65535)


class Auth(ConfigModel):
    """How machines are reached.

    Parameters
    ----------
    ssh_private_key : str
        A file, or ``auto``: a key made for the cluster (for `ssh`: the user's own keys and agent).
    allow_from : tuple of str
        IPv4 networks (CIDR) that reach the SSH port; ``auto`` is this machine's public address.
    ssh_proxy_jump : str or tuple of str
        Machines on the way, ``[USER@]HOST[:PORT]``, the nearest first.
    """

    ssh_user: str = Field(default="admin", pattern=USER_NAME)
    ssh_private_key: str = "auto"
    ssh_port: int = Field(default=22, ge=1, le=65535)
    allow_from: tuple[Network, ...] = Field(default=("auto",), min_length=1)
    ssh_proxy_jump: Jump | tuple[Jump, ...] = ()

    @property
    def proxy_jumps(self) -> tuple[str, ...]:
        """The machines on the way, the nearest first."""
        jumps = self.ssh_proxy_jump
        return (jumps,) if isinstance(jumps, str) else jumps


class Limits(ConfigModel):
    """What a cluster may cost at most.

    Parameters
    ----------
    lease : float
        The machines end by themselves so long after the last `up`, in seconds.
    idle : float
        And so long after the last job or login, in seconds.
    boot : float
        A machine that lets nobody in for so long is given up, in seconds.
    max_hourly_cost, max_total_cost : float, optional
        In dollars: `up` refuses what costs more an hour, or more within the lease.
    """

    lease: Duration = 7200.0
    idle: Duration = 900.0
    boot: Duration = 300.0
    max_hourly_cost: float | None = Field(default=None, ge=0)
    max_total_cost: float | None = Field(default=None, ge=0)


class Environment(ConfigModel):
    """What is installed on the machines.

    Parameters
    ----------
    package : str
        ``auto``: the wheel of this very release; or a file or requirement.
    python : str
        Which interpreters will do.
    setup : tuple of str
        Commands that run first, as the login user.
    packages : tuple of str
        Further requirements or wheels: applications of the user's own.
    wheelhouse : str, optional
        A folder of wheels that is uploaded, so that machines need no internet; without one they
        install from the index.
    """

    package: str = "auto"
    python: Python = ">=3.11"
    setup: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    wheelhouse: str | None = None


class Data(ConfigModel):
    """Where large files go instead of over SSH.

    Parameters
    ----------
    s3 : str, optional
        ``s3://bucket/prefix``.
    """

    s3: str | None = Field(default=None, pattern=r"^s3://[\w.-]+(/.*)?$")


class ClusterSpec(ConfigModel):
    """A cluster file; see ``docs/how-to/describe-a-cluster.md``.

    What it leaves to defaults that depend on one another is asked for by the methods.
    """

    version: Literal[1]
    cluster: str = Field(pattern=NAME_PATTERN)
    provider: ProviderSpec
    head: HeadSpec = HeadSpec()
    workers: Workers = Workers()
    communicator: Communicator = Communicator()
    auth: Auth = Auth()
    limits: Limits = Limits()
    env: Environment = Environment()
    data: Data = Data()
    tags: dict[Tag, TagValue] = Field(default_factory=dict, max_length=40)

    def profiles(self) -> dict[str, Profile]:
        """Return the provider's profiles; none where machines are there anyway."""
        cloud = self.provider.cloud
        return {} if cloud is None else cloud.profiles

    def profile_name(self, node: str) -> str:
        """Return the profile of ``head`` or ``worker-1``, ...; empty where there are none."""
        chosen = self.head.profile if node == HEAD else self.workers.profile
        profiles = self.profiles()
        return (chosen or next(iter(profiles))) if profiles else ""

    def profile(self, node: str) -> Profile | None:
        """Return the profile of a node; None where the provider has none.

        Parameters
        ----------
        node : str
            ``head`` or ``worker-1``, ...
        """
        return self.profiles().get(self.profile_name(node))

    @property
    def worker_count(self) -> int:
        """How many workers there should be."""
        if self.workers.count is not None:
            return self.workers.count
        hosts = self.provider.fixed_hosts
        return len(hosts) - 1 if hosts else 1

    @property
    def worker_min(self) -> int:
        """With how many workers the cluster is still one."""
        return self.worker_count if self.workers.min is None else self.workers.min

    def scaled(self, workers: int) -> ClusterSpec:
        """Return the file with another number of workers, all of which must come."""
        chosen = self.workers.model_copy(update={"count": workers, "min": None})
        return self.model_copy(update={"workers": chosen})

    def nodes(self) -> tuple[str, ...]:
        """Return the names of all its machines: ``head``, ``worker-1``, ..."""
        return (HEAD, *(f"worker-{n}" for n in range(1, self.worker_count + 1)))


def read_spec(path: Path) -> ClusterSpec:
    """Read a cluster file, check that its values fit together and its files are there.

    Raises ConfigError with a line for each mistake.
    """
    base = path.absolute().parent
    if not path.exists():
        raise ConfigError(f"{path}: no such cluster file", f"write one: hpcapp init {path}")
    return read_config(path, ClusterSpec, lambda spec: find_misfits(spec, base), os.environ)
