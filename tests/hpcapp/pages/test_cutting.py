"""Cutting by hand on a page: the command that it gives keeps what the page shows as kept."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import shapely

from hpcapp.cli import main
from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, read_points, write_mesh, write_points
from hpcapp.io.crs import Crs
from hpcapp.io.meshes.mesh_stream import as_stream

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

pytestmark = [
    pytest.mark.slow,
    pytest.mark.leaks_allowed,  # the browser stays for the module
]

ORIGIN = np.array([512_000.0, 5_403_000.0, 300.0])  # of a map: float32 has steps of 0.5 there
SIDES = (20.0, 4.0, 8.0, 1.0)  # of squares above each other, not in the order of their sizes
Spot = tuple[float, float]  # pixels of the window
Open = Callable[..., "Page"]


def write_squares(path: Path) -> None:
    """Write squares that begin at one corner of a map, each a unit above the one before."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    vertices = [[side, side, 1.0] * corners + [0, 0, k] for k, side in enumerate(SIDES)]
    faces = [np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(len(SIDES))]
    mesh = Mesh(np.concatenate(vertices), np.concatenate(faces), ORIGIN)
    write_mesh(path, replace(as_stream(mesh), crs=Crs("EPSG:32632", "m")))


def find_area(path: Path) -> float:
    mesh = read_mesh(path)
    return float(0.5 * np.linalg.norm(cross_edges(mesh.vertices[mesh.faces]), axis=1).sum())


def run(*words: str) -> None:
    """Run the program as it is typed."""
    with pytest.raises(SystemExit) as end:
        main(list(words))
    assert end.value.code == 0


@pytest.fixture
def view(browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Open]:
    """Return what opens the page of a file, on a desktop or a phone; it must not fail."""
    monkeypatch.chdir(tmp_path)
    contexts: list[BrowserContext] = []
    said: list[str] = []

    def open_page(file: str, *, is_phone: bool = False) -> Page:
        run("view", file, "-o", "page.html", "--no-open")
        context = browser.new_context(
            viewport={"width": 390, "height": 844} if is_phone else {"width": 900, "height": 600},
            has_touch=is_phone, is_mobile=is_phone, color_scheme="light",
        )  # fmt: skip
        contexts.append(context)
        context.grant_permissions(["clipboard-read", "clipboard-write"])
        page = context.new_page()
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_selector("body[data-state='ready']", timeout=120_000)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []


def drag(page: Page, begin: Spot, end: Spot, *, is_phone: bool) -> None:
    """Drag with a mouse, or with a finger."""
    middle = (0.5 * (begin[0] + end[0]), 0.5 * (begin[1] + end[1]))
    if not is_phone:
        page.mouse.move(*begin)
        page.mouse.down()
        page.mouse.move(*end, steps=3)
        page.mouse.up()
        return
    session = page.context.new_cdp_session(page)
    kinds = ("touchStart", "touchMove", "touchMove", "touchEnd")
    for kind, spots in zip(kinds, ([begin], [middle], [end], []), strict=True):
        touches = [{"x": x, "y": y} for x, y in spots]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})


def tap(page: Page, spot: Spot, *, is_phone: bool) -> None:
    (page.touchscreen.tap if is_phone else page.mouse.click)(*spot)


def find_handles(page: Page) -> list[Spot]:
    """Return where handles are: of a box, the faces in front of the corners, low ones first."""
    page.evaluate("viewer.draw()")
    boxes = [handle.bounding_box() for handle in page.locator(".handle").all()]
    return [(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2) for box in boxes if box]


def between(one: Spot, other: Spot, share: float) -> Spot:
    return (one[0] + share * (other[0] - one[0]), one[1] + share * (other[1] - one[1]))


def find_spot(page: Page, place: Sequence[float]) -> Spot:
    """Return where a place is seen, whose coordinates are without those of `ORIGIN`."""
    x, y = page.evaluate(
        """place => { const {origin} = JSON.parse(document.getElementById('scene').textContent);
            viewer.draw();
            const seen = viewer.camera.position.clone()
                .fromArray(place.map((part, k) => part - origin[k])).project(viewer.camera);
            const {width, height, left, top} =
                viewer.renderer.domElement.getBoundingClientRect();
            return [left + width * (0.5 + seen.x / 2), top + height * (0.5 - seen.y / 2)] }""",
        (place + ORIGIN).tolist(),
    )
    return x, y


def find_shade(page: Page, place: Sequence[float]) -> float:
    """Return how light it is around a place: what goes is pale."""
    shade: float = page.evaluate(
        """([x, y]) => { viewer.draw();
            const gl = viewer.renderer.getContext(), rgba = new Uint8Array(4 * 64);
            const {left, bottom} = viewer.renderer.domElement.getBoundingClientRect();
            const scale = viewer.renderer.getPixelRatio();
            gl.readPixels(scale * (x - left) - 4, scale * (bottom - y) - 4, 8, 8, gl.RGBA,
                gl.UNSIGNED_BYTE, rgba);
            return rgba.reduce((sum, part) => sum + part, 0) / 256 }""",
        list(find_spot(page, place)),
    )
    return shade


def copy_command(page: Page) -> list[str]:
    """Press the button that copies the command, and return its words."""
    page.click("#cut-copy")
    page.wait_for_function("document.querySelector('#cut-copied').textContent === 'copied'")
    copied: str = page.evaluate("navigator.clipboard.readText()")
    program, *words = shlex.split(copied)
    assert program == "hpcapp"
    return words


@pytest.mark.parametrize("is_phone", [False, True])
def test_a_box_that_is_dragged_keeps_its_points(view: Open, is_phone: bool) -> None:
    places = np.random.default_rng(3).uniform(-1.0, 1.0, (4000, 3)) * [30.0, 20.0, 10.0]
    write_points("my scan.ply", PointCloud(places, origin=ORIGIN), "EPSG:32632", "m")
    page = view("my scan.ply", is_phone=is_phone)
    page.select_option("#cut", "box")
    before = np.array(copy_command(page)[-1].split(","), float)
    assert (before[:3] < places.min(axis=0) + ORIGIN).all()  # nothing goes at first
    assert (before[3:] > places.max(axis=0) + ORIGIN).all()
    handles = find_handles(page)
    assert len(handles) == 14
    drag(page, handles[1], between(handles[1], handles[0], 0.25), is_phone=is_phone)
    handles = find_handles(page)
    drag(page, handles[7], between(handles[7], handles[12], 0.25), is_phone=is_phone)
    words = copy_command(page)
    assert words[:-1] == ["convert", "my scan.ply", "-o", "my scan-cut.ply", "--box"]
    corners = words[-1].split(",")
    box = np.array(corners, float)
    # A corner of the lowest x, the lowest y and the highest z, and before it the highest x.
    assert (box != before).tolist() == [True, True, False, True, False, True]
    assert box[3] - ORIGIN[0] == pytest.approx(15.6, abs=3.0)  # a quarter of the way
    assert max(len(one.partition(".")[2]) for one in corners) == 4  # 60 / 65535 is 0.0009
    run(*words)
    inside = ((places + ORIGIN >= box[:3]) & (places + ORIGIN <= box[3:])).all(axis=1)
    assert 400 < inside.sum() < 3600
    part = read_points("my scan-cut.ply")
    np.testing.assert_allclose(part.positions + part.origin, places[inside] + ORIGIN, atol=1e-6)
    page.select_option("#cut-into", label="mesh")
    run(*copy_command(page), "--plan")


@pytest.mark.parametrize("is_phone", [False, True])
def test_a_polygon_that_is_drawn_cuts_a_mesh(view: Open, tmp_path: Path, is_phone: bool) -> None:
    write_squares(Path("squares.ply"))
    page = view("squares.ply", is_phone=is_phone)
    page.select_option("#cut", "polygon")
    corners = [(9.0, 2.0, 0.0), (18.0, 3.0, 0.0), (17.0, 15.0, 0.0), (3.0, 12.0, 0.0)]
    for k in (0, 1, 3, 2):  # as an hourglass
        tap(page, find_spot(page, corners[k]), is_phone=is_phone)
    assert "cross" in page.inner_text("#cut-said")
    assert page.is_disabled("#cut-save")
    assert not page.is_visible("#cut-copy")
    for _ in range(2):
        page.click("#cut-undo")
    for k in (2, 3):
        tap(page, find_spot(page, corners[k]), is_phone=is_phone)
    drag(page, find_handles(page)[1], find_spot(page, (19.0, 1.0, 0.0)), is_phone=is_phone)
    corners[1] = (19.0, 1.0, 0.0)
    assert find_shade(page, (12.0, 8.0, 0.0)) < find_shade(page, (18.0, 18.0, 0.0)) - 20
    with page.expect_download() as download:
        page.click("#cut-save")
    words = copy_command(page)
    assert words[-2:] == ["--polygon", download.value.suggested_filename]
    download.value.save_as(tmp_path / words[-1])
    saved = json.loads((tmp_path / words[-1]).read_text())
    assert saved["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::32632"
    [ring] = saved["features"][0]["geometry"]["coordinates"]
    np.testing.assert_allclose(ring[:-1] - ORIGIN[:2], np.array(corners)[:, :2], atol=0.1)
    run(*words)
    drawn = shapely.transform(shapely.Polygon(ring), lambda places: places - ORIGIN[:2])
    kept = sum(drawn.intersection(shapely.box(0, 0, side, side)).area for side in SIDES)
    assert find_area(tmp_path / words[3]) == pytest.approx(kept, rel=1e-6)
    page.click("#reset")  # the polygon stays, seen from aside
    assert find_shade(page, (12.0, 8.0, 0.0)) < find_shade(page, (18.0, 18.0, 0.0)) - 20


def test_the_largest_pieces_are_kept(view: Open, tmp_path: Path) -> None:
    write_squares(Path("squares.ply"))
    page = view("squares.ply")
    page.select_option("#cut", "pieces")
    assert page.input_value("#cut-most") == "3"  # the smallest is small: 1 of 400
    assert "1 piece goes, 0.2 %" in page.inner_text("#cut-said")
    places = [(15.0, 15.0, 0.0), (3.0, 3.0, 1.0), (6.0, 6.0, 2.0)]
    before = [find_shade(page, place) for place in places]
    page.fill("#cut-most", "2")
    after = [find_shade(page, place) for place in places]
    assert after[0] == before[0]
    assert after[2] == before[2]
    run(*copy_command(page))
    assert find_area(tmp_path / "squares-cut.ply") == pytest.approx(400.0 + 64.0)
    page.fill("#cut-most", "5")
    assert "from 1 to 4" in page.inner_text("#cut-said")
    assert not page.is_visible("#cut-copy")
    page.select_option("#cut", "")
    assert not page.is_visible("#cut-said")


def test_heights_in_another_unit_are_measured(view: Open) -> None:
    """Metres, and heights in feet: both ends of an edge that rises by 10 ft over 4 m."""
    corners = np.array([[0.0, 0, 0], [4, 0, 10], [4, 4, 10], [0, 4, 0]])
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), ORIGIN)
    write_mesh("ramp.ply", replace(as_stream(mesh), crs=Crs("EPSG:32632", "m", "ft")))
    page = view("ramp.ply")
    page.click("#measure")
    tap(page, find_spot(page, (0.04, 2.0, 0.1)), is_phone=False)
    first = page.inner_text("#measured").split(". Pick")[0].split(", ")
    np.testing.assert_allclose(np.array(first, float) - ORIGIN, [0.04, 2.0, 0.1], atol=0.05)
    tap(page, find_spot(page, (3.96, 2.0, 9.9)), is_phone=False)
    said = page.inner_text("#measured")
    numbers = [float(said.split(f"{name} ")[1].split()[0]) for name in ("dx", "dy", "dz")]
    np.testing.assert_allclose(numbers, [3.92, 0.0, 9.8 * 0.3048], atol=0.06)
    assert said.split(" (")[0] == f"{np.hypot(numbers[0], numbers[2]):.2f} m"
