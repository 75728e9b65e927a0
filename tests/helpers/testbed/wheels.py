"""A folder of wheels without an index: what is installed here, packed again."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.tags import parse_tag
from packaging.utils import canonicalize_name


def closure(names: Iterable[str]) -> dict[str, Distribution]:
    """Return distributions and all that they require, by name."""
    found: dict[str, Distribution] = {}
    waiting = list(names)
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name in found:
            continue
        found[name] = distribution(name)
        for line in found[name].requires or ():
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                waiting.append(requirement.name)
    return found


def pack(installed: Distribution, folder: Path) -> Path:
    """Write the wheel of an installed distribution, without its commands."""
    lines = (installed.read_text("WHEEL") or "").splitlines()
    tags = {tag for line in lines if line.startswith("Tag: ") for tag in parse_tag(line[5:])}
    parts = (
        ".".join(sorted({getattr(tag, part) for tag in tags}))
        for part in ("interpreter", "abi", "platform")
    )
    name = canonicalize_name(installed.metadata["Name"]).replace("-", "_")
    target = folder / f"{name}-{installed.version}-{'-'.join(parts)}.whl"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as wheel:
        for file in installed.files or ():
            is_inside = ".." not in file.parts and "__pycache__" not in file.parts
            if is_inside and file.name not in ("INSTALLER", "REQUESTED", "direct_url.json"):
                wheel.write(str(file.locate()), str(file))
    return target


def pack_nothing(installed: Distribution, folder: Path) -> Path:
    """Write a wheel by the name of an installed distribution, with nothing in it."""
    name = canonicalize_name(installed.metadata["Name"]).replace("-", "_")
    meta = f"{name}-{installed.version}.dist-info"
    target = folder / f"{name}-{installed.version}-py3-none-any.whl"
    version = f"Name: {name}\nVersion: {installed.version}\n"
    with zipfile.ZipFile(target, "w") as wheel:
        wheel.writestr(f"{meta}/METADATA", f"Metadata-Version: 2.1\n{version}")
        wheel.writestr(f"{meta}/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        wheel.writestr(f"{meta}/RECORD", "")
    return target


def pack_requirements_of(name: str, folder: Path, only: Iterable[str] | None = None) -> None:
    """Fill a folder with the wheels of all that a distribution requires, itself not included.

    With `only`, all but these and what they require are empty: enough for machines that do no
    work, and quick.
    """
    real = closure([name] if only is None else only)
    for required, installed in closure([name]).items():
        if required in real and required != canonicalize_name(name):
            pack(installed, folder)
        elif required != canonicalize_name(name):
            pack_nothing(installed, folder)
