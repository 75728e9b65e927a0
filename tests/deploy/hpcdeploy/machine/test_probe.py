"""What a machine says of itself is read, and not trusted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.machine.local_shell import LocalShell
from hpcdeploy.machine.probe import probe


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


@pytest.mark.parametrize("words", ["three True", "3.12 True more"])
def test_an_interpreter_that_says_nonsense_is_none(
    shell: LocalShell, tmp_path: Path, words: str
) -> None:
    say(tmp_path, "python3.12", words)
    assert all(name != "python3.12" for name, _ in probe(shell, "lab", "x", ">=3.11").kinds)
