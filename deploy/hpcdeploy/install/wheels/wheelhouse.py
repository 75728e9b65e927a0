"""Which wheels a machine needs, and whether a folder has them: pip's rules, without pip."""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from email import message_from_bytes
from pathlib import Path

from packaging.requirements import InvalidRequirement, Requirement
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import InvalidWheelFilename, canonicalize_name, parse_wheel_filename

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError

_OLDEST_GLIBC = 5  # 2.5: what manylinux1 stands for
_LEGACY = {17: "manylinux2014", 12: "manylinux2010", 5: "manylinux1"}
_NEWEST = 99


@dataclass(frozen=True, slots=True, order=True)
class Kind:
    """What decides which wheels run on a machine.

    `architecture` is as ``uname -m`` names it, `libc` ``glibc`` or ``musl``; versions major, minor.
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

    def environment(self) -> dict[str, str]:
        """Return what the markers of requirements are compared with."""
        version = f"{self.python[0]}.{self.python[1]}"
        return {
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
def _ranks(kind: Kind) -> dict[Tag, int]:
    """Return the tags of wheels that run there, the best with the highest rank."""
    platforms = list(_platforms(kind))
    tags = [
        *cpython_tags(kind.python, platforms=platforms),
        *compatible_tags(kind.python, platforms=platforms),
    ]
    return {tag: rank for rank, tag in enumerate(reversed(tags))}


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
    """Tell by its name whether a wheel runs on machines of a kind."""
    return not _ranks(kind).keys().isdisjoint(_tags_of(wheel))


def select_wheels(
    places: Sequence[Path], requirements: Sequence[str], kind: Kind, *, is_deep: bool = True
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Choose the newest fitting wheel of each requirement, and if `is_deep` of what these require.

    `places` are folders of wheels, or wheels. Requirements that no wheel there meets are returned
    as well, with who asks for them.
    """
    folders = [[place] if place.is_file() else place.glob("*.whl") for place in places]
    offered = [path for folder in folders for path in folder if fits(path, kind)]
    chosen: dict[str, Path] = {}
    missing: dict[str, str] = {}
    read: set[tuple[str, ...]] = set()
    waiting: list[tuple[str, Requirement | None]] = [(text, None) for text in requirements]
    for text, asker in waiting:  # which grows meanwhile
        wanted = _parse(text)
        name, bound = canonicalize_name(wanted.name), f"{wanted.name}{wanted.specifier}"
        if name in missing or not _is_meant(wanted, asker, kind):
            continue
        wheel = _best([chosen[name]] if name in chosen else offered, wanted, kind)
        if wheel is not None:
            chosen[name] = wheel
        elif name in chosen:  # anew without it, and with this bound first
            rest = [path for path in offered if path != chosen[name]]
            return select_wheels(rest, [bound, *requirements], kind, is_deep=is_deep)
        else:
            missing[name] = bound + (f" (for {asker.name})" if asker is not None else "")
        if is_deep and wheel is not None and (name, *sorted(wanted.extras)) not in read:
            read.add((name, *sorted(wanted.extras)))
            waiting += [(line, wanted) for line in read_requirements(wheel)]
    return tuple(chosen.values()), tuple(missing.values())


def read_requirements(wheel: Path) -> list[str]:
    """Return what a wheel requires, with its extras."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            [name] = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
            return message_from_bytes(archive.read(name)).get_all("Requires-Dist", [])
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        advice = "take it away or fetch it anew"
        raise CloudError(f"{wheel}: not a wheel ({error})", advice) from error


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


def _is_meant(wanted: Requirement, asker: Requirement | None, kind: Kind) -> bool:
    """Tell whether a requirement holds on such a machine, with the extras that are asked for."""
    extras = ("", *(asker.extras if asker is not None else ()))
    environment = kind.environment()
    return wanted.marker is None or any(
        wanted.marker.evaluate({**environment, "extra": extra}) for extra in extras
    )


def _best(offered: Iterable[Path], wanted: Requirement, kind: Kind) -> Path | None:
    """Return the wheel of the newest version that will do, of those the one that fits best."""
    ranks = _ranks(kind)
    fitting = []
    for path in offered:
        name, version, _, tags = parse_wheel_filename(path.name)
        if name == canonicalize_name(wanted.name) and wanted.specifier.contains(version):
            fitting.append((version, max(ranks.get(tag, -1) for tag in tags), path))
    return max(fitting, default=(None, 0, None))[-1]


def _parse(text: str) -> Requirement:
    try:
        return Requirement(text)
    except InvalidRequirement as error:
        raise CloudError(
            f"{text!r}: not a requirement ({error})", "write it as pip takes it"
        ) from error
