"""What a machine of a cloud runs at its first boot: host keys to the console, and the guard.

The guard ends the machine when its lease is over or it is idle, even if this machine here never
comes back: that is what keeps a forgotten cluster from costing money. Idle means that no socket
listens or is connected on the communicator's port, and nobody is logged in.
"""

from __future__ import annotations

from datetime import datetime
from importlib.resources import files

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import Shell
from hpcdeploy.spec.cluster import ClusterSpec

MAX_BYTES = 16384
"""What every cloud takes."""

_LIMITS = "/var/lib/hpcapp/limits"
_EXTEND = """[ -e {limits} ] || exit 0
grep -qx 'lease_until {until}' {limits} && exit 0
text=$(sed 's/^lease_until .*/lease_until {until}/' {limits}) || exit 1
[ -w {limits} ] || write="sudo -n"
echo "$text" | $write tee {limits} >/dev/null
"""


def user_data(spec: ClusterSpec, market: str, lease_until: datetime) -> str:
    """Return the script of a machine's first boot; it holds no secret.

    The machine ends by itself at `lease_until`. `market` is ``on_demand`` or ``spot``: a spot
    machine that is told of its end drains its worker.
    """
    values = {
        "LEASE_UNTIL": int(lease_until.timestamp()),
        "IDLE_S": int(spec.limits.idle),
        "PORT": spec.communicator.port,
        "SSH_PORT": spec.auth.ssh_port,
        "MARKET": market,
        "LOGIN_USER": spec.auth.ssh_user,
        "CLUSTER": spec.cluster,
    }
    text = (files("hpcdeploy.install") / "first_boot.sh").read_text(encoding="utf-8")
    for name, value in values.items():
        text = text.replace(f"@{name}@", str(value))
    return text


def extend_lease(shell: Shell, lease_until: datetime) -> None:
    """Tell the guard of a machine a new end of the lease; where none runs, nothing happens.

    Raises CloudError where the guard's file cannot be written.
    """
    script = _EXTEND.format(limits=_LIMITS, until=int(lease_until.timestamp()))
    done = shell.run(script)
    if done.exit_code:
        raise CloudError(
            f"{shell.node}: the lease in {_LIMITS} cannot be extended: {done.reason}",
            "the machine will end at the earlier time",
        )
