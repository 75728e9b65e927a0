"""Which wheels a machine needs, and whether a folder has them: pip's rules, without pip."""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from email.parser import HeaderParser
from pathlib import Path

from packaging.requirements import InvalidRequirement, Requirement
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import InvalidWheelFilename, canonicalize_name, parse_wheel_filename

from hpccomponent.errors import CloudError

_OLDEST_GLIBC = 5  # 2.5: what manylinux1 stands for
_LEGACY = {17: "manylinux2014", 12: "manylinux2010", 5: "manylinux1"}
_NEWEST = 99


@dataclass(frozen=True, slots=True, order=True)
class Kind:
    """What decides which wheels run on a machine.

    Parameters
    ----------
    architecture : str
        As ``uname -m`` names it.
    libc : str
        ``glibc`` or ``musl``.
    libc_version, python : tuple of int
        Major and minor.
    """

    architecture: str
    libc: str
    libc_version: tuple[int, int]
    python: tuple[int, int]

    def __str__(self) -> str:
        known = self.libc_version[1] < _NEWEST
        version = f" {self.libc_version[0]}.{self.libc_version[1]}" if known else ""
        python = f"Python {self.python[0]}.{self.python[1]}"
        return f"{python}, {self.architecture}, {self.libc}{version}"

    def tags(self) -> list[Tag]:
        """Return the tags of wheels that run there, the best first."""
        return list(_tags(self))

    def environment(self) -> dict[str, str]:
        """Return what the markers of requirements are compared with."""
        version = f"{self.python[0]}.{self.python[1]}"
        return {
            "extra": "",
            "implementation_name": "cpython",
            "os_name": "posix",
            "platform_machine": self.architecture,
            "platform_python_implementation": "CPython",
            "platform_system": "Linux",
            "python_full_version": f"{version}.99",
            "python_version": version,
            "sys_platform": "linux",
        }


@functools.lru_cache
def _tags(kind: Kind) -> tuple[Tag, ...]:
    platforms = list(_platforms(kind))
    return (
        *cpython_tags(kind.python, platforms=platforms),
        *compatible_tags(kind.python, platforms=platforms),
    )


def _platforms(kind: Kind) -> Iterator[str]:
    major, minor = kind.libc_version
    if kind.libc == "musl":
        yield from (f"musllinux_{major}_{n}_{kind.architecture}" for n in range(minor, -1, -1))
    else:
        for n in range(minor, _OLDEST_GLIBC - 1, -1):
            yield f"manylinux_{major}_{n}_{kind.architecture}"
            if n in _LEGACY:
                yield f"{_LEGACY[n]}_{kind.architecture}"
    yield f"linux_{kind.architecture}"


def fits(wheel: Path, kind: Kind) -> bool:
    """Tell whether a wheel runs on machines of a kind.

    Parameters
    ----------
    wheel : Path
        Only its name is read.
    """
    return bool(parse_wheel_filename(wheel.name)[3] & set(kind.tags()))


@dataclass(frozen=True, slots=True)
class Selection:
    """What a folder has of what is needed.

    Parameters
    ----------
    missing : tuple of str
        Requirements that no wheel there meets, with who asks for them.
    """

    wheels: tuple[Path, ...]
    missing: tuple[str, ...]


def select_wheels(
    places: Sequence[Path], requirements: Iterable[str], kind: Kind, *, is_deep: bool = True
) -> Selection:
    """Choose the newest fitting wheel for each requirement, and for what these require.

    Parameters
    ----------
    places : sequence of Path
        Folders of wheels, or wheels.
    is_deep : bool
        Whether what the wheels require is needed too.

    Returns
    -------
    Selection
        The wheels, and the requirements that none fulfils.
    """
    offered = _offered(places, kind)
    chosen: dict[str, Path] = {}
    missing: dict[str, str] = {}
    waiting = [(_parse(text), "") for text in requirements]
    while waiting:
        wanted, asker = waiting.pop(0)
        name = canonicalize_name(wanted.name)
        if wanted.marker is not None and not wanted.marker.evaluate(kind.environment()):
            continue
        if name in chosen or name in missing:
            continue
        wheel = _best(offered.get(name, []), wanted)
        if wheel is None:
            missing[name] = f"{wanted.name}{wanted.specifier}" + (
                f" (for {asker})" if asker else ""
            )
            continue
        chosen[name] = wheel
        if is_deep:
            waiting += [(_parse(text), wanted.name) for text in read_requirements(wheel)]
    return Selection(tuple(chosen.values()), tuple(missing.values()))


def read_requirements(wheel: Path) -> list[str]:
    """Return what a wheel requires, extras left out."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            [name] = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
            text = archive.read(name).decode()
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise CloudError(
            f"{wheel}: not a wheel ({error})", "take it away or fetch it anew"
        ) from error
    lines = HeaderParser().parsestr(text).get_all("Requires-Dist") or []
    return [line for line in lines if "extra ==" not in line]


def kinds_of(folder: Path) -> list[Kind]:
    """Return the kinds of machines that the compiled wheels of a folder are for."""
    kinds = set()
    for path in folder.glob("*.whl"):
        for tag in _tags_of(path):
            libc = "musl" if "musllinux" in tag.platform else "glibc"
            version = tag.interpreter.removeprefix("cp")
            if tag.platform == "any" or tag.abi in ("none", "abi3") or not version[1:].isdigit():
                continue
            architecture = tag.platform.split("_", 1 if tag.platform[9:13].isdigit() else 3)[-1]
            python = (int(version[0]), int(version[1:]))
            kinds.add(Kind(architecture, libc, (1 if libc == "musl" else 2, _NEWEST), python))
    return sorted(kinds)


def _tags_of(path: Path) -> frozenset[Tag]:
    try:
        return parse_wheel_filename(path.name)[3]
    except InvalidWheelFilename:
        return frozenset()


def _offered(places: Sequence[Path], kind: Kind) -> dict[str, list[Path]]:
    tags = set(kind.tags())
    offered: dict[str, list[Path]] = {}
    for place in places:
        for path in [place] if place.is_file() else sorted(place.glob("*.whl")):
            if _tags_of(path) & tags:
                offered.setdefault(parse_wheel_filename(path.name)[0], []).append(path)
    for wheels in offered.values():
        rank = {tag: -n for n, tag in enumerate(kind.tags())}
        wheels.sort(
            key=lambda path: (
                parse_wheel_filename(path.name)[1],
                max(rank.get(tag, -len(rank)) for tag in _tags_of(path)),
            )
        )
    return offered


def _best(wheels: list[Path], wanted: Requirement) -> Path | None:
    fitting = [w for w in wheels if wanted.specifier.contains(parse_wheel_filename(w.name)[1])]
    return fitting[-1] if fitting else None


def _parse(text: str) -> Requirement:
    try:
        return Requirement(text)
    except InvalidRequirement as error:
        raise CloudError(
            f"{text!r}: not a requirement ({error})", "write it as pip takes it"
        ) from error
