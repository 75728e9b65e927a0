"""The network of a test bed: a laptop, a router, and a cable from the router to each machine.

::

    laptop 198.51.100.2 ──┐                        ┌── 172.31.0.10, public 203.0.113.10
                          ├── router: nft, EC2, ───┼── 172.31.0.11, public 203.0.113.11
                          │   metadata             │
                          └── no way back but for answers

The router translates public addresses, judges every first packet by the security groups, and
drops what a partition cuts. The laptop is behind it as behind its own NAT: machines cannot begin
a connection to it, and it cannot use their private addresses.
"""

from __future__ import annotations

import ctypes
import ipaddress
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

LAPTOP = "198.51.100.2"
GATEWAY = "198.51.100.1"
ENDPOINT = "203.0.113.1"
METADATA = "169.254.169.254"
PRIVATE_NETWORK = ipaddress.ip_network("172.31.0.0/16")
PUBLIC_NETWORK = ipaddress.ip_network("203.0.113.0/24")
ROUTER_INSIDE = "172.31.0.1"
_CLONE_NEWNET = 0x40000000


class TestBedError(Exception):
    """The test bed itself does not work."""

    __test__ = False


def command(*arguments: str, stdin: str = "") -> str:
    """Run a program of the system and return what it says."""
    done = subprocess.run(arguments, input=stdin, text=True, capture_output=True, check=False)
    if done.returncode:
        raise TestBedError(f"{' '.join(arguments)}: {done.stderr.strip()}\n{stdin}")
    return done.stdout


def missing() -> str:
    """Return why no test bed can be had here; nothing where one can."""
    if os.geteuid() != 0:
        return "the test bed needs root"
    programs = ("ip", "nft", "sudo", "unshare", "nsenter", "ps", "ssh-keygen", "/usr/sbin/sshd")
    absent = [name for name in programs if not shutil.which(name)]
    if absent:
        return f"the test bed needs {', '.join(absent)}"
    probe = "mount -t tmpfs none /mnt && mkdir /mnt/u /mnt/w /mnt/r && mount -t overlay none -o "
    probe += (
        "lowerdir=/,upperdir=/mnt/u,workdir=/mnt/w /mnt/r && echo 1 >/proc/sys/net/ipv4/ip_forward"
    )
    tried = subprocess.run(
        ["unshare", "--mount", "--net", "--pid", "--fork", "sh", "-c", probe],
        capture_output=True,
        text=True,
        check=False,
    )
    return f"no namespaces here: {tried.stderr.strip()}" if tried.returncode else ""


class Namespace:
    """A network of its own, which lives as long as the pipe to its only process."""

    def __init__(self) -> None:
        self._holder = subprocess.Popen(
            ["unshare", "--net", "sh", "-c", "ip link set lo up && echo up && exec cat"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._holder.stdout is not None
        if self._holder.stdout.readline() != b"up\n":
            raise TestBedError("no network namespace")
        self.pid = self._holder.pid

    @property
    def prefix(self) -> list[str]:
        """What to put before a command that shall run in here."""
        return ["nsenter", f"--net=/proc/{self.pid}/ns/net", "--"]

    def ip(self, batch: str) -> None:
        """Run lines of `ip`."""
        command(*self.prefix, "ip", "-batch", "-", stdin=batch)

    def listen(self, address: str, port: int) -> socket.socket:
        """Return a listening socket in here; its connections may be served from anywhere."""

        def make() -> socket.socket:
            with open(f"/proc/{self.pid}/ns/net") as network:
                if ctypes.CDLL(None, use_errno=True).setns(network.fileno(), _CLONE_NEWNET):
                    raise TestBedError(os.strerror(ctypes.get_errno()))
            return socket.create_server((address, port), backlog=128)

        with ThreadPoolExecutor(1) as thread:  # a namespace is entered by one thread, for good
            return thread.submit(make).result()

    def close(self) -> None:
        assert self._holder.stdin is not None
        assert self._holder.stdout is not None
        self._holder.stdin.close()
        self._holder.wait()
        self._holder.stdout.close()


@dataclass(frozen=True)
class Permission:
    """Who may begin a TCP connection to a machine.

    Parameters
    ----------
    target : str
        The machine's private address.
    source : str
        An address or network.
    ports : str
        A port, or first and last with a hyphen.
    """

    target: str
    source: str
    ports: str


class Network:
    """Router and laptop, and the router's rules."""

    def __init__(self) -> None:
        self.router, self.laptop = Namespace(), Namespace()
        self._lock = threading.RLock()
        self._public: dict[str, str] = {}
        self._permissions: frozenset[Permission] = frozenset()
        self._cut: set[str] = set()
        self.router.ip(
            f"link add laptop type veth peer name eth0 netns {self.laptop.pid}\n"
            f"addr add {GATEWAY}/24 dev laptop\n"
            "link set laptop up\n"
            f"addr add {ENDPOINT}/32 dev lo\n"
            f"addr add {METADATA}/32 dev lo\n"
            # No machine, no answer: without this the router would tell at once that it is gone.
            f"route add blackhole {PRIVATE_NETWORK}\n"
            f"route add blackhole {PUBLIC_NETWORK}\n"
        )
        self.laptop.ip(
            f"addr add {LAPTOP}/24 dev eth0\nlink set eth0 up\nroute add default via {GATEWAY}\n"
        )
        command(*self.router.prefix, "sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward")
        self._apply()

    def plug(self, machine: Namespace, address: str) -> None:
        """Lay a cable to a machine."""
        port = f"port{int(ipaddress.ip_address(address)) & 0xFFFF}"
        self.router.ip(
            f"link add {port} type veth peer name eth0 netns {machine.pid}\n"
            f"link set {port} up\n"
            f"addr add {ROUTER_INSIDE}/32 dev {port}\n"
            f"route add {address}/32 dev {port}\n"
        )
        machine.ip(
            f"addr add {address}/32 dev eth0\n"
            "link set eth0 up\n"
            f"route add {ROUTER_INSIDE}/32 dev eth0\n"
            f"route add default via {ROUTER_INSIDE}\n"
        )

    def publish(self, public: str, private: str) -> None:
        """Let a public address lead to a machine."""
        with self._lock:
            self._public[public] = private
            self._apply()

    def forget(self, private: str) -> None:
        """Undo all that was said about a machine, its partition included."""
        with self._lock:
            self._public = {k: v for k, v in self._public.items() if v != private}
            self._permissions = frozenset(p for p in self._permissions if p.target != private)
            self._cut.discard(private)
            self._apply()

    def permit(self, permissions: Iterable[Permission]) -> None:
        """Make these the only first packets that pass."""
        with self._lock:
            self._permissions = frozenset(permissions)
            self._apply()

    def cut(self, private: str) -> None:
        """Drop all that comes from a machine and goes to it, without a word."""
        with self._lock:
            self._cut.add(private)
            self._apply()

    def heal(self, private: str) -> None:
        """End a partition."""
        with self._lock:
            self._cut.discard(private)
            self._apply()

    def close(self) -> None:
        self.laptop.close()
        self.router.close()

    def _apply(self) -> None:
        """Load all rules in one transaction; what is established stays."""
        public = [f"{public} : {private}" for public, private in sorted(self._public.items())]
        allowed = sorted(f"{p.target} . {p.source} . {p.ports}" for p in self._permissions)
        rules = f"""
table ip cloud
delete table ip cloud
table ip cloud {{
    map public {{ type ipv4_addr : ipv4_addr; {_elements(public)} }}
    set allowed {{
        type ipv4_addr . ipv4_addr . inet_service; flags interval; auto-merge; {_elements(allowed)}
    }}
    set cut {{ type ipv4_addr; {_elements(sorted(self._cut))} }}
    chain outside {{
        type filter hook prerouting priority raw;
        iifname "laptop" ip daddr {PRIVATE_NETWORK} drop
    }}
    chain translate {{
        type nat hook prerouting priority dstnat;
        dnat to ip daddr map @public
    }}
    chain judge {{
        type filter hook forward priority filter; policy drop;
        ip saddr @cut drop
        ip daddr @cut drop
        ct state established,related accept
        ip daddr . ip saddr . tcp dport @allowed accept
    }}
}}
"""
        command(*self.router.prefix, "nft", "-f", "-", stdin=rules)


def _elements(elements: list[str]) -> str:
    return f"elements = {{ {', '.join(elements)} }};" if elements else ""
