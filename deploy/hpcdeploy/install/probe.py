"""What a machine is, asked by one command that changes nothing."""

from __future__ import annotations

import re
import shlex
import sys

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CloudError
from hpcdeploy.install.loader_service import is_running_command
from hpcdeploy.install.wheels.wheelhouse import Kind
from hpcdeploy.login.shell import MOST_REASON, Shell

PROBE_S = 60.0
_PYTHONS = ("python3", *(f"python3.{minor}" for minor in range(14, 6, -1)))
_ASK = (
    "import sys, importlib.util as u; "
    'print("\\n%d.%d" % sys.version_info[:2], bool(u.find_spec("venv")))'
)
# An environment of ours is whole while all modules that its wheels brought are there: commands lie
# outside (..), and compiled code comes and goes.
_RELEASE = """
import csv, pathlib, sys
from importlib.metadata import distributions, version
is_ours = pathlib.Path("venv").resolve() == pathlib.Path(sys.prefix).resolve()
records = [(d, d.read_text("RECORD") or "") for d in distributions() if is_ours]
rows = ((d, row[0]) for d, text in records for row in csv.reader(text.splitlines()) if row)
names = ((d, name) for d, name in rows if not name.startswith("..") and name[-4:] != ".pyc")
files = (d.locate_file(name) for d, name in names)
print("\\nhpcapp:", version("hpcapp") if all(map(pathlib.Path.exists, files)) else "damaged")
"""
RELEASE_COMMAND = (
    f"venv/bin/python -P -c {shlex.quote(_RELEASE)} 2>/dev/null | sed -n 's/^hpcapp: //p'"
)
"""In a cluster's folder: prints the release that is installed, `DAMAGED`, or nothing."""
DAMAGED = "damaged"
_SCRIPT = """
echo "architecture=$(uname -m)"
if libc=$(getconf GNU_LIBC_VERSION 2>/dev/null); then echo "libc=$libc"
else echo "libc=musl $(ldd 2>&1 | sed -n 's/^Version //p')"; fi
for name in {pythons}; do
    said=$($name -c {ask} 2>/dev/null | grep -E '^[0-9]+[.][0-9]+ (True|False)$' | tail -n 1)
    [ "$said" ] && echo "python=$name $said"
done
sudo -n true 2>/dev/null && echo sudo=yes
[ -d /run/systemd/system ] && echo systemd=yes
echo "home=$HOME"
echo "user=$(id -un)"
echo "now=$(date +%s)"
echo "free=$(df -Pk . | awk 'NR == 2 {{print $4}}')"
cd {folder} 2>/dev/null || exit 0
echo "installed=$(cat installed 2>/dev/null)"
echo "release=$({release})"
[ -s connection.json ] && [ -s loader.yaml ] && echo "configured=$(cat configured 2>/dev/null)"
{is_running} && echo running=yes
exit 0
"""
_FORMS = {
    "architecture": r"[0-9A-Za-z_]{1,40}",
    "now": r"[0-9]{1,15}",
    "free": r"[0-9]{0,18}",
    "home": r"/.{0,4095}",
    "user": r"\S{1,256}",
}
"""What a machine must say, and how."""
_PYTHON = re.compile(r"python3[0-9.]* [0-9]{1,3}\.[0-9]{1,3} (True|False)")


@dataclass(frozen=True, slots=True)
class Probed:
    """What one machine is.

    Parameters
    ----------
    kinds : tuple of (str, Kind)
        The interpreters that would do, and which wheels run with each; the first is preferred.
    pythons : tuple of str
        All interpreters that there are, as a user reads it.
    is_root_able, has_systemd : bool
        Whether sudo asks no password, and whether services are systemd's.
    clock : int
        Its time, in seconds since 1970.
    free : int
        Bytes free on the disk of the home.
    installed, configured : str
        The stamps of what we have put there before; empty where there is none.
    release : str
        What is installed there; `DAMAGED` where files of it are missing, empty where it is gone.
    is_running : bool
        Whether the loader runs.
    """

    kinds: tuple[tuple[str, Kind], ...]
    pythons: tuple[str, ...]
    is_root_able: bool
    has_systemd: bool
    home: str
    user: str
    clock: int
    free: int
    installed: str
    configured: str
    release: str
    is_running: bool


def probe(
    shell: Shell, cluster: str, folder: str, python: str, timeout_s: float = PROBE_S
) -> Probed:
    """Ask a machine what it is; `folder` is the cluster's on it.

    Raises CloudError where the machine does not answer as a POSIX system does.
    """
    script = _SCRIPT.format(
        pythons=" ".join(_PYTHONS),
        ask=shlex.quote(_ASK),
        folder=folder,
        release=RELEASE_COMMAND,
        is_running=is_running_command(cluster),
    )
    done = shell.run(script, timeout_s=timeout_s)
    lines = [line.partition("=")[::2] for line in done.output.splitlines()]
    said = dict(lines)
    libc = re.search(r"(glibc|musl)\s+([0-9]{1,4})\.([0-9]{1,4})\b", said.get("libc", ""))
    if libc is None or not all(
        re.fullmatch(form, said.get(key, "")) for key, form in _FORMS.items()
    ):
        said_instead = ((done.errors or done.output).strip().splitlines() or ["nothing"])[-1]
        raise CloudError(
            f"{shell.node}: no Linux system with a shell (it says {said_instead[:MOST_REASON]!r})"
        )
    pythons = [
        value.split() for key, value in lines if key == "python" and _PYTHON.fullmatch(value)
    ]
    kinds = [
        (name, Kind(said["architecture"], libc[1], (int(libc[2]), int(libc[3])), _pair(version)))
        for name, version, has_venv in pythons
        if has_venv == "True" and _pair(version) >= _pair(python.removeprefix(">="))
    ]
    return Probed(
        kinds=tuple(kinds),
        pythons=tuple(
            f"{version} ({name}{'' if has_venv == 'True' else ', without venv'})"
            for name, version, has_venv in pythons
        ),
        is_root_able="sudo" in said or said["user"] == "root",
        has_systemd="systemd" in said,
        home=said["home"],
        user=said["user"],
        clock=int(said["now"]),
        free=int(said.get("free") or 0) * 1024,
        installed=said.get("installed", ""),
        configured=said.get("configured", ""),
        release=said.get("release", ""),
        is_running="running" in said,
    )


def check_this_python(python: str) -> None:
    """Refuse the interpreter that runs here where it will not do."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    if _pair(version) < _pair(python.removeprefix(">=")):
        raise CloudError(
            f"no Python {python} (found: {version}, which runs hpcapp: {sys.executable})",
            "install hpcapp with such a Python, or change env.python",
        )


def no_python(probed: Probed, python: str) -> CloudError:
    """Return the error that a machine has no interpreter which will do."""
    return CloudError(
        f"no Python {python} with its venv module (found: {', '.join(probed.pythons) or 'none'})",
        "take another image, or install it by env.setup",
    )


def _pair(version: str) -> tuple[int, int]:
    major, minor = version.split(".")[:2]
    return int(major), int(minor)
