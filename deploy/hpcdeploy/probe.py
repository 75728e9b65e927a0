"""What a machine is, asked by one command that changes nothing."""

from __future__ import annotations

import re
from dataclasses import dataclass

from hpccomponent.errors import CloudError
from hpcdeploy.loader_service import is_running_command
from hpcdeploy.shell import Shell
from hpcdeploy.wheelhouse import Kind

__all__ = ["Probed", "probe"]

PROBE_S = 60.0
_PYTHONS = "python3 python3.14 python3.13 python3.12 python3.11"
_SCRIPT = """
echo "architecture=$(uname -m)"
if libc=$(getconf GNU_LIBC_VERSION 2>/dev/null); then echo "libc=$libc"
else echo "libc=musl $(ldd 2>&1 | sed -n 's/^Version //p')"; fi
for name in {pythons}; do
    version=$($name -c 'import sys, venv; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) &&
        echo "python=$name $version"
done
sudo -n true 2>/dev/null && echo sudo=yes
[ -d /run/systemd/system ] && echo systemd=yes
echo "home=$HOME"
echo "user=$(id -un)"
echo "now=$(date +%s)"
echo "free=$(df -Pk . | awk 'NR == 2 {{print $4}}')"
cd {folder} 2>/dev/null || exit 0
echo "installed=$(cat installed 2>/dev/null)"
echo "configured=$(cat configured 2>/dev/null)"
{is_running} && echo running=yes
exit 0
"""


@dataclass(frozen=True, slots=True)
class Probed:
    """What one machine is.

    Parameters
    ----------
    kinds : tuple of (str, Kind)
        The interpreters that would do, and which wheels run with each; the first is preferred.
    is_root_able, has_systemd : bool
        Whether sudo asks no password, and whether services are systemd's.
    home, user : str
    clock : int
        Its time, in seconds since 1970.
    free : int
        Bytes free on the disk of the home.
    installed, configured : str
        The stamps of what we have put there before; empty where there is none.
    is_running : bool
        Whether the loader runs.
    """

    kinds: tuple[tuple[str, Kind], ...]
    is_root_able: bool
    has_systemd: bool
    home: str
    user: str
    clock: int
    free: int
    installed: str
    configured: str
    is_running: bool


def probe(shell: Shell, cluster: str, folder: str, python: str) -> Probed:
    """Ask a machine what it is.

    Parameters
    ----------
    shell : Shell
    cluster, folder : str
        The cluster's name, and its folder on the machine.
    python : str
        Which interpreters will do, as ``env.python`` says it.

    Raises
    ------
    CloudError
        No interpreter will do, or the machine does not answer as a POSIX system does.
    """
    script = _SCRIPT.format(pythons=_PYTHONS, folder=folder, is_running=is_running_command(cluster))
    done = shell.run(script, timeout_s=PROBE_S)
    lines = [line.partition("=")[::2] for line in done.output.splitlines()]
    said = dict(lines)
    libc = re.search(r"(glibc|musl)\s+(\d+)\.(\d+)", said.get("libc", ""))
    if libc is None or "now" not in said:
        said_instead = (done.errors or done.output).strip().splitlines() or ["nothing"]
        raise CloudError(
            f"{shell.node}: no Linux system with a shell (it says {said_instead[-1]!r})"
        )
    pythons = [value.split() for key, value in lines if key == "python"]
    kinds = [
        (name, Kind(said["architecture"], libc[1], (int(libc[2]), int(libc[3])), _pair(version)))
        for name, version in pythons
        if _pair(version) >= _pair(python.removeprefix(">="))
    ]
    if not kinds:
        found = ", ".join(sorted({version for _, version in pythons})) or "none"
        raise CloudError(
            f"{shell.node}: no Python {python} with its venv module (found: {found})",
            "take another image, or install it by env.setup",
        )
    return Probed(
        kinds=tuple(kinds),
        is_root_able="sudo" in said or said["user"] == "root",
        has_systemd="systemd" in said,
        home=said["home"],
        user=said["user"],
        clock=int(said["now"]),
        free=int(said.get("free") or 0) * 1024,
        installed=said.get("installed", ""),
        configured=said.get("configured", ""),
        is_running="running" in said,
    )


def _pair(version: str) -> tuple[int, int]:
    major, minor = version.split(".")[:2]
    return int(major), int(minor)
