"""The dashboard as an ASGI application: whoever has the token reads, and nobody writes.

======================  ==========================================================
``/``                   the page
``/static/NAME``        its program and its style
``/events``             server-sent events: what is new, twice a second
``/parts/N``            a part of the mesh, see `parts.pack_part`
``/metrics``            for Prometheus
======================  ==========================================================
"""

from __future__ import annotations

import json
import logging
import secrets
from collections.abc import AsyncIterator
from importlib.resources import files
from urllib.parse import quote

import anyio
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hpcapp.dashboard.metrics import write_metrics
from hpcapp.dashboard.news import Reader
from hpcapp.dashboard.parts import pack_part
from hpcapp.dashboard.unauthenticated import UnauthenticatedConnections
from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.pages.templates import render
from hpccomponent.cli.terminal import visible_line

log = logging.getLogger(__name__)  # not the job's: the page shows that one

MOST_REQUESTS = 64
"""Of those who have the token, at once: an open page is one."""

LOOK_S = 0.5  # between two looks at the job, for each page
MOST_FACES = 600_000  # of all parts together
LEAST_FACES = 2_000  # of each part
STATIC = {
    "dashboard.js": ("hpcapp.dashboard", "text/javascript"),
    "dashboard.css": ("hpcapp.dashboard", "text/css"),
    "design.css": ("hpcapp.pages", "text/css"),
    "page.css": ("hpcapp.pages", "text/css"),
    "viewer.js": ("hpcapp.pages", "text/javascript"),
    "three/three.module.min.js": ("hpcapp.pages", "text/javascript"),
    "three/OrbitControls.js": ("hpcapp.pages", "text/javascript"),
}
IMPORTS = {
    "three": "three/three.module.min.js",
    "three/addons/controls/OrbitControls.js": "three/OrbitControls.js",
    "hpcapp/viewer.js": "viewer.js",
}
CLOSE = {"connection": "close"}
HEADERS = {
    b"cache-control": b"no-store",
    b"cross-origin-resource-policy": b"same-origin",
    b"referrer-policy": b"no-referrer",  # the token stands in the address
    b"x-content-type-options": b"nosniff",
    b"x-frame-options": b"DENY",
}


def make_app(job: WatchedJob, token: str, connections: UnauthenticatedConnections) -> ASGIApp:
    """Return the application that shows a job.

    Every request must name the token: ``?token=...``, or ``Authorization: Bearer ...``;
    `connections` are those that have not named it yet.
    """
    views = _Views(job, token)
    return Starlette(
        routes=[
            Route("/", views.page),
            Route("/static/{name:path}", views.static),
            Route("/events", views.events),
            Route("/parts/{number}", views.part),
            Route("/metrics", views.metrics),
        ],
        middleware=[Middleware(_Guard, token=token, connections=connections)],
    )


class _Guard:
    """Lets nobody in without the token, nor too many, and adds headers to every answer."""

    def __init__(self, app: ASGIApp, token: str, connections: UnauthenticatedConnections) -> None:
        self._app = app
        self._token = token.encode()
        self._connections = connections
        self._served = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *HEADERS.items()]
            await send(message)

        if not self._is_allowed(HTTPConnection(scope)):
            refusal = "this address lacks the token of the job\n"
            await PlainTextResponse(refusal, 403, CLOSE)(scope, receive, send_guarded)
            return
        self._connections.discard(scope["client"])
        if self._served >= MOST_REQUESTS:
            await PlainTextResponse("come later\n", 503, CLOSE)(scope, receive, send_guarded)
            return
        self._served += 1
        try:
            await self._app(scope, receive, send_guarded)
        finally:
            self._served -= 1

    def _is_allowed(self, request: HTTPConnection) -> bool:
        kind, _, bearer = request.headers.get("authorization", "").partition(" ")
        given = bearer if kind.lower() == "bearer" else request.query_params.get("token", "")
        return secrets.compare_digest(given.encode(), self._token)


class _Views:
    """What is answered to each address."""

    def __init__(self, job: WatchedJob, token: str) -> None:
        self._job = job
        self._token = token
        self._packing = anyio.CapacityLimiter(1)  # one core at most, whoever asks
        self._packed: dict[int, bytes] = {}

    async def page(self, _request: Request) -> Response:
        """Return the page, whose addresses have the token."""
        nonce = secrets.token_urlsafe(16)
        imports = {name: "./" + self._address(file) for name, file in IMPORTS.items()}
        page = render(
            "dashboard.html",
            title=visible_line(self._job.title),
            nonce=nonce,
            page=self._job.viewers.arrive(),
            imports={"imports": imports},
            program=self._address("dashboard.js"),
            styles=[self._address(name) for name in ("design.css", "page.css", "dashboard.css")],
        )
        policy = (
            f"default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self'; "
            "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'"
        )
        return Response(page, media_type="text/html", headers={"content-security-policy": policy})

    async def static(self, request: Request) -> Response:
        """Return a file of the page."""
        name = request.path_params["name"]
        if name not in STATIC:
            return PlainTextResponse("there is no such file\n", 404)
        package, kind = STATIC[name]
        return Response(_read(package, name), media_type=kind)

    async def events(self, request: Request) -> Response:
        """Tell what is new, as long as the job runs; a page that reads slowly is told later."""
        return StreamingResponse(self._tell(_name(request)), media_type="text/event-stream")

    async def _tell(self, page: str) -> AsyncIterator[str]:
        viewers, reader = self._job.viewers, Reader(self._job)
        viewers.attend(page)
        try:
            while True:
                is_over = self._job.state != "running"  # before the last look, which sees all
                news = reader.look()
                yield f"data: {json.dumps(news)}\n\n"
                if news["more"]:
                    continue
                if is_over:
                    viewers.tell_end(page)
                    return
                await anyio.sleep(LOOK_S)
        finally:
            viewers.leave(page)

    async def part(self, request: Request) -> Response:
        """Return a part of the mesh, which is packed when the first page asks for it."""
        number = _read_number(request.path_params["number"])
        if number is None or number >= len(self._job.loads):
            return PlainTextResponse("there is no such part\n", 404)
        try:
            return await self._send_part(number)
        finally:
            self._job.viewers.fetch(_name(request), number)

    async def _send_part(self, number: int) -> Response:
        try:
            packed = await anyio.to_thread.run_sync(self._pack, number, limiter=self._packing)
        except Exception as error:  # kept parts go with the job; the job itself has no part in it
            log.debug("part %d cannot be shown", number, exc_info=error)
            return PlainTextResponse("this part is gone\n", 410)
        return Response(packed, media_type="application/octet-stream")

    def _pack(self, number: int) -> bytes:
        if number not in self._packed:
            stage = self._job.stage
            parts = max(stage.total if stage else 1, len(self._job.loads))
            most = max(LEAST_FACES, MOST_FACES // parts)
            self._packed[number] = pack_part(self._job.loads[number](), most)
        return self._packed[number]

    async def metrics(self, _request: Request) -> Response:
        """Return the metrics."""
        return Response(write_metrics(self._job), headers={"content-type": CONTENT_TYPE_LATEST})

    def _address(self, name: str) -> str:
        return f"static/{name}?token={quote(self._token)}"


def _name(request: Request) -> str:
    """Return the name of the page that asks."""
    return request.query_params.get("page", "")


def _read_number(text: str) -> int | None:
    """Return the number of a part; None where it is none, or has more digits than any."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else None


def _read(package: str, name: str) -> bytes:
    return files(package).joinpath("static", *name.split("/")).read_bytes()
