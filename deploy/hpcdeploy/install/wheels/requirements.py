"""What is installed on a machine, and how it gets there."""

from __future__ import annotations

from importlib.metadata import distribution, version
from importlib.resources import files
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from hpccomponent.dataclass import dataclass
from hpccomponent.files.paths import expand_home
from hpcdeploy.install.wheels.release import DISTRIBUTION, pack_release
from hpcdeploy.install.wheels.wheelhouse import (
    Kind,
    fits,
    kinds_of,
    read_requirements,
    select_wheels,
)
from hpcdeploy.provider import Problem
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.layout import state_folder

WORKER_NEEDS = ("msgspec", "numpy", "pydantic", "pyyaml", "pyzmq")
"""What `hpccomponent` and `hpcloader` import; a test compares it with their source."""


@dataclass(frozen=True, slots=True)
class MachineNeeds:
    """What one machine needs.

    `files` are wheels that are uploaded; with `is_offline`, all of it is among them. `requirements`
    are installed with what they require, by a wheel's name where it is among the files. The
    `release`, the package itself, is installed without: a worker does not need all of that.
    """

    files: tuple[Path, ...]
    requirements: tuple[str, ...]
    release: str
    is_offline: bool


def choose_release(spec: ClusterSpec, base: Path, kinds: list[Kind]) -> Path | str:
    """Return the package that all machines get: a wheel's file, or a requirement.

    The native build is taken only where it fits the `kinds` of all machines, because a job's
    machines must compute the same bits.
    """
    if spec.env.package != "auto":
        path = base / expand_home(spec.env.package)
        return path if path.is_file() else spec.env.package
    folder = state_folder(spec.cluster) / "release"
    native = pack_release(folder, is_native=True)
    if native is not None and all(fits(native, kind) for kind in kinds):
        return native
    portable = pack_release(folder, is_native=False)
    assert portable is not None  # noqa: S101 - only a native one may be none
    return portable


def needs_of(
    spec: ClusterSpec, base: Path, package: Path | str, kind: Kind, *, is_head: bool
) -> tuple[MachineNeeds, tuple[str, ...]]:
    """Return what a machine needs, and the requirements that no wheel of the wheelhouse fulfils.

    Without a wheelhouse none is missing. A worker gets only what a component and a loader import.
    """
    local = [path for text in spec.env.packages if (path := base / text).is_file()]
    named = [text for text in spec.env.packages if not (base / text).is_file()]
    wanted = [*(text for text in _bounds() if is_head or _name(text) in WORKER_NEEDS), *named]
    page = _bounds("dashboard") if is_head else []
    release = [package] if isinstance(package, Path) else []
    if spec.env.wheelhouse is None:
        requirements = (*map(_pinned, [*wanted, *page]), *(path.name for path in local))
        files = (*_bundled_pip(), *release, *local)
        name = release[0].name if release else str(package)
        return MachineNeeds(files, requirements, name, is_offline=False), ()
    places = [base / expand_home(spec.env.wheelhouse), *local]
    wanted += [text for path in local for text in read_requirements(path)]
    chosen, missing = select_wheels(places, [*wanted, *page], kind)
    if missing and page:  # a head does its work without: its jobs show no page then
        chosen, missing = select_wheels(places, wanted, kind)
    if not release:
        found, lost = select_wheels(places, [str(package)], kind, is_deep=False)
        release, missing = [*found], (*missing, *lost)
    wheels = tuple(dict.fromkeys((*chosen, *local)))
    files = (*_bundled_pip(), *wheels, *release)
    names = tuple(path.name for path in wheels)
    return MachineNeeds(
        files, names, "".join(path.name for path in release), is_offline=True
    ), missing


def check_wheels(spec: ClusterSpec, base: Path) -> list[Problem]:
    """Return what is missing in the wheelhouse, one problem for each wheel.

    Before the machines are there, the wheelhouse itself says which machines it is for: each kind
    that it has compiled wheels for should be complete. Where none is, `up` would fail.
    """
    if spec.env.wheelhouse is None or spec.provider.is_here:
        return []
    folder = base / expand_home(spec.env.wheelhouse)
    kinds = kinds_of(folder)
    if not kinds:
        return [
            Problem(
                f"{folder}: no compiled wheel for Linux in it",
                "fill it by: pip download --only-binary=:all: -d FOLDER hpcapp, on such a machine",
            )
        ]
    lacking = {kind: missing_wheels(spec, base, kind, is_head=True) for kind in kinds}
    return [
        Problem(
            f"{folder}: no wheel of {missing} for {kind}",
            "add it: see docs/how-to/describe-a-cluster.md, env",
            is_fatal=all(lacking.values()),
        )
        for kind, names in lacking.items()
        for missing in names
    ]


def missing_wheels(spec: ClusterSpec, base: Path, kind: Kind, *, is_head: bool) -> tuple[str, ...]:
    """Return what the wheelhouse lacks for a machine of a kind; nothing where there is none."""
    package = spec.env.package if spec.env.package != "auto" else Path(f"{DISTRIBUTION}.whl")
    return needs_of(spec, base, package, kind, is_head=is_head)[1]


def _bounds(extra: str = "") -> list[str]:
    """Return what this release requires, or what one of its extras does besides."""
    texts = [text.replace("'", '"') for text in distribution(DISTRIBUTION).requires or ()]
    if not extra:
        return [text for text in texts if "extra ==" not in text]
    return [text.partition(";")[0].strip() for text in texts if f'extra == "{extra}"' in text]


def _pinned(text: str) -> str:
    """Pin numpy: its release decides bits, and a cluster gives those of this machine."""
    return f"numpy=={version('numpy')}" if Requirement(text).name == "numpy" else text


def _bundled_pip() -> list[Path]:
    """Return the pip that this Python brings along, so that the machine needs none of its own."""
    bundled = files("ensurepip") / "_bundled"
    return sorted(Path(str(bundled)).glob("pip-*.whl"))[-1:]


def _name(requirement: str) -> str:
    return canonicalize_name(Requirement(requirement).name)
