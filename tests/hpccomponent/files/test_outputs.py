"""The rule for all that a call writes: nothing that it reads, and nothing else of it, is lost."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hpccomponent.errors import OutputError
from hpccomponent.files.outputs import Read, Role, Written, check_files, check_place


def link_twice(one: Path, other: Path) -> None:
    (one.parent / "between").symlink_to(one)
    other.symlink_to("between")


WAYS: dict[str, Callable[[Path, Path], object]] = {
    "a symbolic link": lambda one, other: other.symlink_to(one),
    "a relative link": lambda one, other: other.symlink_to(f"link/{one.name}"),
    "a link to a link": link_twice,
    "a hard link": os.link,
}
SPELLINGS = ["mesh.ply", "./mesh.ply", "folder/../mesh.ply", "link/mesh.ply", "MESH.Ply"]


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(".")
    return tmp_path


def written(name: str | Path, option: str = "-o", role: Role = Role.FILE) -> Written:
    return Written(Path(name), option, role)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("role", [Role.FILE, Role.STREAM])
def test_a_file_by_another_name_is_known(place: Path, way: str, role: Role) -> None:
    one, other = place / "scan.xyz", place / "other.xyz"
    one.write_text("1 2 3")
    WAYS[way](one, other)
    for output, input_ in ((one, other), (other, one), (place / "link" / one.name, one)):
        with pytest.raises(OutputError, match="is the input itself; give another -o"):
            check_files([written(output, role=role)], [Read(input_)])
        with pytest.raises(OutputError, match="is the file of --polygon"):
            check_files([written(output, role=role)], [Read(input_, "--polygon")])
        with pytest.raises(OutputError, match="are one file"):
            check_files([written(output, role=role), written(input_, "--trace", Role.STREAM)])
    assert one.read_text() == "1 2 3"


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_two_names_of_a_file_that_is_not_there_yet_are_one(place: Path, spelling: str) -> None:
    (place / "dangling").symlink_to("mesh.ply")
    for name in ("mesh.ply", "dangling"):
        with pytest.raises(OutputError, match="are one file; give each a name of its own"):
            check_files([written(name), written(spelling, "--trace", Role.STREAM)])
    check_files([written("mesh.ply"), written("folder/mesh.ply", "--trace", Role.STREAM)])
    assert {path.name for path in place.iterdir()} == {"folder", "link", "dangling"}


def test_what_lies_in_a_folder_that_is_written_or_read_would_be_lost(place: Path) -> None:
    tiles, trace = written("a.tiles", role=Role.FOLDER), written("a.tiles/t", "--trace")
    with pytest.raises(OutputError, match=r"--trace a.tiles/t lies in -o a.tiles"):
        check_files([trace, tiles])
    with pytest.raises(OutputError, match="lies in -o"):
        check_files([tiles, written("A.tiles/tmp", "--temp-dir", Role.SCRATCH)])
    (place / "folder" / "images.txt").touch()
    with pytest.raises(OutputError, match="is there, in the folder of --viewpoint"):
        check_files([written("link/folder/images.txt")], [Read(Path("folder"), "--viewpoint")])
    check_files([written("folder/new.ply")], [Read(Path("folder"), "--viewpoint")])
    check_files([written("folder/new.ply"), written("folder", "--temp-dir", Role.SCRATCH)])


def test_the_standard_output_is_for_one(place: Path) -> None:
    printed = Written(Path("/dev/stdout"), "-o -", Role.PRINTED)
    with pytest.raises(OutputError, match="-o - and --json both want the standard output"):
        check_files([printed, Written(Path("/dev/stdout"), "--json", Role.PRINTED)])
    null = [written(os.devnull, option, Role.STREAM) for option in ("--trace", "--events")]
    check_files([*null, printed], [Read(Path(os.devnull))])


@pytest.mark.parametrize("role", [Role.FILE, Role.STREAM, Role.FOLDER])
def test_a_place_that_cannot_be_written_is_left_as_it_was(place: Path, role: Role) -> None:
    (place / "folder" / "file").touch()
    for name in ("nowhere/x", "folder/file/x", "folder", "n" * 300):
        before = sorted(place.rglob("*"))
        with pytest.raises(OutputError):
            check_files([written(name, role=role)])
        assert sorted(place.rglob("*")) == before
    check_files([Written(Path("nowhere/deep/x"), makes_folders=True)])
    assert not (place / "nowhere").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing/mesh.ply", "No such file or directory; create the folder"),
        ("file/mesh.ply", "Not a directory; create the folder"),
        ("folder.ply", "is not a file"),
        ("pipe.ply", "is not a file"),
        ("n" * 300 + ".ply", "File name too long"),
    ],
)
def test_bad_places_are_found_out_early(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.ply")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OutputError, match=said):
        check_place(tmp_path / name)
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_that_refuses_is_found_out_even_by_root() -> None:
    place = Path("/proc/mesh.ply")
    if not place.parent.is_dir():
        pytest.skip("no /proc: no folder at hand that refuses root")
    with pytest.raises(OutputError, match="cannot be written"):
        check_place(place)
