"""The page in a real browser: what it shows of a job that goes on while it is looked at."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hpcapp.dashboard.server import open_dashboard
from hpcapp.dashboard.watched_job import WatchedJob
from hpcapp.geometry.mesh import Mesh
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


def test_nothing_of_a_jobs_words_runs(page: Page, errors: list[str]) -> None:
    words = "'\"></script></title><script>ran=1</script><img src=x onerror=ran=1><!--<script>"
    timeline = Timeline()
    timeline.list_workers = lambda: [WorkerState(words, words, words)]
    job = WatchedJob(timeline, words)
    progress = Progress(job)
    with open_dashboard("127.0.0.1:0", job) as address, job.running():
        page.goto(address)
        for outcome in ("done", "lost", words):
            timeline.record(words, words, 0.0, outcome)
            timeline.record(words, MASTER, 0.0, outcome)
        progress.begin(words)
        progress.advance(1, 4)
        job.say(words)
        for place in ("h1", "#log", "#workers tbody", "#stages", "#stage-name", "#key"):
            page.locator(place, has_text=words).wait_for()
        assert page.evaluate("typeof ran") == "undefined"
        assert page.locator("img, [onerror]").count() == 0
    assert errors == []


def show_four_workers() -> WatchedJob:
    """Return a job with four workers, in the middle of its second stage."""
    seconds = [0.0]
    timeline = Timeline(lambda: seconds[-1])
    names = [f"machine-{number}" for number in range(4)]
    timeline.list_workers = lambda: [WorkerState(name, "busy", "mesh_tile") for name in names]
    job = WatchedJob(timeline, "/scans/of/the/old/town/hall/from/all/sides.laz → hall.ply")
    seconds.append(4.0)
    timeline.record("read", MASTER, 4.0)
    Progress(job).begin("extract")
    seconds.append(9.0)
    for name in names:
        timeline.record("mesh_tile", name, 5.0, bytes_in=123_456_789, bytes_out=98_765_432)
    return job


def test_before_the_first_part_the_page_says_so(page: Page, errors: list[str]) -> None:
    job = WatchedJob(Timeline(), "ball.ply → ball.glb")
    with open_dashboard("127.0.0.1:0", job) as address, job.running():
        page.goto(address)
        page.locator("#view canvas").wait_for()
        on_top = """() => { const box = document.getElementById('empty').getBoundingClientRect();
            return document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2).id; }"""
        assert page.evaluate(on_top) == "empty"
    assert errors == []


def test_four_workers_fit_a_desk_and_a_telephone(page: Page) -> None:
    job = show_four_workers()
    with open_dashboard("127.0.0.1:0", job) as address, job.running():
        page.set_viewport_size({"width": 1400, "height": 900})
        page.goto(address)
        page.locator("#workers tbody tr").nth(3).wait_for()
        for name in ("#view canvas", "#timeline", "#workers", "#tasks", "#bytes", "#log"):
            box = page.locator(name).bounding_box()
            assert box is not None, name
            assert box["y"] + box["height"] <= 900, name
            assert box["x"] + box["width"] <= 1400, name

        page.set_viewport_size({"width": 390, "height": 844})
        widest = "document.documentElement.scrollWidth"
        assert page.evaluate(widest) == 390
        beyond = """() => [...document.querySelectorAll('#workers td, #stages, #tasks, #bytes')]
            .filter((cell) => cell.getBoundingClientRect().right > 390
                || cell.scrollWidth > cell.clientWidth + 1).map((cell) => cell.outerHTML)"""
        assert page.evaluate(beyond) == []
        below = """() => document.querySelector('#bytes').getBoundingClientRect().bottom
            < document.querySelector('.lines').getBoundingClientRect().top"""
        assert page.evaluate(below)  # it was cut there


def test_no_stage_has_the_colour_of_a_task(page: Page) -> None:
    job = show_four_workers()
    with open_dashboard("127.0.0.1:0", job) as address, job.running():
        page.goto(address)
        page.locator("#workers tbody tr").nth(3).wait_for()
        # The bars of a row are most of its middle line, without their words and the grid.
        row = """(number) => {
            const canvas = document.getElementById('timeline'), scale = window.devicePixelRatio;
            const pen = canvas.getContext('2d');
            const line = pen.getImageData(0, (20 * number + 4) * scale, canvas.width, 1).data;
            const counts = {};
            for (let i = 0; i < line.length; i += 4) {
                if (line[i + 3] === 255) {
                    const colour = line.slice(i, i + 3).join();
                    counts[colour] = (counts[colour] ?? 0) + 1;
                }
            }
            return Object.keys(counts).filter((colour) => counts[colour] > 20);
        }"""
        stages, tasks = page.evaluate(row, 0), page.evaluate(row, 1)
        assert stages
        assert tasks
        assert not set(stages) & set(tasks)


def test_without_its_token_the_page_is_not_there(page: Page) -> None:
    job = WatchedJob(Timeline(), "ball.ply → ball.glb")
    with open_dashboard("127.0.0.1:0", job) as address:
        answer = page.goto(address.partition("?")[0])
        assert answer is not None
        assert answer.status == 403
