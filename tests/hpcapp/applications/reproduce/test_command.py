"""The command ``reproduce``: what it writes, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hpcapp.applications.reproduce.command import reproduce
from hpcapp.applications.surface.types.points import PointCloud
from hpcapp.io import write_points
from hpccomponent.errors import HpcError, InputError, UsageError


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    normals = np.random.default_rng(5).normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    write_points(tmp_path / "sphere.ply", PointCloud(2.0 * normals, normals))
    return tmp_path / "sphere.ply"


def run(*words: str | Path) -> str:
    done = CliRunner().invoke(reproduce, list(map(str, words)), catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


@pytest.mark.slow  # matplotlib draws each patch
def test_patches_are_counted_and_drawn(sphere: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    table = run("fig2", sphere, "--out", out)
    assert (out / "fig2.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "fig2.md").read_text().startswith(table.rstrip())
    assert "need not be near them" in table  # not the paper's cloud
    # No box of a sphere's cut in eight has normals farther apart than 90 degrees.
    assert "| as printed, n.m > 0.1, root cube | 8 |" in table


@pytest.mark.parametrize(
    ("words", "kind", "match"),
    [
        (("fig2", "--grid", "32"), UsageError, "--grid means nothing to fig2"),
        (("fig6", "--cluster", "c.yaml"), UsageError, "it is for table1"),
        (("fig2", "nowhere.ply"), InputError, "nowhere"),
    ],
)
def test_bad_input_leaves_nothing(
    words: tuple[str, ...], kind: type[HpcError], match: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with pytest.raises(kind, match=match):
        run(*words, "--out", out)
    assert not out.exists()
