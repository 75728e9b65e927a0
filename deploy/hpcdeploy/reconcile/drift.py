"""Drift: what of a machine that lives is not as the file says, and cannot change while it lives.

What a cloud lists of a machine is compared with the file. What it does not list is written on the
machine when it is launched, as the tag `hpcapp:made-as`: numbers as they are, all else by a digest.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from hpcdeploy.provider import MachineSeen
from hpcdeploy.reconcile.plan import launch_choices
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import HEAD

DIGITS = 8
_BY_DIGEST = ("image", "iam_instance_profile", "auth.ssh_user", "tags")


def made_as(spec: ClusterSpec, node: str) -> str:
    """Return what a machine that is launched now is made by, beside what its cloud lists.

    It is ``KEY=VALUE`` with blanks between; empty where no machines are made.
    """
    profile = spec.profile(node)
    if profile is None:
        return ""
    values = {
        "disk_gb": profile.disk_gb,
        "public_ip": profile.public_ip,
        "image": _digest(profile.image.model_dump_json()),
        "iam_instance_profile": _digest(profile.iam_instance_profile or ""),
        "limits.idle": f"{spec.limits.idle:g}",
        "communicator.port": spec.communicator.port,
        "auth.ssh_port": spec.auth.ssh_port,
        "auth.ssh_user": _digest(spec.auth.ssh_user),
        "tags": _digest(str(sorted(spec.tags.items()))),
    }
    return " ".join(f"{key}={value}" for key, value in values.items())


def find_drift(spec: ClusterSpec, machine: MachineSeen) -> list[str]:
    """Say in which keys a machine differs from the file, as far as its cloud and its tag tell."""
    listed = [
        f"{key} is {value}, not {' or '.join(wanted)}"
        for key, value, wanted in _listed(spec, machine)
        if value and wanted and value not in wanted
    ]
    return listed + list(_written(spec, machine))


def describe_drift(spec: ClusterSpec, machines: Sequence[MachineSeen], file: Path) -> list[str]:
    """Say what of a cluster's machines, those that stay, differs from the file, and what to do.

    There is a line for all that differ in the same way, and one that says what to do.
    """
    alike: dict[str, list[MachineSeen]] = {}
    for machine in machines:
        if differing := find_drift(spec, machine):
            alike.setdefault(", ".join(differing), []).append(machine)
    lines = [
        f"drift: {', '.join(f'{m.name.node} ({m.id})' for m in alike_machines)}: {what}"
        for what, alike_machines in alike.items()
    ]
    if not lines:
        return []
    only_workers = all(
        machine.name.node != HEAD for alike_machines in alike.values() for machine in alike_machines
    )
    way = f"hpcapp scale {file} 0" if only_workers else f"hpcapp down {file}"
    return [
        *lines,
        f"drift: these machines stay as they were launched; {way} and then hpcapp up {file} makes "
        "new ones as the file says, between jobs",
    ]


def _listed(spec: ClusterSpec, machine: MachineSeen) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield key, value and what the file allows, of what clouds list."""
    profile = spec.profile(machine.name.node)
    if profile is None:
        return
    choices = launch_choices(profile, spec.provider.has_spot)
    yield "instance_type", machine.instance_type, profile.instance_types
    yield "market", machine.market, tuple(dict.fromkeys(choice.market for choice in choices))
    yield "zone", machine.zone, profile.zones
    yield "provider.subnet", machine.subnet, spec.provider.subnets
    yield "image", machine.image, (profile.image.id,) if profile.image.id else ()


def _written(spec: ClusterSpec, machine: MachineSeen) -> Iterator[str]:
    """Yield what differs from what was written on the machine when it was launched."""
    before, now = (
        dict(word.split("=", 1) for word in text.split() if "=" in word)
        for text in (machine.made_as, made_as(spec, machine.name.node))
    )
    profile = spec.profile(machine.name.node)
    is_image_listed = profile is not None and bool(profile.image.id and machine.image)
    for key in now:
        if before.get(key, now[key]) == now[key] or (key == "image" and is_image_listed):
            continue
        if key in _BY_DIGEST:
            yield f"{key} is not what the file says"
        else:
            yield f"{key} is {_said(before[key])}, not {_said(now[key])}"


def _said(value: str) -> str:
    return {"None": "left to the cloud", "True": "true", "False": "false"}.get(value, value)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]
