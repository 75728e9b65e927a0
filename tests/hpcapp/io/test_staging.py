import os
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import check_writable, write_mesh
from hpcapp.io.meshes.tiles import shared_tiles
from hpcapp.io.staging import replacing
from hpccomponent.errors import OutputError


@pytest.mark.slow
@pytest.mark.parametrize("end", [KeyboardInterrupt, RuntimeError, SystemExit])
@pytest.mark.parametrize("old", [b"old", None])
def test_whatever_ends_the_writing_leaves_what_was_there(
    tmp_path: Path, end: type[BaseException], old: bytes | None
) -> None:
    path = tmp_path / "mesh.ply"
    if old is not None:
        path.write_bytes(old)

    def write_half() -> None:
        with replacing(path) as file:
            file.write(b"half a mesh")
            file.flush()
            raise end

    with pytest.raises(end):
        write_half()
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([old] if old is not None else [])


def test_the_place_keeps_the_old_file_until_the_new_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    path.write_bytes(b"old")
    with replacing(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_an_output_error(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    with pytest.raises(OutputError, match="cannot be written: No space left"), replacing(path):
        raise OSError(28, os.strerror(28))
    assert not list(tmp_path.iterdir())


def test_a_writer_that_fails_half_way_leaves_nothing(tmp_path: Path) -> None:
    not_faces = np.array([[0, 1]])
    with pytest.raises((ValueError, TypeError)):
        write_mesh(tmp_path / "mesh.off", Mesh(np.zeros((3, 3)), not_faces))
    assert not list(tmp_path.iterdir())


def test_new_files_have_the_usual_permissions(tmp_path: Path) -> None:
    with replacing(tmp_path / "new"):
        pass
    (tmp_path / "usual").touch()
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize("umask", [0o000, 0o027, 0o077])
def test_what_is_being_written_is_private(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        with replacing(tmp_path / "mesh.ply") as file:
            while_written = os.stat(file.name).st_mode & 0o777
        with shared_tiles(tmp_path / "mesh.tiles") as file_of:
            folder_while_written = file_of(0).parent.stat().st_mode & 0o777
    finally:
        os.umask(before)
    assert (while_written, folder_while_written) == (0o600, 0o700)
    assert (tmp_path / "mesh.ply").stat().st_mode & 0o777 == 0o666 & ~umask
    assert (tmp_path / "mesh.tiles").stat().st_mode & 0o777 == 0o777 & ~umask


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "link.ply").symlink_to(tmp_path / "deep" / "mesh.ply")
    with replacing(tmp_path / "link.ply") as file:
        file.write(b"new")
    assert (tmp_path / "link.ply").is_symlink()
    assert (tmp_path / "deep" / "mesh.ply").read_bytes() == b"new"


def test_a_link_to_an_empty_folder_stays_and_the_folder_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "link.tiles").symlink_to(tmp_path / "deep")
    (tmp_path / "none.tiles").symlink_to(tmp_path / "new")
    for name in ("link.tiles", "none.tiles"):
        with shared_tiles(tmp_path / name) as file_of:
            file_of(0).touch()
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / name / "tile-0000.ply").exists()


def test_a_good_place_is_left_as_it_was(tmp_path: Path) -> None:
    check_writable(tmp_path / "mesh.ply")
    check_writable(tmp_path / "scan.xyz", "points")
    assert not list(tmp_path.iterdir())
