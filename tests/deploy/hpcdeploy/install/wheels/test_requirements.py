"""What a machine needs: derived from what the code imports, and found or missed in a wheelhouse."""

from __future__ import annotations

import ast
import sys
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

import hpccomponent
import hpcloader
from hpccomponent.errors import CloudError
from hpcdeploy.install.wheels.release import pack_release
from hpcdeploy.install.wheels.requirements import (
    WORKER_NEEDS,
    check_wheels,
    choose_release,
    needs_of,
)
from hpcdeploy.install.wheels.wheelhouse import Kind, fits, kinds_of, select_wheels
from hpcdeploy.spec.cluster import ClusterSpec

BOOKWORM = Kind("x86_64", "glibc", (2, 36), (3, 11))
ALPINE = Kind("x86_64", "musl", (1, 2), (3, 11))
# Imported inside functions only: by the numpy oracle of what the master does, for a bucket, for
# bars and lines on a terminal, which no worker has, and where a master's files are decoded.
OPTIONAL = {"scipy", "boto3", "botocore", "click", "rich", "laszip", "lazrs", "pye57"}
OURS = {"hpccomponent", "hpcloader"}


def imported(package: object) -> set[str]:
    """Return the top-level names of all that a package's files import."""
    found = set()
    places = map(Path, package.__path__)  # type: ignore[attr-defined]
    for path in (path for place in places for path in place.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).partition(".")[0])
    return found


def test_a_worker_gets_exactly_what_component_and_loader_import() -> None:
    names = imported(hpccomponent) | imported(hpcloader)
    names -= OURS | OPTIONAL | set(sys.stdlib_module_names)
    owners = packages_distributions()
    needed = {canonicalize_name(owners[name][0]) for name in names}
    assert needed - {"pydantic-core"} == set(WORKER_NEEDS)


def wheel(folder: Path, name: str, version: str, tag: str, *requires: str) -> Path:
    path = folder / f"{name}-{version}-{tag}.whl"
    lines = "".join(f"Requires-Dist: {text}\n" for text in requires)
    with zipfile.ZipFile(path, "w") as archive:
        meta = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{lines}"
        archive.writestr(f"{name}-{version}.dist-info/METADATA", meta)
    return path


def test_the_newest_wheel_that_fits_is_chosen_with_all_it_requires(tmp_path: Path) -> None:
    wheel(tmp_path, "a", "1.0", "py3-none-any", "b>=2", 'c; sys_platform == "win32"')
    best = wheel(tmp_path, "b", "2.1", "cp311-cp311-manylinux_2_28_x86_64", 'd; extra == "x"')
    wheel(tmp_path, "b", "2.2", "cp311-cp311-manylinux_2_39_x86_64")
    wheel(tmp_path, "b", "2.3", "cp312-cp312-manylinux_2_28_x86_64")
    wheel(tmp_path, "b", "1.0", "py3-none-any")
    wheels, missing = select_wheels([tmp_path], ["a"], BOOKWORM)
    assert [path.name for path in wheels][1:] == [best.name]
    assert missing == ()


def test_an_older_wheel_is_chosen_where_another_one_bounds_it(tmp_path: Path) -> None:
    wheel(tmp_path, "a", "1.0", "py3-none-any", "c<2")
    wheel(tmp_path, "c", "2.0", "py3-none-any")
    assert select_wheels([tmp_path], ["c", "a"], BOOKWORM)[1] == ("c<2",)
    older = wheel(tmp_path, "c", "1.0", "py3-none-any")
    wheels, missing = select_wheels([tmp_path], ["c", "a"], BOOKWORM)
    assert (older in wheels, len(wheels), missing) == (True, 2, ())
    assert select_wheels([tmp_path], ["c>=2", "a"], BOOKWORM)[1] == ("c>=2",)


def test_extras_that_a_wheel_asks_for_are_needed_too(tmp_path: Path) -> None:
    wheel(tmp_path, "a", "1.0", "py3-none-any", "b[quick]", 'lost; extra == "quick"')
    wheel(tmp_path, "b", "1.0", "py3-none-any", 'c; extra == "quick"', 'd; extra == "slow"')
    assert select_wheels([tmp_path], ["a"], BOOKWORM)[1] == ("c (for b)",)
    assert select_wheels([tmp_path], ["b", "a"], BOOKWORM)[1] == ("c (for b)",)
    assert select_wheels([tmp_path], ["a[quick]"], BOOKWORM)[1] == ("lost (for a)", "c (for b)")


@pytest.mark.parametrize(
    ("tag", "kind", "is_fit"),
    [
        ("cp311-cp311-manylinux2014_x86_64", BOOKWORM, True),
        ("cp310-abi3-manylinux_2_17_x86_64", BOOKWORM, True),
        ("cp311-cp311-musllinux_1_2_x86_64", BOOKWORM, False),
        ("cp311-cp311-musllinux_1_1_x86_64", ALPINE, True),
        ("cp311-cp311-manylinux_2_17_aarch64", BOOKWORM, False),
        ("cp312-abi3-manylinux_2_17_x86_64", BOOKWORM, False),
        ("py3-none-any", ALPINE, True),
    ],
)
def test_a_wheel_fits_by_python_library_and_architecture(
    tmp_path: Path, tag: str, kind: Kind, is_fit: bool
) -> None:
    assert fits(wheel(tmp_path, "a", "1", tag), kind) is is_fit


def test_what_is_missing_is_told_with_who_asks_for_it(tmp_path: Path) -> None:
    wheel(tmp_path, "a", "1.0", "py3-none-any", "b>=2")
    assert select_wheels([tmp_path], ["a"], BOOKWORM)[1] == ("b>=2 (for a)",)


def test_what_is_no_wheel_is_named(tmp_path: Path) -> None:
    (tmp_path / "a-1.0-py3-none-any.whl").write_text("an error page")
    with pytest.raises(CloudError, match=r"a-1\.0-py3-none-any\.whl: not a wheel"):
        select_wheels([tmp_path], ["a"], BOOKWORM)


def test_the_release_is_packed_of_what_runs_here_and_always_the_same(tmp_path: Path) -> None:
    [one, two] = [pack_release(tmp_path / n, is_native=False) for n in ("one", "two")]
    assert one is not None
    assert two is not None
    assert one.read_bytes() == two.read_bytes()
    assert fits(one, ALPINE)
    names = zipfile.ZipFile(one).namelist()
    assert {"hpcapp/cli.py", "hpcloader/builds.py", "hpcdeploy/install/first_boot.sh"} <= set(names)
    assert not [name for name in names if name.endswith((".so", ".pyc", ".cpp"))]


def spec(**env: object) -> ClusterSpec:
    host = {"type": "ssh", "hosts": [{"address": "lab1"}]}
    return ClusterSpec.model_validate(
        {"version": 1, "cluster": "lab", "provider": host, "env": env}
    )


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def test_one_machine_without_the_native_build_makes_all_take_the_portable_one(
    tmp_path: Path,
) -> None:
    here = Kind("x86_64", "glibc", (2, 99), sys.version_info[:2])
    for kinds in ([ALPINE], [here, ALPINE]):
        release = choose_release(spec(), tmp_path, kinds)
        assert isinstance(release, Path)
        assert release.name.endswith("-py3-none-any.whl")


def test_a_worker_is_spared_what_only_the_head_needs(tmp_path: Path) -> None:
    release = choose_release(spec(), tmp_path, [ALPINE])
    worker, _ = needs_of(spec(), tmp_path, release, BOOKWORM, is_head=False)
    head, _ = needs_of(spec(), tmp_path, release, BOOKWORM, is_head=True)
    assert len(worker.requirements) == len(WORKER_NEEDS)
    assert set(worker.requirements) < set(head.requirements)


def test_an_application_of_the_users_own_goes_along(tmp_path: Path) -> None:
    mine = wheel(tmp_path, "mine", "1.0", "py3-none-any", "lost>=3")
    wheelhouse = tmp_path / "wheels"
    wheelhouse.mkdir()
    settings = spec(wheelhouse="wheels", packages=["mine-1.0-py3-none-any.whl"])
    needs, missing = needs_of(settings, tmp_path, "hpcapp", BOOKWORM, is_head=False)
    assert mine in needs.files
    assert "lost>=3" in missing


def test_a_wheelhouse_is_checked_for_every_kind_it_has_wheels_for(tmp_path: Path) -> None:
    wheel(tmp_path, "numpy", "2.0", "cp311-cp311-manylinux_2_17_x86_64")
    wheel(tmp_path, "pyyaml", "6.0", "cp312-cp312-musllinux_1_2_aarch64")
    assert [str(kind) for kind in kinds_of(tmp_path)] == [
        "Python 3.12, aarch64, musl",
        "Python 3.11, x86_64, glibc",
    ]
    lines = [problem.what for problem in check_wheels(spec(wheelhouse="."), tmp_path)]
    assert any("no wheel of pyzmq>=25.1 for Python 3.11, x86_64, glibc" in line for line in lines)
    assert any("no wheel of numpy>=1.26 for Python 3.12, aarch64" in line for line in lines)
    assert not any("numpy>=1.26 for Python 3.11" in line for line in lines)


def test_an_empty_wheelhouse_is_one_line(tmp_path: Path) -> None:
    [problem] = check_wheels(spec(wheelhouse="."), tmp_path)
    assert "no compiled wheel" in problem.what


def test_without_a_wheelhouse_nothing_can_be_missing(tmp_path: Path) -> None:
    assert check_wheels(spec(), tmp_path) == []


def test_a_head_gets_what_the_dashboard_needs_where_it_can(tmp_path: Path) -> None:
    head, _ = needs_of(spec(), tmp_path, "hpcapp", BOOKWORM, is_head=True)
    worker, _ = needs_of(spec(), tmp_path, "hpcapp", BOOKWORM, is_head=False)
    assert [text for text in head.requirements if text.startswith("starlette")]
    assert not [text for text in worker.requirements if text.startswith("starlette")]
    (tmp_path / "wheels").mkdir()  # a wheelhouse may do without: no job shows a page then
    _, missing = needs_of(spec(wheelhouse="wheels"), tmp_path, "hpcapp", BOOKWORM, is_head=True)
    assert missing
    assert not [text for text in missing if text.startswith(("starlette", "uvicorn"))]
