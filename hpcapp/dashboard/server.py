"""The dashboard's server: a thread beside the job, on loopback unless the user says otherwise."""

from __future__ import annotations

import ipaddress
import logging
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, cast

from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.extras import how_to_install
from hpccomponent.errors import MissingLibraryError, UsageError

if TYPE_CHECKING:
    import asyncio

    import uvicorn


log = logging.getLogger("hpcapp")

BACKLOG = 64  # connections that are taken in at once
FAREWELL_S = 2  # for pages to read the end
LEAVE_S = 5.0


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of ``HOST:PORT``; port 0 is any free one. UsageError where it is none.

    Examples
    --------
    >>> parse_address("[::1]:8080")
    ('::1', 8080)
    """
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"--dashboard {text!r} is not HOST:PORT",
            "write --dashboard 127.0.0.1:8080, or --dashboard alone behind the other arguments",
        )
    return host.strip("[]"), int(port)


@contextmanager
def open_dashboard(address: str, job: WatchedJob) -> Iterator[str]:
    """Serve the page of a job while the block runs, and until open pages know how it has ended.

    Yield its address, which holds a random token. Raise UsageError where nothing can listen there,
    or the libraries are not installed.
    """
    host, port = parse_address(address)
    token = secrets.token_urlsafe(24)
    server = _make_server(job, token)
    listener = _listen(host, port)
    thread = threading.Thread(target=_serve, args=(server, listener), name="dashboard", daemon=True)
    thread.start()
    shown = f"[{host}]" if ":" in host else host
    try:
        yield f"http://{shown}:{listener.getsockname()[1]}/?token={token}"
    finally:
        if thread.is_alive():
            job.viewers.wait(len(job.loads), is_over=True)
        server.should_exit = True
        thread.join(FAREWELL_S + LEAVE_S)
        listener.close()


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family)
    except (OSError, UnicodeError) as error:
        raise UsageError(
            f"--dashboard {host}:{port}: nothing can listen there "
            f"({getattr(error, 'strerror', None) or error})",
            "give another address; port 0 is any free one",
        ) from error
    if not ipaddress.ip_address(listener.getsockname()[0]).is_loopback:
        log.warning(
            "warning: the dashboard listens on %s without encryption: whoever reads the traffic "
            "reads the token", host,
        )  # fmt: skip
    return listener


def _make_server(job: WatchedJob, token: str) -> uvicorn.Server:
    try:
        import uvicorn

        from hpcapp.dashboard.app import make_app
        from hpcapp.dashboard.unauthenticated import TrackedProtocol, UnauthenticatedConnections
    except ImportError as error:
        raise MissingLibraryError(
            f"the dashboard is not installed here ({error})", how_to_install("dashboard")
        ) from None
    connections = UnauthenticatedConnections()
    config = uvicorn.Config(
        make_app(job, token, connections),
        loop="asyncio",
        http=cast("type[asyncio.Protocol]", partial(TrackedProtocol, connections)),  # it is called
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="critical",
        access_log=False,  # addresses hold the token
        server_header=False,
        proxy_headers=False,  # a connection is known by its own address
        backlog=BACKLOG,
        timeout_graceful_shutdown=FAREWELL_S,
    )
    return uvicorn.Server(config)


def _serve(server: uvicorn.Server, listener: socket.socket) -> None:
    """Serve until it is told to end; whatever goes wrong, the job goes on."""
    try:
        server.run(sockets=[listener])
    except Exception as error:
        log.warning("the dashboard has ended: %s; the job goes on", error)
