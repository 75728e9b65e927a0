"""The command ``reproduce``: what it writes, and what it refuses."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
from spheres import make_sphere
from verbs import run_verb

from hpcapp.io import write_points
from hpcapp.lab.reproduce.command import reproduce
from hpccomponent.errors import HpcError, InputError, UsageError


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    write_points(tmp_path / "sphere.ply", make_sphere(3000, 2.0))
    return tmp_path / "sphere.ply"


run = partial(run_verb, reproduce)


@pytest.mark.slow  # every panel is drawn
def test_the_steps_are_counted_and_drawn(sphere: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the plots extra")
    out = tmp_path / "new" / "out"
    table = run("fig2", sphere, "--out", out)
    assert (out / "fig2.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "fig2.md").read_text().startswith(table.rstrip())
    assert "need not be near them" in table  # not the paper's cloud
    # No box of a sphere's cut in eight has normals farther apart than 90 degrees.
    assert "| as printed, n.m > 0.1, root cube | 8 | 8 |" in table
    assert "Step 1, to denoise and resample, is off" in table


@pytest.mark.slow  # workers are started
def test_both_figures_come_from_one_run(sphere: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="needs the plots extra")
    words = ("--workers", 1, "--rounds", 1, "--grid", 16, "--up", "y", "--out", tmp_path)
    tables = run("fig7-8", sphere, *words)
    for name, title in (("fig7", "# Figure 7: time"), ("fig8", "# Figure 8: speed-up")):
        assert title in tables
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert title in (tmp_path / f"{name}.md").read_text()


@pytest.mark.parametrize(
    ("words", "kind", "match"),
    [
        (("fig2", "--grid", "32"), UsageError, "--grid means nothing to fig2"),
        (("fig6", "--cluster", "c.yaml"), UsageError, "it is for table1"),
        (("table1", "nowhere.ply"), InputError, "nowhere"),
    ],
)
def test_bad_input_leaves_nothing(
    words: tuple[str, ...], kind: type[HpcError], match: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with pytest.raises(kind, match=match):
        run(*words, "--out", out)
    assert not out.exists()
