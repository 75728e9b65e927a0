"""What the numerics id depends on: code, and no prose."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import hpcapp
import hpcapp.applications.surface
from hpcapp.kernels.digest import SUBJECTS, digest_code, strip_prose

FILES = {
    "geometry/a.py": '"""One."""\nX = 1  # of something\n',
    "kernels/deep/er/b.py": "def f():\n    return 2\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("name", FILES)
def test_it_changes_with_the_code_of_each_file_at_any_depth(folder: Path, name: str) -> None:
    before = digest_code(folder)
    (folder / name).write_text(FILES[name].replace("1", "3").replace("2", "3"))
    assert digest_code(folder) != before


@pytest.mark.parametrize("name", FILES)
def test_it_does_not_change_with_prose(folder: Path, name: str) -> None:
    before = digest_code(folder)
    prose = '"""Another docstring,\nof two lines."""\n\n# And a comment.\n\n'
    (folder / name).write_text(prose + FILES[name].removeprefix('"""One."""\n'))
    assert digest_code(folder) == before


def test_it_changes_with_a_name_and_with_a_new_file(folder: Path) -> None:
    before = digest_code(folder)
    (folder / "geometry/a.py").rename(folder / "geometry/c.py")
    renamed = digest_code(folder)
    (folder / "geometry/d.py").touch()
    assert len({before, renamed, digest_code(folder)}) == 3


def test_what_only_the_master_runs_does_not_count(folder: Path) -> None:
    before = digest_code(folder)
    (folder / "applications/surface/job").mkdir(parents=True)
    (folder / "applications/surface/job/run.py").write_text("X = 1\n")
    (folder / "api.py").write_text("X = 1\n")
    assert digest_code(folder) == before


def test_all_subjects_are_there() -> None:
    surface = Path(hpcapp.applications.surface.__file__ or "").parent
    found = {path.parent.name for path in surface.glob("*/__init__.py")}
    hashed = {Path(subject).name for subject in SUBJECTS}
    assert found | {"geometry", "kernels"} == hashed | {
        "cli", "hierarchical", "job", "methods", "resolution", "steps",
    }  # fmt: skip


@example("#n")
@given(st.text(st.characters(exclude_characters="\r", exclude_categories=["Cs"]), max_size=30))
def test_strings_that_are_values_stay(value: str) -> None:
    assert strip_prose(f"X = {value!r}  # of any kind") == f"X = {value!r}"


def test_a_hash_within_a_string_is_no_comment() -> None:
    source = 'X = "#1"\nY = f"{X}#"  # one\nZ = """a # b"""\n'
    assert strip_prose(source) == 'X = "#1"\nY = f"{X}#"\nZ = """a # b"""'


def test_every_module_that_counts_is_still_the_same_program() -> None:
    """Without prose a module compiles to the same names in the same order."""
    package = Path(hpcapp.__file__).parent
    for file in (file for subject in SUBJECTS for file in (package / subject).rglob("*.py")):
        source = file.read_text()
        bare = compile(strip_prose(source) or "pass", file.name, "exec", optimize=2)
        assert bare.co_names == compile(source, file.name, "exec", optimize=2).co_names, file
