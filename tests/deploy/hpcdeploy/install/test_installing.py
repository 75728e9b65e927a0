"""Installing wheels on a machine, by a pip that comes along."""

from __future__ import annotations

import sys
import zipfile
from importlib.resources import files
from pathlib import Path

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.install.installing import install
from hpcdeploy.install.wheels.requirements import MachineNeeds
from hpcdeploy.login.local_shell import LocalShell


def wheel(folder: Path, name: str, version: str, *requires: str) -> Path:
    path = folder / f"{name}-{version}-py3-none-any.whl"
    meta = f"{name}-{version}.dist-info"
    lines = "".join(f"Requires-Dist: {text}\n" for text in requires)
    with zipfile.ZipFile(path, "w") as archive:
        head = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        archive.writestr(f"{meta}/METADATA", head + lines)
        archive.writestr(f"{meta}/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        archive.writestr(f"{meta}/RECORD", "")
    return path


def install_all(home: Path, *wheels: Path) -> None:
    """Install wheels on a machine without internet; the last is the release."""
    pip = sorted(Path(str(files("ensurepip") / "_bundled")).glob("pip-*.whl"))
    names = tuple(path.name for path in wheels)
    needs = MachineNeeds((*pip, *wheels), names[:-1], names[-1], is_offline=True)
    shell = LocalShell("worker-1", home)
    install(shell, "hpcapp/lab", sys.executable, needs, (), print)


def test_the_release_is_installed_without_what_only_a_head_needs(tmp_path: Path) -> None:
    one, release = wheel(tmp_path, "one", "1.0"), wheel(tmp_path, "app", "1.0", "one", "lost")
    install_all(tmp_path, one, release)
    packages = tmp_path / f"hpcapp/lab/venv/lib/python3.{sys.version_info.minor}/site-packages"
    assert {path.name for path in packages.glob("*.dist-info")} == {
        "one-1.0.dist-info",
        "app-1.0.dist-info",
    }


def test_wheels_that_exclude_each_other_are_named(tmp_path: Path) -> None:
    one, two = wheel(tmp_path, "one", "2.0"), wheel(tmp_path, "two", "1.0", "one<2")
    with pytest.raises(CloudError, match=r"the installation failed: ERROR: .*conflicting"):
        install_all(tmp_path, one, two, wheel(tmp_path, "app", "1.0"))
