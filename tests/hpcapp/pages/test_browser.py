"""Pages in a browser: nothing is loaded, the mesh is drawn, and each control does what it says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hpcapp.api.mesh import wrap_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.pages.job import describe_job
from hpcapp.pages.page import build_page
from hpcapp.pages.scene import Field, Marker, Scene, Tint, fields_of, label_field

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [
    pytest.mark.slow,
    pytest.mark.leaks_allowed,  # the browser stays for the module
]

_PIXELS = """() => {
  viewer.draw();
  const gl = viewer.renderer.getContext(), {width, height} = gl.canvas;
  const rgba = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, rgba);
  const found = {drawn: 0, red: 0, back: 0, sum: [0, 0, 0], left: 0, hash: 0};
  for (let i = 0; i < rgba.length; i += 4) {
    const [r, g, b] = rgba.subarray(i, i + 3);
    if (r > 250 && g > 250 && b > 250) continue;
    found.drawn += 1;
    if (r > 1.8 * b && r > 1.8 * g) found.red += 1;
    if (r > 1.15 * b && r < 1.5 * b && g > 0.75 * r) found.back += 1;
    [r, g, b].forEach((part, k) => { found.sum[k] += part; });
    if ((i / 4) % width < width / 2) found.left += 1;
    found.hash = (31 * found.hash + r + 3 * g + 7 * b + i) % 1000000007;
  }
  return found;
}"""

Open = Callable[[str], "Page"]


def make_cube() -> Mesh:
    """Return a cube of side 2 around the origin, each side cut into small squares."""
    steps = np.linspace(-1.0, 1.0, 9)
    corners = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    squares = np.array([[9 * i + j for j in range(8)] for i in range(8)]).ravel()
    faces = np.concatenate([
        np.stack([squares, squares + 9, squares + 10], axis=1),
        np.stack([squares, squares + 10, squares + 1], axis=1),
    ])  # fmt: skip
    vertices: list[FloatArray] = []
    sides: list[IntArray] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            side = np.empty((81, 3))
            side[:, axis] = sign
            side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = corners.T
            sides.append((faces if sign > 0 else faces[:, ::-1]) + 81 * len(vertices))
            vertices.append(side)
    return Mesh(np.concatenate(vertices), np.concatenate(sides))


@pytest.fixture
def open_page(browser: Browser, tmp_path: Path) -> Iterator[Open]:
    """Return what opens a page, and fail where that says or loads anything."""
    said: list[str] = []
    page = browser.new_page(viewport={"width": 900, "height": 500}, color_scheme="light")
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    own = ("file:", "blob:", "data:", "about:")
    page.on("request", lambda one: None if one.url.startswith(own) else said.append(one.url))

    def show(content: str) -> Page:
        (tmp_path / "page.html").write_text(content)
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_selector("body[data-state='ready']", timeout=120_000)
        return page

    yield show
    page.close()
    # What the driver of the software renderer says of our reading pixels is none of the page.
    assert [line for line in said if "ReadPixels" not in line] == []


@pytest.fixture
def cube(open_page: Open) -> Page:
    mesh = make_cube()
    distance = Field("distance", "Distance", np.linalg.norm(mesh.vertices, axis=1), "m", 1.0, 1.66)
    tile = label_field("tile", "Tile", (mesh.vertices[:, 0] > 0).astype(int), "tile")
    markers = [Marker(np.array([0.0, -1.0, 0.0]), "a hole"), Marker(np.ones(3), "a corner")]
    points = PointCloud(1.2 * mesh.vertices)
    report = {"summary": "a cube", "warnings": [], "stages": {"read": 1.0}}
    sections = describe_job(report, [one.text for one in markers])
    height = Field("height", "Height", mesh.vertices[:, 2], "m", is_signed=True)
    scene = Scene(
        mesh, [distance, tile, height], points, markers, unit="m",
        tint=Tint("distance", 1.6, "guesswork: corners"),
    )  # fmt: skip
    return open_page(build_page("Cube", "a cube", scene, sections))


def pixels(page: Page) -> dict[str, Any]:
    found: dict[str, Any] = page.evaluate(_PIXELS)
    return found


def test_a_mesh_is_drawn_in_the_middle(cube: Page) -> None:
    found = pixels(cube)
    size = cube.evaluate("viewer.renderer.domElement.width * viewer.renderer.domElement.height")
    assert 0.1 * size < found["drawn"] < 0.7 * size
    assert found["left"] / found["drawn"] == pytest.approx(0.5, abs=0.1)
    assert found["back"] == 0  # no back face is seen of a closed mesh


def test_a_page_draws_its_first_frame_when_all_is_there(cube: Page) -> None:
    cube.wait_for_function("viewer.frames > 0")
    assert cube.evaluate("viewer.frames") == 1


def test_no_empty_frame_is_shown_when_the_page_gets_another_size(cube: Page) -> None:
    resized = _PIXELS.replace(
        "viewer.draw()", "viewer.element.style.height = '300px', viewer.resize()"
    )
    assert resized != _PIXELS
    found: dict[str, Any] = cube.evaluate(resized)
    assert cube.evaluate("viewer.renderer.domElement.clientHeight") == 300
    all_pixels = cube.evaluate("viewer.element.clientWidth * 300")
    assert 1000 < found["drawn"] < 0.9 * all_pixels, "an empty canvas is black"


def test_what_is_drawn_is_where_it_was_put(cube: Page) -> None:
    box = cube.evaluate("[viewer.box.min.toArray(), viewer.box.max.toArray()]")
    assert np.abs(np.array(box) - [[-1.2] * 3, [1.2] * 3]).max() < 1e-3  # the points are outside
    normal = cube.evaluate("Array.from(viewer.normal(viewer.meshes[0], 40))")
    assert normal == [-127, 0, 0]


def test_the_mesh_and_the_points_can_be_hidden(cube: Page) -> None:
    mesh_only = pixels(cube)["drawn"]
    cube.check("#show-points")
    assert pixels(cube)["drawn"] > mesh_only
    cube.uncheck("#show-mesh")
    points_only = pixels(cube)
    assert 0 < points_only["drawn"] < mesh_only
    cube.fill("#point-size", "8")
    assert pixels(cube)["drawn"] > 2 * points_only["drawn"]
    cube.uncheck("#show-points")
    assert pixels(cube)["drawn"] == 0


def test_a_wireframe_has_holes(cube: Page) -> None:
    whole = pixels(cube)["drawn"]
    cube.check("#wireframe")
    assert 0 < pixels(cube)["drawn"] < 0.8 * whole
    cube.uncheck("#wireframe")
    assert pixels(cube)["drawn"] == whole


def test_every_colouring_has_its_colours_and_its_legend(cube: Page) -> None:
    cube.uncheck("#tint")
    seen = {pixels(cube)["hash"]}
    legends = {"normals": "+x+y+z", "tile": "tile 0tile 1",
               "distance": "1 1.2 1.4 1.6 in m; ends at 1.66, the largest is 1.73"}  # fmt: skip
    for name, legend in legends.items():
        cube.select_option("#colouring", name)
        cube.wait_for_function("text => document.querySelector('#legend').innerText.replace("
                               "/\\s/g, '') === text.replace(/\\s/g, '')", arg=legend)  # fmt: skip
        seen.add(pixels(cube)["hash"])
    assert len(seen) == 4
    cube.select_option("#colouring", "plain")
    cube.wait_for_function("document.querySelector('#legend').innerText === ''")
    assert pixels(cube)["hash"] in seen


def test_guesswork_is_tinted_in_every_colouring(cube: Page) -> None:
    tinted = """() => { const {array, count} = viewer.meshes[0].geometry.attributes.color.data;
        return Array.from({length: count}, (_, i) => [...array.slice(4 * i, 4 * i + 3)]) }"""
    corners = np.linalg.norm(make_cube().vertices, axis=1) > 1.6
    for name in ("plain", "distance", "tile", "height"):
        cube.select_option("#colouring", name)
        cube.wait_for_selector(f"#legend[data-field='{name}']")
        with_tint = np.array(cube.evaluate(tinted))
        cube.uncheck("#tint")
        cube.wait_for_function("!document.querySelector('#legend').innerText.includes('guess')")
        without = np.array(cube.evaluate(tinted))
        np.testing.assert_array_equal((with_tint != without).any(axis=1), corners)
        cube.check("#tint")


def test_a_scale_ends_where_the_slider_says(cube: Page) -> None:
    cube.select_option("#colouring", "height")
    ticks = "[...document.querySelectorAll('.ticks span')].map((one) => one.innerText)"
    cube.wait_for_function(f"{ticks}.join() === '-1,-0.5,0,0.5,1'")
    assert cube.locator(".bars u").count() == 48
    colour = """z => { const {geometry} = viewer.meshes[0];
        const {array} = geometry.attributes.color.data;
        const i = [...Array(geometry.attributes.position.count).keys()].find((n) =>
            Math.abs(geometry.attributes.position.getZ(n) - z) < 1e-4);
        return [...array.slice(4 * i, 4 * i + 3)] }"""
    quarter = cube.evaluate(colour, 0.625)  # a quarter of the cube's side above its middle
    cube.fill("#scale-end", "0.8")
    cube.wait_for_function(f"{ticks}.includes('0.2')")
    redder = cube.evaluate(colour, 0.625)
    assert redder[1] < quarter[1]
    assert "the largest is 1.00" in cube.inner_text("#legend")
    cube.click("#scale-reset")
    cube.wait_for_function(f"{ticks}.includes('1')")
    assert cube.evaluate(colour, 0.625) == quarter


def test_two_places_are_measured(cube: Page) -> None:
    at = """place => { const seen = viewer.camera.position.clone().fromArray(place)
        .project(viewer.camera), {width, height, left, top} =
            viewer.renderer.domElement.getBoundingClientRect();
        return [left + width * (0.5 + seen.x / 2), top + height * (0.5 - seen.y / 2)] }"""
    cube.click("#measure")
    for place in ([0.5, -1.0, 0.25], [-0.5, -1.0, 0.25]):
        x, y = cube.evaluate(at, place)
        cube.mouse.click(x, y)
    length, unit, *_ = cube.inner_text("#measured").split()
    assert float(length) == pytest.approx(1.0, abs=0.02)
    assert unit == "m"
    assert cube.locator(".length").inner_text().startswith(length)
    assert cube.locator(".dot").count() == 2
    x, y = cube.evaluate(at, [0.0, -1.0, 0.8])
    cube.mouse.click(x, y)
    assert cube.locator(".dot").count() == 1  # the third begins anew
    cube.click("#measure")
    assert cube.locator(".dot").count() == 0


def test_the_picture_is_saved(cube: Page, tmp_path: Path) -> None:
    with cube.expect_download() as download:
        cube.click("#picture")
    assert download.value.suggested_filename == "Cube.png"
    assert Path(download.value.path()).read_bytes().startswith(b"\x89PNG")


def test_loading_is_said_until_the_mesh_is_there(cube: Page) -> None:
    assert '<p id="loading" role="status">' in build_page("t", "s", Scene(None))
    cube.wait_for_function("document.querySelector('#loading') === null")
    assert cube.evaluate("viewer.frames") >= 1


def test_the_first_view_is_filled(cube: Page) -> None:
    """The cube touches the border of the view, but for a margin."""
    extent = cube.evaluate("""() => { const {geometry, matrixWorld} = viewer.meshes[0];
        const place = viewer.camera.position.clone(), found = [0, 0];
        for (let i = 0; i < geometry.attributes.position.count; i++) {
            place.fromBufferAttribute(geometry.attributes.position, i).applyMatrix4(matrixWorld);
            place.project(viewer.camera);
            found[0] = Math.max(found[0], Math.abs(place.x));
            found[1] = Math.max(found[1], Math.abs(place.y));
        }
        return found }""")
    assert 0.9 < max(extent) <= 1.0


def test_a_finger_hits_every_control(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "n.html").write_text(build_page("Cube", "s", Scene(make_cube())))
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    page = context.new_page()
    page.goto((tmp_path / "n.html").as_uri())
    page.wait_for_selector("body[data-state='ready']", timeout=120_000)
    low = page.evaluate("""() => [...document.querySelectorAll('button, select, label, summary')]
        .filter((one) => one.checkVisibility() && one.getBoundingClientRect().height < 39.9)
        .map((one) => one.outerHTML)""")
    assert low == []
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    context.close()


def test_a_plane_cuts_the_mesh_and_shows_its_inside(cube: Page) -> None:
    whole = pixels(cube)
    cube.select_option("#clip-axis", "x")
    half = pixels(cube)
    assert half["back"] > 0.1 * half["drawn"]
    assert half["drawn"] < whole["drawn"]
    cube.fill("#clip-at", "0")
    assert pixels(cube)["drawn"] == 0
    cube.check("#clip-flip")
    assert pixels(cube)["drawn"] == whole["drawn"]
    cube.select_option("#clip-axis", "")
    assert pixels(cube)["hash"] == whole["hash"]


def test_back_faces_are_named_and_can_be_left_out(cube: Page) -> None:
    assert cube.inner_text("label:has(#backs)").strip() == "back faces"
    assert cube.evaluate("document.querySelector('#backs-tint').style.background") == (
        "rgb(173, 153, 138)"
    )
    cube.select_option("#clip-axis", "x")
    both = pixels(cube)
    cube.uncheck("#backs")
    fronts = pixels(cube)
    assert fronts["back"] == 0
    assert fronts["drawn"] < both["drawn"] - 0.9 * both["back"]
    cube.check("#backs")
    assert pixels(cube)["hash"] == both["hash"]


@pytest.mark.parametrize(("share", "is_room"), [(0.0, False), (0.27, False), (0.53, True)])
def test_near_walls_of_a_room_are_left_out(open_page: Open, share: float, is_room: bool) -> None:
    """A floor, and above a share of it a ceiling."""
    floor = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    ceiling = floor * [1, share, 1] + [0, 0, 1e-3]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    vertices = np.concatenate([floor, ceiling])
    room = Mesh(vertices, np.concatenate([faces, 4 + faces[:, ::-1]]))
    page = open_page(build_page("R", "s", Scene(room)))
    assert page.is_checked("#backs") is not is_room
    found = pixels(page)
    assert found["drawn"] > 1000
    assert (found["back"] > 0) is (share > 0.0 and not is_room)
    page.set_checked("#backs", is_room)
    page.click("#reset")  # the first view again
    assert page.is_checked("#backs") is not is_room
    page.evaluate("viewer.setBacks(true); viewer.frame()")  # of parts nothing is judged
    assert page.evaluate("viewer.hasBacks")


def test_facets_are_shaded_alike(cube: Page) -> None:
    smooth = pixels(cube)["hash"]
    cube.check("#flat")
    pixels(cube)
    cube.uncheck("#flat")
    assert pixels(cube)["hash"] == smooth


def test_the_mouse_turns_and_moves_and_a_button_goes_back(cube: Page) -> None:
    before = pixels(cube)["hash"]
    cube.mouse.move(200, 250)
    cube.mouse.down()
    cube.mouse.move(300, 200, steps=5)
    cube.mouse.up()
    turned = pixels(cube)["hash"]
    assert turned != before
    away = cube.evaluate("viewer.camera.position.length()")
    cube.mouse.wheel(0, -300)
    cube.wait_for_function("away => viewer.camera.position.length() < away", arg=away)
    assert pixels(cube)["hash"] != turned
    cube.click("#reset")
    assert pixels(cube)["hash"] == before


def test_another_axis_can_point_up(cube: Page) -> None:
    cube.select_option("#up", "y")
    assert cube.evaluate("viewer.camera.up.toArray()") == [0, 1, 0]
    seen = cube.evaluate("""() => { const place = viewer.box.getCenter(viewer.camera.up.clone());
        place.y += 1; return place.project(viewer.camera).y }""")
    assert seen > 0.1


def test_an_axis_can_point_down(cube: Page) -> None:
    cube.select_option("#up", "-y")
    assert cube.evaluate("viewer.camera.up.toArray()") == [0, -1, 0]


def test_what_was_scanned_from_one_side_is_seen_from_there(open_page: Open) -> None:
    """A square that faces y and not -y: its back would be tinted."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    page = open_page(build_page("S", "s", Scene(Mesh(corners, faces))))
    found = pixels(page)
    assert found["drawn"] > 10_000
    assert found["back"] == 0


def test_what_is_seen_from_below_only_is_seen_from_there(open_page: Open) -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    found = pixels(open_page(build_page("S", "s", Scene(Mesh(corners, faces)))))
    assert found["drawn"] > 10_000
    assert found["back"] == 0


def test_a_warning_leads_to_its_place_and_back(cube: Page) -> None:
    markers = cube.locator(".marker")
    assert markers.count() == 2
    cube.click("[data-marker='1']")
    target = cube.evaluate("viewer.controls.target.toArray()")
    assert target == pytest.approx([1, 1, 1])
    pixels(cube)
    box = markers.nth(1).bounding_box()
    view = cube.locator("#view").bounding_box()
    assert box is not None
    assert view is not None
    assert box["x"] + box["width"] / 2 == pytest.approx(view["width"] / 2, abs=3)
    cube.locator(".marker").nth(0).evaluate("one => one.click()")
    assert cube.evaluate("viewer.controls.target.toArray()") == pytest.approx([0, -1, 0])
    assert cube.evaluate("document.activeElement.dataset.marker") == "0"
    cube.uncheck("#show-markers")
    assert not markers.nth(0).is_visible()


def test_points_alone_are_drawn_in_their_colours(open_page: Open) -> None:
    places = np.random.default_rng(0).normal(size=(5000, 3))
    red = np.tile(np.array([[230, 20, 20]], np.uint8), (5000, 1))
    page = open_page(build_page("P", "s", Scene(None, points=PointCloud(places, colours=red))))
    found = pixels(page)
    assert found["drawn"] > 1000
    assert found["red"] > 0.5 * found["drawn"]  # the rest are edges, half white


def test_points_alone_take_every_colouring(open_page: Open) -> None:
    places = np.random.default_rng(0).normal(size=(5000, 3))
    normals = places / np.linalg.norm(places, axis=1)[:, None]
    places[7] = np.nan
    cloud = PointCloud(places, normals, attributes={"x": places[:, 0]})
    scene = Scene(None, fields_of(cloud), cloud, colouring="normals")
    page = open_page(build_page("P", "s", scene))
    first = page.evaluate("[...viewer.points.geometry.attributes.color.data.array.slice(0, 3)]")
    assert first == pytest.approx(127.5 * (1 + normals[0]), abs=1)
    seen = {pixels(page)["hash"]}
    for name in ("plain", "attribute-x"):
        page.select_option("#colouring", name)
        page.wait_for_selector(f"#legend[data-field='{name}']", state="attached")
        seen.add(pixels(page)["hash"])
    assert len(seen) == 3


def test_many_vertices_arrive_as_they_were(open_page: Open) -> None:
    rng = np.random.default_rng(5)
    mesh = Mesh(rng.random((70_000, 3)), rng.integers(0, 70_000, (100_000, 3)))
    page = open_page(build_page("M", "s", Scene(mesh)))
    rows = rng.integers(0, 100_000, 50)
    script = """rows => { const g = viewer.meshes[0].geometry, p = g.attributes.position.array;
        return rows.map(f => [0, 1, 2].map(k => { const v = g.index.array[3 * f + k];
            return [v, p[3 * v], p[3 * v + 1], p[3 * v + 2]]; })); }"""
    found = np.array(page.evaluate(script, rows.tolist()))
    np.testing.assert_array_equal(found[:, :, 0], mesh.faces[rows])
    low, step = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0).max() / 65535
    places = low + step * found[:, :, 1:]
    assert np.abs(places - mesh.vertices[mesh.faces[rows]]).max() <= 0.5001 * step


def test_a_notebook_draws_its_frame(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "n.html").write_text(wrap_mesh(make_cube())._repr_html_())
    page = browser.new_page()
    page.goto((tmp_path / "n.html").as_uri())
    page.frame_locator("iframe").locator("body[data-state='ready']").wait_for(timeout=120_000)
    page.close()


def test_without_webgl_it_says_what_to_do(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "n.html").write_text(build_page("Cube", "s", Scene(make_cube())))
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto((tmp_path / "n.html").as_uri())
    page.wait_for_selector("body[data-state='failed']")
    assert "--png" in page.inner_text("#failure")
    page.close()
