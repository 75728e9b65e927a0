"""Logging in by SSH: one attempt within one time limit, and by its name why it failed."""

from __future__ import annotations

import errno
import queue
import re
import socket
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from textwrap import shorten

import paramiko

from hpccomponent.errors import CloudError
from hpcdeploy.login.ssh.connection import BoundedSocket, SshConnection, SshTimeouts
from hpcdeploy.login.ssh.keys import Identities, find_identities
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.target import SshTarget

LONGEST = 200
QUOTED = 60
"""How much of what a machine says instead of an SSH greeting is shown."""
_LOOK = "check that it runs, its address and port, and the firewall or security group"


def connect(
    target: SshTarget, closer: ExitStack, timeouts: SshTimeouts | None = None
) -> SshConnection:
    """Log in, over the machines on the way.

    Raises ReachError with why it cannot be, and the command that mends it; CloudError where what is
    wrong is here: a file that is no key, no descriptor that is free.
    """
    timeouts = timeouts or SshTimeouts()
    deadline = time.monotonic() + timeouts.login_s
    hops = (*target.jumps, target)
    keys = [
        find_identities(hop.key_files, are_own=not hop.host_keys, closer=closer) for hop in hops
    ]
    before: SshConnection | None = None
    for hop, identities in zip(hops, keys, strict=True):
        try:
            raw: socket.socket | paramiko.Channel
            raw = _dial(hop, timeouts, deadline) if before is None else _lead(before, hop, deadline)
            closer.callback(raw.close)
            wire = BoundedSocket(raw, timeouts.silence_s)
            before = _log_in(hop, wire, identities, deadline, closer)
        except ReachError as error:
            if hop is target:
                raise
            raise ReachError(
                f"{error.reach}: on the way, at {hop.place}: "
                f"{error.problem.removeprefix(f'{error.reach}: ')}",
                error.advice,
                error.reach,
            ) from error
        before.keep_alive(timeouts.beat_s, closer)
    assert before is not None  # noqa: S101 - the target itself is always there
    return before


def _error(reach: LoginFault, detail: str, advice: str) -> ReachError:
    return ReachError(f"{reach}: {detail}", advice, reach)


def _left(deadline: float) -> float:
    return max(0.01, deadline - time.monotonic())


def _dial(hop: SshTarget, timeouts: SshTimeouts, deadline: float) -> socket.socket:
    """Connect to a machine. The look-up of a name knows no time limit, so a thread makes it."""
    answers: queue.SimpleQueue[socket.socket | OSError] = queue.SimpleQueue()
    is_late = threading.Event()

    def dial() -> None:
        try:
            # half the time, so that a second address has its turn
            made = socket.create_connection((hop.address, hop.port), timeouts.login_s / 2)
        except OSError as error:
            answers.put(error)
        except UnicodeError:  # no host name at all, as encodings.idna sees it
            answers.put(socket.gaierror(socket.EAI_NONAME, "no such host name"))
        else:
            answers.put(made)
            if is_late.is_set():
                made.close()

    threading.Thread(target=dial, name="ssh-dial", daemon=True).start()
    try:
        answer = answers.get(timeout=_left(deadline))
    except queue.Empty:
        is_late.set()
        answer = TimeoutError()
    if isinstance(answer, socket.socket):
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # elsewhere a dead network shows after minutes
            limit_ms = round(timeouts.silence_s * 1000)
            answer.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, limit_ms)
        return answer
    if answer.errno in (errno.EMFILE, errno.ENFILE):
        raise CloudError(
            "no file descriptor is free here for a connection", "raise the limit, see ulimit -n"
        ) from answer
    raise _error(LoginFault.UNREACHABLE, f"{explain(answer)} at {hop.place}", _LOOK) from answer


def _lead(before: SshConnection, hop: SshTarget, deadline: float) -> paramiko.Channel:
    """Lead on through the machine before."""
    start = ("127.0.0.1", 0)
    try:
        return before.open_channel(
            "direct-tcpip", (hop.address, hop.port), start, timeout=_left(deadline)
        )
    except (OSError, EOFError, paramiko.SSHException) as error:
        is_late = time.monotonic() >= deadline
        reason = "no answer" if is_late else explain(error)
        detail = f"{reason} at {hop.place}, as the machine on the way sees it"
        raise _error(LoginFault.UNREACHABLE, detail, _LOOK) from error


def _log_in(
    hop: SshTarget, wire: BoundedSocket, identities: Identities, deadline: float, closer: ExitStack
) -> SshConnection:
    known = _known_keys(hop)
    connection = SshConnection(wire)
    closer.callback(connection.close)
    try:
        _shake_hands(connection, hop, known, deadline)
    finally:
        connection.packetizer.complete_handshake()  # else its timer holds up the end of the program
    _check_host_key(connection, hop, known)
    _authenticate(connection, hop, identities, deadline)
    wire.logged_in()
    return connection


def _shake_hands(
    connection: SshConnection, hop: SshTarget, known: dict[str, paramiko.PKey], deadline: float
) -> None:
    """Agree on keys, within the time that is left."""
    options = connection.get_security_options()
    options.key_types = _preferred(tuple(options.key_types), known)
    connection.banner_timeout = connection.handshake_timeout = _left(deadline)
    done = threading.Event()
    try:
        connection.start_client(done)
        is_done = done.wait(_left(deadline))
    except RuntimeError as error:  # no thread is to be had
        raise CloudError(f"no thread can be started for a connection ({error})") from error
    if is_done and connection.is_active():
        return
    raise _failed_handshake(connection, hop, is_late=not is_done)


def _failed_handshake(connection: SshConnection, hop: SshTarget, *, is_late: bool) -> ReachError:
    """Name what the other end did instead."""
    wire, error = connection.wire, connection.get_exception()
    if not wire.is_ssh:
        if wire.said and not b"SSH-".startswith(bytes(wire.said[:4])) and wire.said[:4] != b"SSH-":
            return _error(
                LoginFault.NOT_SSH,
                f"{hop.place} says {_quote(bytes(wire.said))}",
                _LOOK.split(", ", 1)[1],
            )
        what = "no whole greeting" if wire.said else "no greeting"
        if is_late or isinstance(error, TimeoutError):
            return _error(
                LoginFault.SILENT,
                f"{hop.place} takes the connection but sends {what}: the machine hangs, or no SSH "
                "server listens there",
                "look at the machine's console, and check the address and the port",
            )
        return _error(
            LoginFault.NOT_SSH,
            f"{hop.place} closes the connection with {what}",
            f"{_LOOK}; try again",
        )
    if is_late:
        return _stopped(hop, "handshake")
    if wire.fault or isinstance(error, paramiko.SSHException):
        detail = wire.fault or explain(error or EOFError())
        return _error(
            LoginFault.NOT_SSH,
            f"{hop.place} greets as SSH and then breaks its rules: {detail}",
            _LOOK,
        )
    return _error(
        LoginFault.UNREACHABLE, f"{hop.place} closed the connection in the handshake", f"{_LOOK}"
    )


def _stopped(hop: SshTarget, where: str) -> ReachError:
    return _error(
        LoginFault.SILENT,
        f"{hop.place} stopped to answer in the middle of the {where}: the machine hangs, or is "
        "overloaded",
        "look at the machine's console",
    )


def _known_keys(hop: SshTarget) -> dict[str, paramiko.PKey]:
    """Return the host keys that a machine may have, by their types, the preferred first."""
    if hop.host_keys:
        return {key.get_name(): key for key in hop.host_keys}
    known: dict[str, paramiko.PKey] = {}
    for file in hop.known_hosts:
        keys = paramiko.HostKeys()
        try:
            keys.load(file)
        except OSError:
            continue
        except (paramiko.hostkeys.InvalidHostKey, ValueError) as error:
            raise CloudError(
                f"{file}: a line is no host key", f"mend it; ssh-keygen -l -f {file} shows where"
            ) from error
        known = {**dict(keys.lookup(hop.known_as) or {}), **known}
    return known


def _preferred(kinds: tuple[str, ...], known: dict[str, paramiko.PKey]) -> tuple[str, ...]:
    """Put the kinds of host key first that we can compare."""

    def is_known(kind: str) -> bool:
        return ("ssh-rsa" if kind.startswith("rsa-sha2-") else kind) in known

    return tuple(sorted(kinds, key=lambda kind: not is_known(kind)))


def _check_host_key(
    connection: SshConnection, hop: SshTarget, known: dict[str, paramiko.PKey]
) -> None:
    """Never accept a host key unseen."""
    key = connection.get_remote_server_key()
    expected = known.get(key.get_name())
    if expected == key:
        return
    if not known:
        raise _error(
            LoginFault.HOST_KEY_UNKNOWN,
            f"the host key {key.fingerprint} of {hop.place} is not known",
            f"run {hop.command} once and compare the fingerprint",
        )
    pinned = (expected or next(iter(known.values()))).fingerprint
    renew = "see who answers there"
    if not hop.host_keys:
        renew += f"; where it was made anew, ssh-keygen -R '{hop.known_as}' and then {hop.command}"
    raise _error(
        LoginFault.HOST_KEY_CHANGED,
        f"the host key of {hop.place} is {key.fingerprint}, not the pinned {pinned}: another "
        "machine answers",
        renew,
    )


def _authenticate(
    connection: SshConnection, hop: SshTarget, identities: Identities, deadline: float
) -> None:
    refused: list[str] = []
    for identity in identities.usable:
        connection.auth_timeout = _left(deadline)
        try:
            wanted = connection.auth_publickey(hop.user, identity.key)
        except (OSError, EOFError, paramiko.SSHException) as error:
            if time.monotonic() >= deadline:
                raise _stopped(hop, "login") from error
            if not connection.is_active() and not refused:
                detail = connection.wire.fault or "the connection was lost"
                raise _error(
                    LoginFault.UNREACHABLE, f"{detail} at {hop.place} in the login", _LOOK
                ) from error
            refused.append(identity.name)
            if not connection.is_active():  # so many attempts are enough for it
                break
        else:
            if not wanted:
                return
            raise _error(
                LoginFault.KEY_REFUSED,
                f"{hop.place} takes {identity.name} and wants {' or '.join(wanted)} besides",
                "let it take the key alone",
            )
    raise _refused(hop, refused, identities)


def _refused(hop: SshTarget, names: list[str], identities: Identities) -> CloudError:
    for cause in identities.unusable:
        if isinstance(cause, ReachError):  # the key that it would take may be the locked one
            return cause
    where = f"{hop.user}@{hop.place}"
    port = f"-p {hop.port} " if hop.port != 22 else ""
    files = [name for name in names if Path(name).exists()]
    key = f"-i {files[0]} " if files else ""
    advice = (
        "check auth.ssh_user, the image's login user, and the image"
        if hop.host_keys
        else f"run ssh-copy-id {key}{port}{hop.user}@{hop.called}, or check the user"
    )
    return _error(
        LoginFault.KEY_REFUSED, f"permission denied for {where} with {', '.join(names)}", advice
    )


def _quote(said: bytes) -> str:
    """Return the beginning of what a stranger says, harmless on a terminal."""
    line = next(iter(said.splitlines()), b"")
    return repr(line[:QUOTED])[1:] + ("..." if len(line) > QUOTED else "")


def explain(error: BaseException) -> str:
    """Say in words why a connection failed or ended."""
    match error:
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
    # a stranger's words may be in it
    words = re.sub(r"[^\x20-\x7e]", "?", " ".join(str(error).split()))
    return shorten(words, LONGEST) or type(error).__name__
