"""The dashboard over real sockets: the token, what is told, and that the job is never in danger."""

from __future__ import annotations

import json
import logging
import socket
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from hpcapp.dashboard.app import MOST_REQUESTS
from hpcapp.dashboard.server import open_dashboard, parse_address
from hpcapp.dashboard.unauthenticated import MOST_UNAUTHENTICATED
from hpcapp.dashboard.viewers import Viewers
from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.geometry.mesh import Mesh
from hpcapp.progress import Progress
from hpcapp.timeline import MASTER, Timeline, WorkerState
from hpccomponent.errors import UsageError

LOOPBACK = "127.0.0.1:0"
TETRAHEDRON = Mesh(
    np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    np.zeros(3),
)


@pytest.fixture
def job() -> WatchedJob:
    timeline = Timeline()
    timeline.record("mesh_tile", 'w-1"', 0.0, bytes_in=7, bytes_out=9)
    timeline.record("mesh_tile", "w-2", 0.0, "lost")
    timeline.record("read", MASTER, 0.0)
    timeline.list_workers = lambda: [WorkerState("w-2", "busy", "mesh_tile")]
    return watched(timeline, "scan.ply → <mesh>.ply")


def watched(timeline: Timeline, title: str) -> WatchedJob:
    """Return a job whose end waits for no page: none of these tests looks on."""
    job = WatchedJob(timeline, title)
    job.viewers = Viewers(patience_s=0.0)
    return job


@pytest.fixture
def address(job: WatchedJob) -> Iterator[str]:
    with open_dashboard(LOOPBACK, job) as address:
        yield address


def test_a_job_s_files_may_have_any_names() -> None:
    job = watched(Timeline(), "scan\udcff\u202e.ply")
    with open_dashboard(LOOPBACK, job) as address:
        status, page, _ = get(address)
    assert status == 200
    assert rb"scan\xff\u202e.ply" in page


def path_of(address: str, path: str) -> str:
    return address.replace("/?", f"/{path}?")


def get(address: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
    request = urllib.request.Request(address, headers=headers)  # noqa: S310 - http, loopback
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:  # noqa: S310 - likewise
            return answer.status, answer.read(), dict(answer.headers)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read(), dict(error.headers)


def first_news(address: str) -> dict[str, Any]:
    """Return the first event that a page is told."""
    with urllib.request.urlopen(path_of(address, "events"), timeout=30) as answer:  # noqa: S310
        line: bytes = answer.readline()
    news: dict[str, Any] = json.loads(line.removeprefix(b"data: "))
    return news


@pytest.mark.parametrize("path", ["", "events", "metrics", "parts/0", "static/dashboard.js", "x"])
def test_nothing_is_told_without_the_token(address: str, path: str) -> None:
    bare = path_of(address, path).partition("?")[0]
    for wrong in (bare, f"{bare}?token=", f"{bare}?token=ä", f"{bare}?token=abc"):
        status, body, _ = get(urllib.parse.quote(wrong, safe=":/?=%"))
        assert status == 403
        assert b"w-1" not in body
        assert b"scan" not in body
    assert get(bare, Authorization="Bearer nonsense")[0] == 403


def test_prometheus_reads_with_a_bearer_token(address: str) -> None:
    token = address.partition("token=")[2]
    bare = path_of(address, "metrics").partition("?")[0]
    status, body, headers = get(bare, Authorization=f"Bearer {token}")
    assert status == 200
    assert headers["content-type"].startswith("text/plain; version=")
    lines = body.decode().splitlines()
    label = 'outcome="done",task="mesh_tile",worker="w-1\\""'
    assert f"hpcapp_tasks_total{{{label}}} 1.0" in [_sorted_labels(line) for line in lines]
    assert 'hpcapp_workers{state="busy"} 1.0' in lines
    assert 'hpcapp_job_state{state="running"} 1.0' in lines
    assert 'hpcapp_worker_sent_bytes_total{worker="w-2"} 0.0' in lines


def _sorted_labels(line: str) -> str:
    name, brace, rest = line.partition("{")
    labels, _, value = rest.rpartition("}")
    return f"{name}{{{','.join(sorted(labels.split(',')))}}}{value}" if brace else line


def test_the_page_and_all_that_it_loads_come_with_the_token(address: str) -> None:
    status, body, headers = get(address)
    page = body.decode()
    assert status == 200
    assert "scan.ply → &lt;mesh&gt;.ply" in page
    assert headers["referrer-policy"] == "no-referrer"
    assert "default-src 'none'" in headers["content-security-policy"]
    token = address.partition("?")[2]
    for name in ("dashboard.js", "viewer.js", "three/OrbitControls.js", "page.css"):
        assert f"static/{name}?{token}" in page
        assert get(path_of(address, f"static/{name}"))[0] == 200
    assert get(path_of(address, "static/../server.py"))[0] == 404


def test_news_are_all_that_there_is_and_then_what_is_new(job: WatchedJob, address: str) -> None:
    progress = Progress(job)
    progress.begin("extract")
    progress.advance(3, 8)
    with job.running():
        logging.getLogger("hpcapp").warning("warning: %s", "few points")
        news = first_news(address)
    assert news["first"]
    assert news["stage"][:3] == ["extract", 3, 8]
    assert [span[1] for span in news["spans"]] == ['w-1"', "w-2", MASTER]
    assert news["lines"] == ["warning: few points"]
    assert news["workers"] == [["w-2", "busy", "mesh_tile"]]


def test_events_end_with_the_job(job: WatchedJob, address: str) -> None:
    with urllib.request.urlopen(path_of(address, "events"), timeout=30) as answer:  # noqa: S310
        assert json.loads(answer.readline().removeprefix(b"data: "))["state"] == "running"
        with job.running():
            pass
        last = answer.read().split(b"data: ")[-1]
    assert json.loads(last)["state"] == "done"


def test_a_part_comes_small(job: WatchedJob, address: str) -> None:
    Progress(job).show_part(lambda: TETRAHEDRON)
    status, body, _ = get(path_of(address, "parts/0"))
    assert status == 200
    step, *low = np.frombuffer(body, "<f8", 4)
    count, faces = np.frombuffer(body, "<u4", 2, 32)
    places = np.frombuffer(body, "<u2", 3 * count, 40).reshape(-1, 3)
    corners = np.frombuffer(body, "<u4", 3 * faces, 40 + 24).reshape(-1, 3)
    assert (len(body), count, faces) == (40 + 24 + 48, 4, 4)
    np.testing.assert_allclose(places * step + low, TETRAHEDRON.vertices, atol=2.0 / 65535)
    np.testing.assert_array_equal(corners, TETRAHEDRON.faces)
    assert get(path_of(address, "parts/1"))[0] == 404


def test_a_part_that_is_gone_is_told(job: WatchedJob, address: str) -> None:
    def load() -> Mesh:
        raise FileNotFoundError("swept")

    Progress(job).show_part(load)
    assert get(path_of(address, "parts/0"))[0] == 410


def test_clients_that_never_read_or_vanish_cost_nothing(job: WatchedJob) -> None:
    parts = urlsplit("")
    clients = []
    with open_dashboard(LOOPBACK, job) as address:
        parts = urlsplit(path_of(address, "events"))
        for _ in range(4):
            client = socket.create_connection((parts.hostname or "", parts.port or 0))
            client.sendall(f"GET {parts.path}?{parts.query} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
            clients.append(client)
        clients[0].close()
        for _ in range(20_000):
            job.timeline.record("mesh_tile", "w-1", 0.0)
        assert get(path_of(address, "metrics"))[0] == 200
    for client in clients:  # the server has gone, whatever they do
        client.close()


def test_more_clients_than_it_serves_are_told_to_come_later(address: str) -> None:
    parts = urlsplit(path_of(address, "events"))
    ask = f"GET {parts.path}?{parts.query} HTTP/1.1\r\nHost: x\r\n\r\n".encode()
    clients, answers = [], []
    for _ in range(MOST_REQUESTS + 1):
        client = socket.create_connection((parts.hostname or "", parts.port or 0), timeout=30)
        client.sendall(ask)
        answers.append(client.recv(12))
        clients.append(client)
    for client in clients:
        client.close()
    assert answers[0] == b"HTTP/1.1 200"
    assert answers[-1] == b"HTTP/1.1 503"


@pytest.fixture
def connect(address: str) -> Iterator[Callable[[], socket.socket]]:
    """Connect to the dashboard, and say nothing."""
    parts, clients = urlsplit(address), []

    def connect() -> socket.socket:
        client = socket.create_connection((parts.hostname or "", parts.port or 0), timeout=30)
        clients.append(client)
        return client

    yield connect
    for client in clients:
        client.close()


def test_whoever_has_the_token_is_served_beside_any_number_of_idle_connections(
    address: str, connect: Callable[[], socket.socket]
) -> None:
    with urllib.request.urlopen(path_of(address, "events"), timeout=30) as watched:  # noqa: S310
        idle = []
        for _ in range(3 * MOST_UNAUTHENTICATED // 32):
            idle += [connect() for _ in range(32)]  # the backlog holds more
            assert get(path_of(address, "metrics"))[0] == 200
        assert watched.readline().startswith(b"data: ")
    for client in idle[:MOST_UNAUTHENTICATED]:  # the first have made room for the last
        assert is_ended(client)


def is_ended(client: socket.socket) -> bool:
    """Wait until a connection is ended by the server; without a byte."""
    try:
        return client.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.mark.slow
def test_a_stranger_is_not_waited_for_long(connect: Callable[[], socket.socket]) -> None:
    silent, slow = connect(), connect()
    slow.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n")
    assert is_ended(silent)
    assert is_ended(slow)


def test_who_lacks_the_token_is_told_so_and_left(connect: Callable[[], socket.socket]) -> None:
    client = connect()
    client.sendall(2 * b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    with client.makefile("rb") as answer:
        assert answer.read().count(b"HTTP/1.1 403") == 1


ODD = ["0" * 5000, "9" * 5000, "-1", "+0", "0x0", "%00", "%ff", "%D9%A0", "1e3", " 0", "..%2f0"]


@pytest.mark.parametrize(
    "path", [f"{folder}/{name}" for folder in ("parts", "static") for name in ODD]
)
def test_an_odd_path_is_not_found(job: WatchedJob, address: str, path: str) -> None:
    Progress(job).show_part(lambda: TETRAHEDRON)
    assert get(path_of(address, path.replace(" ", "%20")))[0] == 404


@pytest.mark.parametrize(
    "header",
    [
        "Authorization: Bearer \xff\xfe", "Authorization: " + "x" * 60_000, "Content-Length: -1",
        "Content-Length: " + "9" * 5000, "Transfer-Encoding: junk", "Upgrade: websocket",
        "Range: bytes=9-0", "Accept: \x80", "Host: " + "a" * 60_000, "If-Modified-Since: never",
    ],
)  # fmt: skip
@pytest.mark.parametrize("path", ["/", "/metrics", "/parts/0", "/static/page.css"])
def test_an_odd_header_is_no_error_of_the_server(
    address: str, connect: Callable[[], socket.socket], path: str, header: str
) -> None:
    client, token = connect(), address.partition("?")[2]
    request = f"GET {path}?{token}&page=%00%ff HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{header}"
    client.sendall(f"{request}\r\n\r\n".encode("latin-1"))
    with client.makefile("rb") as answer:
        assert answer.read(10) in (b"HTTP/1.1 2", b"HTTP/1.1 4")


@pytest.mark.parametrize("text", ["", "8080", ":8080", "localhost", "h:x", "127.0.0.1:70000"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="HOST:PORT"):
        parse_address(text)


def test_a_port_that_is_taken_is_told(job: WatchedJob) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UsageError, match="nothing can listen"), open_dashboard(address, job):
            raise AssertionError("the block must not run")


def test_another_address_than_loopback_is_warned_of(
    job: WatchedJob, caplog: pytest.LogCaptureFixture
) -> None:
    with open_dashboard("0.0.0.0:0", job):
        pass
    assert "without encryption" in caplog.text
