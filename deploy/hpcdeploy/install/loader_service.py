"""The loader's service on a machine: systemd's where there is one, else a process that is watched.

::

    systemd ────────> loader ──> component ──> worker
    setsid sh ──────> loader ──> component ──> worker      no systemd, or no right to use it

Both start the loader again after 10 s when it ends, but not after exit code 2: a wrong
configuration does not come right by starting again.
"""

from __future__ import annotations

import shlex

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import Shell

START_S = 60.0

_UNIT = """# written by hpcapp
[Unit]
Description=hpcapp loader of cluster {cluster}
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=0

[Service]
Type=exec
User={user}
WorkingDirectory={home}/{folder}
ExecStart={home}/{folder}/venv/bin/python -P -m hpcloader run --config {home}/{folder}/loader.yaml
StandardOutput=append:{home}/{folder}/loader.log
StandardError=append:{home}/{folder}/loader.log
Restart=always
RestartSec=10
RestartPreventExitStatus=2
KillMode=mixed
TimeoutStopSec=15
Environment=PYTHONUNBUFFERED=1 OMP_NUM_THREADS=1
NoNewPrivileges=yes
ProtectSystem=strict
PrivateTmp=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectControlGroups=yes
RestrictSUIDSGID=yes
UMask=0077

[Install]
WantedBy=multi-user.target
"""

_WATCHER = """#!/bin/sh
# written by hpcapp: keeps the loader running
cd "$(dirname "$0")" || exit 1
umask 077
export PYTHONUNBUFFERED=1
trap 'kill "$child" 2>/dev/null; wait "$child"; exit 0' TERM INT HUP
while :; do
    venv/bin/python -P -m hpcloader run --config loader.yaml >>loader.log 2>&1 </dev/null &
    child=$!
    wait "$child"
    [ $? = 2 ] && exit 2
    sleep 10 &
    child=$!
    wait "$child"
done
"""

# A process id may be another's by now: the time of its start tells. One that has ended may stay as
# a zombie (Z) for as long as nobody asks for its exit code.
_IS_OURS = """{ read -r pid start <loader.pid &&
    now=$(sed -n 's/.*) [^ZX] //p' "/proc/$pid/stat" | cut -d' ' -f19) &&
    [ "$now" = "$start" ]; } 2>/dev/null"""

# What runs for a cluster has its folder as working directory; a pid file would not tell of a loader
# whose watcher was killed. Each gets a SIGTERM when nobody above it is left that would pass it on.
# The brackets keep the patterns from meeting the command line of this very script.
_STOP = """cd FOLDER 2>/dev/null || exit 0
running() {
    for process in /proc/[0-9]*; do
        [ "$process/cwd" -ef . ] || continue
        case $(tr '\\0' ' ' 2>/dev/null <"$process/cmdline") in
        $1) echo "${process#/proc/}" ;;
        esac
    done
}
watchers() { running '*/watch[-]loader '; }
loaders() { running '* -P -m hpc[l]oader run *'; }
components() { running '* -P -m hpc[c]omponent*'; }
n=0
asked=
while pids=$(watchers | grep . || loaders | grep . || components | grep .); do
    [ "$pids" = "$asked" ] || kill -TERM $pids 2>/dev/null
    asked=$pids
    [ $n = 80 ] && kill -KILL $(watchers; loaders; components) 2>/dev/null
    [ $n = 100 ] && { echo process $pids >&2; exit 1; }
    n=$((n + 1))
    sleep 0.1
done
rm -f loader.pid
"""

_START = """umask 077
cat >watch-loader || exit 1
setsid sh "$PWD/watch-loader" </dev/null >/dev/null 2>&1 &
pid=$!
echo "$pid $(sed 's/.*) //' /proc/$pid/stat | cut -d' ' -f20)" >loader.pid
"""


def is_running_command(cluster: str) -> str:
    """Return the shell's condition that the loader runs, for use in the cluster's folder."""
    return f"{{ systemctl is-active -q {unit_name(cluster)} 2>/dev/null || {_IS_OURS}; }}"


def unit_name(cluster: str) -> str:
    """Return the name of the service of systemd."""
    return f"hpcapp-{cluster}.service"


def stop_command(cluster: str, folder: str) -> str:
    """Return the command that ends the loader, whichever way it was started."""
    unit = unit_name(cluster)
    path = f"/etc/systemd/system/{unit}"
    return (
        f"if [ -e {path} ]; then sudo -n systemctl disable --now -q {unit};"
        f" sudo -n rm -f {path}; fi\n" + _STOP.replace("FOLDER", shlex.quote(folder))
    )


def start_loader(
    shell: Shell, cluster: str, folder: str, *, user: str, home: str, has_systemd: bool
) -> None:
    """Start the loader anew, and see to it that it stays.

    With `has_systemd` it is made a service of systemd; otherwise a process watches over it.
    """
    if has_systemd:
        unit = unit_name(cluster)
        text = _UNIT.format(cluster=cluster, user=user, home=home, folder=folder)
        command = (
            f"umask 077; touch {folder}/loader.log; "
            f"sudo -n tee /etc/systemd/system/{unit} >/dev/null && "
            f"sudo -n systemctl daemon-reload && sudo -n systemctl enable -q {unit} && "
            f"sudo -n systemctl restart {unit}"
        )
    else:
        text = _WATCHER
        command = stop_command(cluster, folder) + _START
    done = shell.run(command, stdin=text.encode(), timeout_s=START_S)
    if done.exit_code:
        raise CloudError(f"{shell.node}: the loader cannot be started: {done.reason}")
