"""A text that is cut in its last number is told; one that merely lacks its last newline is not."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from hpcapp.io import open_points, read_mesh, read_whole
from hpcapp.io.text.endings import find_cut

PLACES = np.random.default_rng(2).normal(0.0, 300.0, (60, 3))
PLY = "ply\nformat ascii 1.0\nelement vertex 60\n{}end_header\n".format(
    "".join(f"property double {axis}\n" for axis in "xyz")
)
HEADS = {
    ".xyz": "",
    ".csv": "x,y,z\n",
    ".pts": "60\n",
    ".ply": PLY,
    ".vtk": "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 60 double\n",
    ".pcd": "FIELDS x y z\nWIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA ascii\n",
}
FORMS = {"decimals": "%.6f", "exponents": "%.9e", "padded": "%12.3f", "whole": "%7d"}


def make_rows(form: str, separator: str = " ") -> str:
    return "".join(separator.join([form] * 3) % tuple(row) + "\n" for row in PLACES.tolist())


@pytest.mark.parametrize("suffix", HEADS)
@pytest.mark.parametrize("lost", [1, 2, 4])
def test_a_cut_number_is_told_in_each_format(tmp_path: Path, suffix: str, lost: int) -> None:
    path = tmp_path / f"a{suffix}"
    text = HEADS[suffix] + make_rows("%.6f", "," if suffix == ".csv" else " ")
    for content, is_cut in ((text, False), (text[:-1], False), (text[: -1 - lost], True)):
        path.write_text(content)
        source = open_points(path)
        assert len(read_whole(source)) == 60
        assert [("seems cut" in line) for line in source.findings.warnings] == [True] * is_cut


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_cut_number_is_told_in_each_form(tmp_path: Path, form: str, encoding: str) -> None:
    path, text = tmp_path / "a.xyz", make_rows(FORMS[form])
    path.write_text(text[:-1], encoding)
    assert find_cut(path) is None
    path.write_text(text[:-2], encoding)
    assert find_cut(path) is not None


@pytest.mark.parametrize("form", ["%.17g", "%.6g", "%g", "%d", "%-12.3f"])
@pytest.mark.parametrize("rows", [1, 2, 5, 20, 60])
def test_numbers_of_any_length_are_not_taken_for_cut(tmp_path: Path, form: str, rows: int) -> None:
    path = tmp_path / "a.xyz"
    for first in range(60 - rows + 1):
        lines = make_rows(form).splitlines()[first : first + rows]
        path.write_text("\n".join(lines))
        assert find_cut(path) is None


def test_binary_files_are_not_taken_for_cut(tmp_path: Path) -> None:
    path, random = tmp_path / "a.xyz", np.random.default_rng(0)
    for size in range(1, 400):
        path.write_bytes(random.bytes(50 * size))
        assert find_cut(path) is None


def test_a_cut_mesh_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    faces = "".join(f"f {i + 1} {i + 2} {i + 3}\n" for i in range(58))
    rows = make_rows("v %.6f").replace(" v ", " ")
    (tmp_path / "a.obj").write_text(faces + rows[:-1])
    (tmp_path / "b.obj").write_text(faces + rows[:-3])
    with caplog.at_level(logging.WARNING, "hpcapp"):
        read_mesh(tmp_path / "a.obj")
        assert not caplog.messages
        read_mesh(tmp_path / "b.obj")
    assert "seems cut" in caplog.text
