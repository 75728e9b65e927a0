"""The page in a real browser: what it shows of a job that goes on while it is looked at."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.dashboard.server import open_dashboard
from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.progress import Progress
from hpcapp.timeline import MASTER, Timeline, WorkerState

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--no-first-run",
]  # fmt: skip

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine"),
]


@pytest.fixture
def errors() -> list[str]:
    """What goes wrong on the page."""
    return []


@pytest.fixture
def page(errors: list[str]) -> Iterator[Page]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        page.set_default_timeout(120_000)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.extend([said.text] * (said.type == "error")))
        yield page
        browser.close()


def half_ball(side: float) -> Mesh:
    """Return the part of a ball that lies on one side, of so many triangles that one sees it."""
    u, v = np.meshgrid(np.linspace(0.0, np.pi, 13), np.linspace(0.0, np.pi, 13), indexing="ij")
    places = np.stack([np.cos(u), np.sin(u) * np.cos(v), side * np.sin(u) * np.sin(v)], axis=-1)
    rows = np.arange(169).reshape(13, 13)
    a, b, c, d = rows[:-1, :-1], rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return Mesh(places.reshape(-1, 3), faces, np.zeros(3))


def test_a_page_follows_its_job_to_the_end(page: Page, errors: list[str]) -> None:
    timeline = Timeline()
    timeline.list_workers = lambda: [WorkerState("machine-0", "busy", "mesh_tile")]
    job = WatchedJob(timeline, "ball.ply → ball.glb")
    progress = Progress(job)
    with open_dashboard("127.0.0.1:0", job) as address, job.running():
        page.goto(address)
        page.wait_for_selector("#state.running")
        timeline.record("read", MASTER, 0.0)
        timeline.record("mesh_tile", "machine-0", 0.0, bytes_in=2_500_000, bytes_out=9)
        timeline.record("mesh_tile", "machine-1", 0.0, "lost")
        progress.begin("extract")
        progress.advance(1, 4)
        progress.show_part(lambda: half_ball(1.0))
        job.say("warning: <b>few</b> points")
        page.locator("#drawn", has_text="1 part").wait_for()
        assert "1 of 4" in page.inner_text("#stage-rate")
        assert page.locator("#workers tbody tr").count() == 2
        assert "2.5 MB" in page.inner_text("#workers tbody tr:first-child")
        assert "read" in page.inner_text("#stages")
        assert "<b>few</b>" in page.inner_text("#log")  # as text, not as HTML

        progress.show_part(lambda: half_ball(-1.0))
        page.locator("#drawn", has_text="2 part").wait_for()
        coloured = page.locator("#view canvas").screenshot()
        page.uncheck("#by-part")
        page.check("#wireframe")
        assert page.locator("#view canvas").screenshot() != coloured
        page.click("#reset")
    page.wait_for_selector("#state.done")
    assert errors == []


def test_a_job_of_a_moment_is_shown_whole(page: Page, errors: list[str]) -> None:
    job = WatchedJob(Timeline(), "ball.ply → ball.glb")
    progress = Progress(job)
    kept = {part: half_ball(1.0 - part / 4) for part in range(8)}
    with open_dashboard("127.0.0.1:0", job) as address, job.running():
        page.goto(address, wait_until="commit")  # it has asked for nothing but itself yet
        for part in kept:
            progress.show_part(lambda part=part: kept[part])  # type: ignore[misc]
        progress.wait_for_viewers()
        kept.clear()
        job.say("ball.glb: watertight")
    page.wait_for_selector("#state.done")
    page.locator("#drawn", has_text="8 parts").wait_for()
    assert "ball.glb: watertight" in page.inner_text("#log")
    assert errors == []


def test_without_its_token_the_page_is_not_there(page: Page) -> None:
    job = WatchedJob(Timeline(), "ball.ply → ball.glb")
    with open_dashboard("127.0.0.1:0", job) as address:
        answer = page.goto(address.partition("?")[0])
        assert answer is not None
        assert answer.status == 403
