"""Logging in by SSH: one attempt, and in words why it failed."""

from __future__ import annotations

import errno
import socket
from contextlib import ExitStack

import paramiko

from hpcdeploy.ssh_target import Target

__all__ = ["HostKeyError", "UnknownHostKeyError", "connect", "explain"]

CONNECT_S = 10.0
HANDSHAKE_S = 30.0  # a machine that boots is slow to answer
KEEPALIVE_S = 15
SILENCE_S = 60  # keepalives that nobody acknowledges for so long end the connection


class UnknownHostKeyError(paramiko.SSHException):
    """The host key is not pinned, so nobody can tell whose it is."""


HostKeyError = (paramiko.BadHostKeyException, UnknownHostKeyError)
"""What no further attempt changes."""


class _Refuse(paramiko.MissingHostKeyPolicy):
    """Never accept a host key unseen."""

    def missing_host_key(
        self, client: paramiko.SSHClient, hostname: str, key: paramiko.PKey
    ) -> None:
        del client
        raise UnknownHostKeyError(hostname, key.fingerprint)


def connect(target: Target, closer: ExitStack) -> paramiko.SSHClient:
    """Log in, over the machines on the way.

    Parameters
    ----------
    target : Target
    closer : ExitStack
        Given what must be closed in the end.

    Raises
    ------
    OSError, EOFError, paramiko.SSHException
        `explain` says in words what they mean.
    """
    before: paramiko.SSHClient | None = None
    for hop in (*target.jumps, target):
        before = _connect(hop, _open_way(hop, before, closer), closer)
    assert before is not None  # noqa: S101 - the target itself is always there
    return before


def _open_way(
    hop: Target, before: paramiko.SSHClient | None, closer: ExitStack
) -> socket.socket | paramiko.Channel:
    """Open a way to a machine: directly, or through the one before it."""
    if before is None:
        way = closer.enter_context(socket.create_connection((hop.address, hop.port), CONNECT_S))
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # elsewhere a dead network shows after minutes
            way.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, SILENCE_S * 1000)
        return way
    transport = before.get_transport()
    if transport is None:
        raise EOFError
    start = ("127.0.0.1", 0)
    return closer.enter_context(
        transport.open_channel("direct-tcpip", (hop.address, hop.port), start)
    )


def _connect(
    hop: Target, way: socket.socket | paramiko.Channel, closer: ExitStack
) -> paramiko.SSHClient:
    client = closer.enter_context(paramiko.SSHClient())
    client.set_missing_host_key_policy(_Refuse())
    for key in hop.host_keys:
        client.get_host_keys().add(hop.known_as, key.get_name(), key)
    if not hop.host_keys:
        for file in hop.known_hosts:
            try:
                client.load_system_host_keys(file)
            except FileNotFoundError:
                continue
    try:
        _log_in(client, hop, way)
    except (*HostKeyError, paramiko.AuthenticationException):
        raise
    except paramiko.SSHException as error:
        transport = client.get_transport()
        if transport is not None and transport.is_active():
            # a key file is tried as every kind of key, and the last kind is what paramiko tells of
            raise paramiko.AuthenticationException from error
        raise
    return client


def _log_in(client: paramiko.SSHClient, hop: Target, way: socket.socket | paramiko.Channel) -> None:
    client.connect(
        hop.known_as,  # the way is open already: only the host key is looked up by it
        port=22,
        username=hop.user,
        key_filename=list(hop.key_files) or None,  # type: ignore[arg-type]  # a list will do
        allow_agent=not hop.host_keys,
        look_for_keys=not hop.key_files,
        timeout=CONNECT_S,
        banner_timeout=HANDSHAKE_S,
        auth_timeout=HANDSHAKE_S,
        sock=way,
    )
    transport = client.get_transport()
    if transport is not None:
        transport.set_keepalive(KEEPALIVE_S)


def explain(error: BaseException) -> str:
    """Say in words why a connection failed or ended."""
    match error:
        case paramiko.BadHostKeyException():
            return (
                f"its host key is {error.key.fingerprint}, not the pinned "
                f"{error.expected_key.fingerprint}: another machine answers"
            )
        case UnknownHostKeyError():
            return f"its host key {error.args[1]} is not known"
        case paramiko.PasswordRequiredException():
            return "the private key has a passphrase"
        case paramiko.AuthenticationException():
            return "permission denied"
        case paramiko.ChannelException():
            return f"the channel was refused ({error.text})"
        case TimeoutError():
            return "no answer"
        case ConnectionRefusedError():
            return "connection refused"
        case EOFError():
            return "the connection was lost"
        case socket.gaierror():
            return "no such host name"
        case OSError() if error.errno in (errno.EHOSTUNREACH, errno.ENETUNREACH):
            return "no way to it"
        case OSError():
            return error.strerror or str(error) or "the connection was lost"
    return " ".join(str(error).split()) or type(error).__name__
