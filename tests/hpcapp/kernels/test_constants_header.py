"""The constants of the kernels: read from the Python modules, told to C++."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import hpcapp
from hpcapp.kernels.constants_header import make_header, read_constants
from hpcapp.kernels.digest import SUBJECTS, digest_code
from hpcapp.kernels.portable.around import planes
from hpcapp.kernels.portable.field import features

PACKAGE = Path(hpcapp.__file__).parent


@pytest.mark.parametrize("module", [planes, features])
def test_what_is_read_is_what_the_module_has(module: object) -> None:
    assert isinstance(module.__file__, str)  # type: ignore[attr-defined]
    constants = read_constants(Path(module.__file__).read_text())  # type: ignore[attr-defined]
    assert constants == {name: getattr(module, f"_{name}") for name in constants}
    assert len(constants) > 12


def test_what_is_computed_is_left_out() -> None:
    source = "A = 1\nB = make(A)\nC = B + 1\nD = [1]\nE = A / 4, -(A << 2)\nname = 3\n"
    assert read_constants(source) == {"A": 1, "E": (0.25, -4)}


def test_types_and_sides_are_those_of_the_values() -> None:
    header = make_header(PACKAGE)
    assert "namespace planes {\nconstexpr int COUNTS[5] = {8, 12, 17, 24, 34};" in header
    assert "constexpr int64_t STRIDES[3] = {4398046511104, 2097152, 1};" in header
    assert "constexpr double RIDGE = 1e-09;" in header


def test_a_constant_changes_the_header_and_the_numerics_id(tmp_path: Path) -> None:
    for subject in SUBJECTS:
        shutil.copytree(PACKAGE / subject, tmp_path / subject)
    header, digest = make_header(tmp_path), digest_code(tmp_path)
    module = tmp_path / "kernels/portable/quadrics/hermite.py"
    module.write_text(module.read_text().replace("_RIDGE = 1e-9", "_RIDGE = 2e-9"))
    assert make_header(tmp_path) == header.replace("RIDGE = 1e-09", "RIDGE = 2e-09") != header
    assert digest_code(tmp_path) != digest
