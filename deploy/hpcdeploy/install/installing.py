"""Installing the package on one machine: a virtual environment of its own, from wheels."""

from __future__ import annotations

import hashlib
import shlex
import sys
from collections.abc import Callable

from hpccomponent.errors import CloudError
from hpcdeploy.install.wheels.requirements import MachineNeeds
from hpcdeploy.login.shell import MOST_REASON, Shell

INSTALL_S = 900.0
SETUP_S = 1800.0
_PIP = "install --quiet --no-input --disable-pip-version-check --no-cache-dir --no-compile"


def stamp_of(*parts: object) -> str:
    """Return a digest that changes when any part does."""
    return hashlib.sha256("\\0".join(map(str, parts)).encode()).hexdigest()


def install(
    shell: Shell,
    folder: str,
    python: str,
    needs: MachineNeeds,
    setup: tuple[str, ...],
    report: Callable[[str], None],
) -> None:
    """Run the user's commands, upload the wheels, and make the environment from nothing.

    Raises CloudError with the last words of a command that failed.
    """
    prepare(shell, setup, report)
    _run(shell, f"cannot make {folder}", f"umask 077; mkdir -p {folder}/wheels")
    _run(shell, "", f"rm -f {folder}/installed")
    _run(shell, "", _sweep(folder, needs))
    for path in needs.files:
        shell.put(path, f"{folder}/wheels/{path.name}", mode=0o644)
    report(f"{shell.node}: installing {needs.release}")
    _run(shell, "the installation failed", _install_script(folder, python, needs), INSTALL_S)


def prepare(shell: Shell, setup: tuple[str, ...], report: Callable[[str], None]) -> None:
    """Run the user's commands; raise CloudError with the last words of one that failed."""
    for command in setup:
        report(f"{shell.node}: {command}")
        _run(shell, f"env.setup: {command}", command, SETUP_S)


def install_here(shell: Shell, folder: str) -> None:
    """Let a node of this machine use the interpreter that runs here."""
    bin_folder = f"{folder}/venv/bin"
    for name, arguments in (("python", ""), ("hpcapp", " -m hpcapp")):
        text = f'#!/bin/sh\nexec {shlex.quote(sys.executable)}{arguments} "$@"\n'
        write_text(shell, f"{bin_folder}/{name}", text, mode="755")


def write_text(shell: Shell, path: str, text: str, *, mode: str = "600") -> None:
    """Write a small file as a whole; what is in it shows in no command line.

    The folder of `path`, on the machine, is made; `mode` is as chmod takes it.
    """
    command = (
        f"umask 077; mkdir -p {shlex.quote(path.rpartition('/')[0] or '.')} && "
        f"cat >{shlex.quote(path)}.new && chmod {mode} {shlex.quote(path)}.new && "
        f"mv {shlex.quote(path)}.new {shlex.quote(path)}"
    )
    done = shell.run(command, stdin=text.encode())
    if done.exit_code:
        raise CloudError(f"{shell.node}: {path} cannot be written: {_last(done.errors)}")


def _sweep(folder: str, needs: MachineNeeds) -> str:
    """Return the command that takes away wheels of earlier releases."""
    kept = " ".join(f"! -name {shlex.quote(path.name + '*')}" for path in needs.files)
    return f"find {folder}/wheels -type f {kept} -exec rm -f {{}} +"


def _install_script(folder: str, python: str, needs: MachineNeeds) -> str:
    pip = next((path.name for path in needs.files if path.name.startswith("pip-")), None)
    pip_command = f"../venv/bin/python {pip}/pip" if pip else "../venv/bin/python -m pip"
    command = f"{pip_command} {_PIP}{' --no-index --find-links .' if needs.is_offline else ''}"
    return f"""set -e
cd {folder} && rm -rf venv
{python} -m venv {"--without-pip" if pip else ""} venv
cd wheels
{command} {" ".join(map(_word, needs.requirements))}
{command} --no-deps {_word(needs.release)}
"""


def _word(requirement: str) -> str:
    is_file = requirement.endswith(".whl")
    return shlex.quote(f"./{requirement}" if is_file else requirement)


def _run(shell: Shell, what: str, command: str, timeout_s: float = 120.0) -> None:
    done = shell.run(command, timeout_s=timeout_s)
    if done.exit_code:
        said = _last(done.errors or done.output)
        raise CloudError(f"{shell.node}: {what}{': ' if what else ''}{said}")


def _last(text: str) -> str:
    """Return the line that says why: a full disk, pip's own error, or else the last one."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    for mark in ("No space left", "Disk quota", "ERROR:"):
        for line in lines:
            if mark in line:
                return line[:MOST_REASON]
    return lines[-1][:MOST_REASON] if lines else "no reason given"
