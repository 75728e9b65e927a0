"""Words of others are text on every kind of page: whatever they are, nothing of them runs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from spheres import make_sphere

import hpcapp
from hpcapp.io.e57.writer import write_e57

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Frame

Run = Callable[..., tuple[int, str, str]]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.leaks_allowed,  # the browser stays for the module
]

NAME = "'\"><img src=x onerror=ran=1><!--<script>"
"""Of files: without a slash."""
WORDS = (
    "'\"></script></title></textarea><script>ran=1</script><img/src=x/onerror=ran=1><!--<script>"
)
"""Of what a file says: without a space, so that a column can have it as its name."""
WKT = (
    f'PROJCS["{WORDS}",GEOGCS["{WORDS}",DATUM["{WORDS}",SPHEROID["{WORDS}",6378137,298.25]],'
    f'PRIMEM["{WORDS}",0],UNIT["{WORDS}",0.017]],PROJECTION["{WORDS}"],UNIT["{WORDS}",1]]'
).replace("'\"", "'")


def write_mesh(path: Path, height: float = 0.0) -> None:
    """Write a square of PLY, each of whose strings is not ours."""
    steps = np.arange(6)
    rows = [f"{x} {y} {height} {x}" for x in steps for y in steps]
    corners = [6 * i + j for i in range(5) for j in range(5)]
    faces = [f"3 {a} {a + 6} {a + 7}\n3 {a} {a + 7} {a + 1}" for a in corners]
    said = [f"{key} {WORDS}" for key in ("unit", "crs", "epsg", "TextureFile", "up", "")]
    comments = "".join(f"comment {line}\nobj_info {line}\n" for line in said)
    head = (
        f"ply\nformat ascii 1.0\n{comments}element vertex 36\nproperty float x\nproperty float y\n"
        f"property float z\nproperty float {WORDS}\nelement face 50\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    path.write_text(head + "\n".join([*rows, *faces]) + "\n")


def write_files(folder: Path) -> None:
    """Write meshes, points and a report."""
    write_mesh(folder / f"{NAME}.ply")
    write_mesh(folder / f"old{NAME}.ply", -0.5)
    sphere = make_sphere(800)
    cloud = replace(sphere, attributes={WORDS: sphere.positions[:, 0]})
    hpcapp.write_points(folder / f"{NAME}-points.ply", cloud)
    columns = np.column_stack([cloud.positions, cloud.attributes[WORDS]])
    np.savetxt(folder / f"{NAME}.csv", columns, delimiter=",", header=f"x,y,z,{WORDS}", comments="")
    write_e57(folder / f"{NAME}.e57", cloud, WKT)
    mesh = hpcapp.read_mesh(folder / f"{NAME}.ply")
    mesh.save(folder / f"{NAME}.glb")
    mesh.save(folder / f"{NAME}.vtp")
    mesh.save(folder / "plain.obj")
    material = f"mtllib {WORDS}\nusemtl {WORDS}\no {WORDS}\ng {WORDS}\n"
    (folder / f"{NAME}.obj").write_text(material + (folder / "plain.obj").read_text())
    (folder / "notebook.html").write_text(mesh._repr_html_())
    span = {"name": WORDS, "worker": WORDS, "begin": 0.0, "end": 1.0, "outcome": WORDS}
    report = {
        **dict.fromkeys(("summary", "method", "up", "backend", "cost", WORDS), WORDS),
        "command": [WORDS],
        "warnings": [WORDS],
        "stages": {WORDS: 1.0},
        "timeline": {"spans": [span]},
        "input": {"files": [WORDS], "unit": WORDS, "crs": WKT, "columns": {WORDS: WORDS}},
        "normals": {WORDS: [WORDS, {WORDS: WORDS}]},
        "dropped": {WORDS: WORDS},
        "choice": {"reason": WORDS},
        "losses": [{WORDS: WORDS}],
    }
    (folder / "report.json").write_text(json.dumps(report))


PAGES = {
    **{
        f"view {kind}": ["view", f"{NAME}{kind}", "--no-open", "-o"]
        for kind in (".ply", "-points.ply", ".csv", ".e57", ".glb", ".vtp", ".obj")
    },
    "view a report": ["view", f"{NAME}.ply", "--report", "report.json", "--points", f"{NAME}.csv",
                      "--no-open", "-o"],
    "report": ["reconstruct", f"{NAME}.csv", "-o", f"{NAME}.off", "--report"],
    "compare": ["compare", f"{NAME}.ply", f"old{NAME}.ply", "--html"],
    "compare --volume": ["compare", f"{NAME}.ply", f"old{NAME}.ply", "--volume", "--html"],
}  # fmt: skip


def assert_nothing_ran(shown: Frame) -> None:
    assert shown.evaluate("typeof ran") == "undefined"
    assert shown.locator("img, [onerror]").count() == 0


@pytest.mark.parametrize("kind", [*PAGES, "notebook"])
def test_nothing_of_a_files_words_runs(
    browser: Browser, run: Run, tmp_path: Path, kind: str
) -> None:
    write_files(tmp_path)
    page_file = tmp_path / "notebook.html"
    if kind != "notebook":
        page_file = tmp_path / f"page{NAME}.html"
        code, _, said = run(*PAGES[kind], page_file.name)
        assert code == 0, said
    page = browser.new_page()
    page.goto(page_file.as_uri())
    shown = page.main_frame if kind != "notebook" else page.frames[1]
    assert_nothing_ran(shown)
    shown.wait_for_selector("body[data-state='ready']", timeout=120_000)
    for name in shown.eval_on_selector_all("#colouring option", "all => all.map((o) => o.value)"):
        shown.select_option("#colouring", name)
        shown.wait_for_selector(f"#legend[data-field={json.dumps(name)}]", state="attached")
    assert_nothing_ran(shown)
    assert "onerror" in (shown.text_content("aside") or "")  # the words are there, as text
    page.close()
