"""One file, several, patterns, compressed ones, the standard input: all are one file to read."""

import gzip
import io
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from spheres import make_sphere

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_points, write_points
from hpcapp.io.points.inputs import find_files, gather_points
from hpccomponent.errors import InputError, UsageError

TETRAHEDRON = "v 0 0 0\nv 4 0 0\nv 0 4 0\nv 0 0 4\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def read(names: list[str], sample: int | None = None) -> PointCloud:
    with gather_points(names, sample) as path:
        return read_points(path)


def give_input(monkeypatch: pytest.MonkeyPatch, content: bytes) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))


def test_a_single_file_is_read_where_it_is(tmp_path: Path) -> None:
    write_points(tmp_path / "a.ply", make_sphere(50, seed=0))
    with gather_points([str(tmp_path / "a.ply")]) as path:
        assert path == tmp_path / "a.ply"


def test_files_that_fit_a_pattern_are_joined_in_their_order(tmp_path: Path) -> None:
    clouds = [make_sphere(50, seed=seed) for seed in range(3)]
    for name, cloud in zip("cab", clouds, strict=True):
        write_points(tmp_path / f"{name}.xyz", cloud)
    joined = read([str(tmp_path / "?.xyz")])
    wanted = np.concatenate([clouds[i].positions for i in (1, 2, 0)])
    np.testing.assert_array_equal(joined.positions, wanted)
    assert joined.attributes["scan"].tolist() == [0] * 50 + [1] * 50 + [2] * 50


def test_what_only_some_files_have_is_left_out_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cloud = make_sphere(50, seed=0)
    write_points(tmp_path / "a.ply", cloud)
    write_points(tmp_path / "b.ply", PointCloud(cloud.positions))
    assert read([str(tmp_path / "a.ply"), str(tmp_path / "b.ply")]).normals is None
    said = "a.ply: all points stay; left out of each, as not all files have it: nx, ny, nz"
    assert said in caplog.text


def test_points_of_files_without_colours_are_white(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cloud = make_sphere(50, seed=0)
    red = np.full((50, 3), (200, 10, 10), np.uint8)
    write_points(tmp_path / "a.ply", PointCloud(cloud.positions, cloud.normals))
    write_points(tmp_path / "b.ply", PointCloud(cloud.positions, cloud.normals, red))
    joined = read([str(tmp_path / "a.ply"), str(tmp_path / "b.ply")])
    assert joined.colours is not None
    assert joined.colours.tolist() == [[255, 255, 255]] * 50 + [[200, 10, 10]] * 50
    (message,) = caplog.messages
    assert message.endswith("a.ply: no colours, as other files have: white there")


def test_joined_files_are_called_by_their_formats(tmp_path: Path) -> None:
    for name in ("a.xyz", "b.xyz", "c.npz"):
        write_points(tmp_path / name, make_sphere(50, seed=0))
    with gather_points([str(tmp_path / name) for name in ("a.xyz", "b.xyz", "c.npz")]) as path:
        assert open_points(path).format == "3 files: text, separated by blanks; NPZ"


@pytest.mark.parametrize("suffix", [".ply", ".xyz"])
def test_compressed_files_hold_what_was_compressed(tmp_path: Path, suffix: str) -> None:
    write_points(tmp_path / f"a{suffix}", make_sphere(50, seed=0))
    packed = tmp_path / f"b{suffix}.gz"
    packed.write_bytes(gzip.compress((tmp_path / f"a{suffix}").read_bytes()))
    plain = read_points(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(read([str(packed)]).positions, plain.positions)


@pytest.mark.parametrize("damage", [lambda b: b[:-20], lambda b: b[:40] + b"\0" * 9 + b[49:]])
def test_a_damaged_compressed_file_is_refused_by_its_name(tmp_path: Path, damage: object) -> None:
    assert callable(damage)
    write_points(tmp_path / "a.ply", make_sphere(50, seed=0))
    packed = tmp_path / "a.ply.gz"
    packed.write_bytes(damage(gzip.compress((tmp_path / "a.ply").read_bytes())))
    with pytest.raises(InputError, match=r"a\.ply\.gz: (cut|damaged)"):
        read([str(packed)])


def test_an_error_names_the_file_that_the_user_named(tmp_path: Path) -> None:
    packed = tmp_path / "bad.ply.gz"
    packed.write_bytes(gzip.compress(b"ply\nformat ascii 1.0\nend_header\n"))
    with pytest.raises(InputError) as caught:
        read([str(packed)])
    assert str(caught.value).startswith(f"{packed}: ")


@pytest.mark.parametrize("is_packed", [False, True])
@pytest.mark.parametrize("suffix", [".ply", ".xyz"])
def test_the_standard_input_is_known_by_its_first_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, is_packed: bool
) -> None:
    write_points(tmp_path / f"a{suffix}", make_sphere(50, seed=0))
    content = (tmp_path / f"a{suffix}").read_bytes()
    give_input(monkeypatch, gzip.compress(content) if is_packed else content)
    plain = read_points(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(read(["-"]).positions, plain.positions)


def test_an_empty_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    give_input(monkeypatch, b"")
    with pytest.raises(InputError, match="standard input is empty"):
        read(["-"])


def test_the_standard_input_stands_alone() -> None:
    with pytest.raises(UsageError, match="standard input"):
        find_files(["-", "a.ply"])


def test_a_pattern_that_nothing_fits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no file fits"):
        find_files([str(tmp_path / "*.laz")])


def test_a_name_with_brackets_is_a_file_where_there_is_one(tmp_path: Path) -> None:
    (tmp_path / "a[1].ply").touch()
    assert find_files([str(tmp_path / "a[1].ply")]) == [str(tmp_path / "a[1].ply")]


def test_sampled_points_lie_evenly_on_the_faces(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TETRAHEDRON)
    cloud = read([str(tmp_path / "a.obj")], 4000)
    assert cloud.normals is not None
    assert len(cloud) == 4000
    on_slope = cloud.normals.min(axis=1) > 0.5
    distances: FloatArray = np.where(
        on_slope, cloud.positions.sum(axis=1) - 4.0, cloud.positions.min(axis=1)
    )
    np.testing.assert_allclose(distances, 0.0, atol=1e-12)
    share = np.sqrt(3.0) / (np.sqrt(3.0) + 3.0)  # of the area: the slope's
    assert abs(on_slope.mean() - share) < 0.01


def test_temporary_files_are_gone_afterwards(tmp_path: Path) -> None:
    packed = tmp_path / "a.xyz.gz"
    packed.write_bytes(gzip.compress(b"0 0 0\n1 2 3\n"))
    with gather_points([str(packed)]) as path:
        assert path.exists()
    assert not path.exists()


ON_A_SMALL_DISK = """
mount -t tmpfs -o size=8m none "$1" || exit 77
export TMPDIR="$1"
shift
"$@"
echo "exit code $?, left: $(ls "$TMPDIR")" >&2
"""


@pytest.mark.parametrize("is_packed", [False, True])
def test_what_has_no_end_is_refused_by_its_name(tmp_path: Path, is_packed: bool) -> None:
    """Half of what the disk has free may be taken; the copy goes."""
    place, packed = tmp_path / "place", tmp_path / "a.xyz.gz"
    place.mkdir()
    with gzip.open(packed, "wb") as file:
        file.write(b"0 0 0\n" * 4_000_000)
    words = [sys.executable, "-m", "hpcapp", "info", str(packed) if is_packed else "-"]
    shell = ["unshare", "--mount", "--map-root-user", "sh", "-c", ON_A_SMALL_DISK, "sh", str(place)]
    with subprocess.Popen(["yes", "0 0 0"], stdout=subprocess.PIPE) as endless:
        try:
            done = subprocess.run(
                [*shell, *words], stdin=endless.stdout, capture_output=True, text=True
            )
        finally:
            endless.kill()
    if done.returncode == 77 or "unshare:" in done.stderr:
        pytest.skip(f"no file system can be mounted here: {done.stderr}")
    name = str(packed) if is_packed else "the standard input"
    assert f"hpcapp: {name}: no end after 4 MiB, and no more room for a copy in" in done.stderr
    assert "check that it ends" in done.stderr
    assert done.stderr.endswith("exit code 3, left: \n")


@pytest.mark.slow  # it writes a gibibyte
def test_what_unpacks_to_more_than_its_size_allows_is_refused(tmp_path: Path) -> None:
    whole = zlib.compressobj(9, wbits=31)
    head = whole.compress(bytes(1 << 24)) + whole.flush(zlib.Z_FULL_FLUSH)
    more = whole.compress(bytes(1 << 24)) + whole.flush(zlib.Z_FULL_FLUSH)
    (tmp_path / "a.npy.gz").write_bytes(head + 69 * more)
    with (
        pytest.raises(InputError, match=r"a\.npy\.gz: what it unpacks to: with that it claims 10"),
        gather_points([str(tmp_path / "a.npy.gz")]),
    ):
        pass
