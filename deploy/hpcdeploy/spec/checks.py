"""What must fit together in a cluster file, and the files it names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hpccomponent.config.problems import Location
from hpccomponent.config.reader import ConfigModel, Misfit
from hpccomponent.errors import UsageError
from hpccomponent.files.paths import expand_home
from hpcdeploy.spec.prices import read_prices
from hpcdeploy.spec.provider import LEGAL_REGION, CloudSpec, Host

if TYPE_CHECKING:
    from hpcdeploy.spec.cluster import ClusterSpec


def find_misfits(spec: ClusterSpec, base: Path) -> Iterator[Misfit]:
    """Yield what does not fit together."""
    yield from _idle_keys(spec)
    yield from _numbers(spec)
    if spec.provider.fixed_hosts:
        yield from _hosts(spec, spec.provider.fixed_hosts)
    if spec.provider.cloud is not None:
        yield from _profiles(spec)
        yield from _cloud(spec.provider.cloud)
    yield from _files(spec, base)


def _idle_keys(spec: ClusterSpec) -> Iterator[Misfit]:
    """Yield the keys of the file that the provider does not honour."""
    provider = spec.provider
    for key in _given(spec):
        if ".".join(key) not in provider.honours:
            why = f" ({provider.nature})" if provider.nature else ""
            yield Misfit(key, f"has no effect with provider {provider.type}{why}: leave it out")


def _given(spec: ClusterSpec) -> Iterator[tuple[str, ...]]:
    """Yield each key of the file, and of its blocks beside the provider's."""
    for key in sorted(spec.model_fields_set):
        block = getattr(spec, key)
        if isinstance(block, ConfigModel) and key != "provider":
            yield from ((key, inner) for inner in sorted(block.model_fields_set))
        else:
            yield (key,)


def _numbers(spec: ClusterSpec) -> Iterator[Misfit]:
    """Yield numbers that contradict one another."""
    if spec.workers.min is not None and spec.workers.min > spec.worker_count:
        yield Misfit(("workers", "min"), f"exceeds workers.count, {spec.worker_count}")
    if spec.worker_count == 0 and not spec.head.component:
        yield Misfit(
            ("head", "component"), "nobody works: there are no workers and the head does not"
        )
    if spec.communicator.port == spec.auth.ssh_port:
        yield Misfit(("communicator", "port"), "is auth.ssh_port too, choose another")
    if spec.limits.idle > spec.limits.lease:
        yield Misfit(("limits", "idle"), "exceeds limits.lease, at whose end all machines go")


def _hosts(spec: ClusterSpec, hosts: Sequence[Host]) -> Iterator[Misfit]:
    """Yield hosts that are too few, or the same."""
    asked = 1 + spec.worker_count
    if len(hosts) < asked:
        yield Misfit(
            ("provider", "hosts"),
            f"a head and {spec.worker_count} workers take {asked} hosts, "
            f"here are {len(hosts)}: name more, or lower workers.count",
        )
    seen: Counter[tuple[str, int]] = Counter()
    for index, host in enumerate(hosts):
        port = host.port or spec.auth.ssh_port
        if seen[host.address, port]:
            yield Misfit(("provider", "hosts", index, "address"), "given twice")
        seen[host.address, port] += 1
        if port == spec.communicator.port and host.port:
            yield Misfit(("provider", "hosts", index, "port"), "is communicator.port too")


def _profiles(spec: ClusterSpec) -> Iterator[Misfit]:
    """Yield profiles that are not there, or are not named where there are several."""
    known = spec.profiles()
    for block, chosen in (("head", spec.head.profile), ("workers", spec.workers.profile)):
        if chosen is None and len(known) > 1:
            yield Misfit((block, "profile"), f"missing key, one of {', '.join(sorted(known))}")
        elif chosen is not None and chosen not in known:
            yield Misfit((block, "profile"), "no such profile in provider.profiles", known)


def _cloud(provider: CloudSpec) -> Iterator[Misfit]:
    """Yield what the kind of cloud does not have."""
    given = list(provider.credentials.model_dump(exclude_none=True))
    for name in given[1:]:
        yield Misfit(
            ("provider", "credentials", name),
            f"the keys are given twice, by {given[0]} already: leave one out",
        )
    signed_as_named = not provider.names_regions_freely and provider.signing_region is None
    if signed_as_named and not LEGAL_REGION.fullmatch(provider.region):
        yield Misfit(
            ("provider", "region"), "no legal name of a region: give signing_region beside it"
        )
    for name, profile in provider.profiles.items():
        if profile.image.ssm is not None and not provider.has_parameter_store:
            yield Misfit(
                ("provider", "profiles", name, "image", "ssm"),
                "this cloud has no parameter store: give the image's id, or owner and name",
            )
        if profile.public_ip is False and provider.address == "public":
            yield Misfit(
                ("provider", "profiles", name, "public_ip"),
                "machines without a public address cannot be reached by one: see provider.address",
            )
        if profile.public_ip is not None and not provider.sets_public_ip:
            yield Misfit(
                ("provider", "profiles", name, "public_ip"),
                "this cloud cannot be told whether machines get a public address: leave it out, "
                "or set provider.capabilities",
            )
        if len(profile.zones) > 1 and provider.subnets:
            yield Misfit(
                ("provider", "profiles", name, "zone"),
                "a subnet lies in one zone: name several subnets instead of zones",
            )
    if provider.has_spot:
        return
    for name, profile in provider.profiles.items():
        if profile.market == "spot":
            yield Misfit(
                ("provider", "profiles", name, "market"),
                "this cloud has no spot machines: on_demand or spot_with_fallback will do",
            )


def _files(spec: ClusterSpec, base: Path) -> Iterator[Misfit]:
    """Yield files and folders that are not there."""
    for location, text in _named_files(spec):
        yield from _look(location, text, base, Path.is_file, "file")
    if spec.env.wheelhouse is not None:
        yield from _look(("env", "wheelhouse"), spec.env.wheelhouse, base, Path.is_dir, "folder")


def _look(
    location: Location, text: str, base: Path, is_there: Callable[[Path], bool], kind: str
) -> Iterator[Misfit]:
    """Yield that a file or folder is not there."""
    try:
        if not is_there(base / expand_home(text)):
            yield Misfit(location, f"no such {kind}, looked for it from {base}")
    except UsageError as error:  # of the home folder in front
        yield Misfit(location, f"no such {kind}: {error.problem}")


def _named_files(spec: ClusterSpec) -> Iterator[tuple[Location, str]]:
    """Yield each file that the spec names, and where."""
    cloud = spec.provider.cloud
    if cloud is not None:
        if cloud.ca_bundle is not None:
            yield ("provider", "ca_bundle"), cloud.ca_bundle
        for name in ("euca_ini", "eucarc"):
            text = getattr(cloud.credentials, name)
            if text is not None:
                yield ("provider", "credentials", name), text
    if spec.auth.ssh_private_key != "auto":
        yield ("auth", "ssh_private_key"), spec.auth.ssh_private_key
    packages: list[tuple[Location, str]] = [(("env", "package"), spec.env.package)]
    packages += [(("env", "packages", i), text) for i, text in enumerate(spec.env.packages)]
    yield from ((where, text) for where, text in packages if text.endswith(".whl"))


def find_doubts(spec: ClusterSpec) -> Iterator[str]:
    """Yield what is allowed and is hardly meant, each with its key, on one line.

    That is a region or an instance type that no list has, and an SSH port open to everybody.
    """
    cloud = spec.provider.cloud
    if cloud is not None and cloud.has_list_prices:
        for name, profile in cloud.profiles.items():
            for instance_type in profile.instance_types:
                for key, doubt in read_prices().doubt(instance_type, cloud.region):
                    within = f"profiles.{name}." if key == "instance_type" else ""
                    yield f"provider.{within}{key}: {doubt}"
    for index, network in enumerate(spec.auth.allow_from):
        if network.endswith("/0"):
            yield (
                f"auth.allow_from[{index}]: {network} opens SSH to everybody: auto, your own "
                "address, will do"
            )
