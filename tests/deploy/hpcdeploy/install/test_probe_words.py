"""What a machine is: asked of real interpreters, and read without trust in what it says."""

from __future__ import annotations

import os
import shutil
import sys
import venv
from pathlib import Path

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.install.probe import DAMAGED, Probed, probe
from hpcdeploy.login.local_shell import LocalShell


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LocalShell:
    """A machine whose commands are those of a folder first."""
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", f"{tmp_path}/bin:{os.environ['PATH']}")
    return LocalShell("head", tmp_path)


def say(folder: Path, command: str, words: str) -> None:
    path = folder / "bin" / command
    path.write_text(f"#!/bin/sh\nprintf '%s\\n' '{words}'\n")
    path.chmod(0o755)


def test_this_machine_is_probed(shell: LocalShell) -> None:
    found = probe(shell, "lab", "hpcapp/lab", ">=3.11")
    assert found.clock > 1_700_000_000
    assert not found.is_running


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("date", "half past seven"),
        ("date", "9" * 5000),
        ("uname", "x86_64; reboot"),
        ("getconf", "glibc 2." + "9" * 5000),
    ],
)
def test_a_machine_that_says_nonsense_is_one_line(
    shell: LocalShell, tmp_path: Path, command: str, words: str
) -> None:
    say(tmp_path, command, words)
    with pytest.raises(CloudError, match="head: no Linux system with a shell") as caught:
        probe(shell, "lab", "hpcapp/lab", ">=3.11")
    assert "\n" not in str(caught.value)


def test_a_machine_that_says_much_is_quoted_in_part(shell: LocalShell, tmp_path: Path) -> None:
    say(tmp_path, "date", "x" * 70_000)
    command = tmp_path / "bin/date"
    command.write_text(command.read_text().rstrip() + " >&2\n")
    with pytest.raises(CloudError, match=r"it says 'x+'\)") as caught:
        probe(shell, "lab", "hpcapp/lab", ">=3.11")
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("words", ["three True", "3.12 True more"])
def test_an_interpreter_that_says_nonsense_is_none(
    shell: LocalShell, tmp_path: Path, words: str
) -> None:
    say(tmp_path, "python3.12", words)
    assert all(name != "python3.12" for name, _ in probe(shell, "lab", "x", ">=3.11").kinds)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A cluster's folder with an environment that has one distribution of two files."""
    folder = tmp_path / "hpcapp/lab"
    folder.mkdir(parents=True)
    venv.create(folder / "venv", with_pip=False)
    site = next((folder / "venv/lib").glob("python3*/site-packages"))
    records = {
        "hpcapp-1.2.dist-info/METADATA": "Metadata-Version: 2.1\nName: hpcapp\nVersion: 1.2\n",
        "hpcapp-1.2.dist-info/RECORD": "",
        "package/module.py": "",
        "package/compiled.pyc": None,
        "../../../bin/command": None,
    }
    for name, text in records.items():
        if text is not None:
            (site / name).parent.mkdir(exist_ok=True)
            (site / name).write_text(text)
    (site / "hpcapp-1.2.dist-info/RECORD").write_text("".join(f"{name},,\n" for name in records))
    return folder


def ask(home: Path, python: str = ">=3.11") -> Probed:
    return probe(LocalShell("head", home), "lab", "hpcapp/lab", python)


def test_an_environment_is_whole_damaged_or_gone(folder: Path, tmp_path: Path) -> None:
    assert ask(tmp_path).release == "1.2"
    [module] = folder.rglob("module.py")
    module.unlink()
    assert ask(tmp_path).release == DAMAGED
    shutil.rmtree(folder / "venv/bin")
    assert ask(tmp_path).release == ""


@pytest.mark.parametrize(
    "talk", ["echo loading modules", "printf 'no end'", "echo; echo 3.1 False, says the wrapper"]
)
def test_what_a_wrapper_says_is_no_answer(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, talk: str
) -> None:
    programs = tmp_path / "programs"
    programs.mkdir()
    for wrapper in (programs / "python3", folder / "venv/bin/python"):
        wrapper.unlink(missing_ok=True)
        real = sys.executable if wrapper.parent == programs else folder / "venv/bin/python3"
        wrapper.write_text(f'#!/bin/sh\n{talk}\n{real} "$@"\n{talk}\n')
        wrapper.chmod(0o755)
    (folder / "venv/bin/python3").unlink()
    (folder / "venv/bin/python3").symlink_to(Path(sys.executable).resolve())
    monkeypatch.setenv("PATH", f"{programs}:/usr/bin:/bin")
    probed = ask(tmp_path)
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    assert f"{version} (python3)" in probed.pythons
    assert probed.kinds[0][0] == "python3"
    assert probed.release == "1.2"
