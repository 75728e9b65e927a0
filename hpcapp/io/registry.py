"""File formats, one entry each: what is read of them and written to them, and by which function.

Functions are named as ``module:function`` of this package, and imported when they are called. What
the system refuses is left to `formats` to translate; a reader raises InputError where a file is
damaged, a writer OutputError where it cannot be written: it appears whole or not at all. Both raise
MissingLibraryError where a library that they need is not installed. A how-to page shows how to add
a format.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import OutputError, UsageError

if TYPE_CHECKING:
    from hpcapp.geometry.mesh import Mesh
    from hpcapp.geometry.points import PointCloud
    from hpcapp.io.crs import Crs
    from hpcapp.io.meshes.mesh_stream import MeshStream
    from hpcapp.io.points.point_source import PointSource, Scan


TILES_SUFFIX = ".tiles"
"""Of an output that is to be a folder of tiles."""

_LONGEST = 40  # characters of a coordinate system in a message

Role = TypeVar("Role")


def _call(function: str, *arguments: Any, **named: Any) -> Any:
    """Call ``module:function``."""
    module, _, name = function.partition(":")
    return getattr(import_module(f"hpcapp.io.{module}"), name)(*arguments, **named)


@dataclass(frozen=True, slots=True)
class PointReader:
    """What opens points.

    Parameters
    ----------
    least_bytes : float
        Fewest bytes of the file that a point takes: a bound of how many there can be, where the
        file does not say.
    states_count : bool
        Whether the start of a file says how many points there are.
    needs_library : bool
        Whether that is a library that is not everywhere where this package is.
    knows_noise : bool
        Whether classes of the format say that a point is none.
    """

    function: str
    least_bytes: float
    states_count: bool = False
    needs_library: bool = False
    knows_noise: bool = False

    def open(self, path: Path, *, keeps_noise: bool = False) -> PointSource:
        """Open a file, without the points of a class of noise unless these are kept."""
        more = {"keeps_noise": keeps_noise} if self.knows_noise else {}
        source: PointSource = _call(self.function, path, **more)
        return source


@dataclass(frozen=True, slots=True)
class MeshReader:
    """What reads a mesh.

    Parameters
    ----------
    finds_faces : str, optional
        Function that tells whether a file has faces, where it may hold points alone.
    finds_crs : str, optional
        Function that tells what coordinates mean, where the format has a place for it.
    finds_up : str, optional
        Function that tells which axis points up, where the format says so.
    """

    function: str
    finds_faces: str | None = None
    finds_crs: str | None = None
    finds_up: str | None = None

    def read(self, path: Path) -> Mesh:
        """Read a file."""
        mesh: Mesh = _call(self.function, path)
        return mesh

    def has_faces(self, path: Path) -> bool:
        """Tell whether a file is a mesh, by its start or by all of its lines."""
        return self.finds_faces is None or bool(_call(self.finds_faces, path))

    def find_crs(self, path: Path) -> Crs:
        """Return what the coordinates of a file mean."""
        from hpcapp.io.crs import UNKNOWN

        crs: Crs = UNKNOWN if self.finds_crs is None else _call(self.finds_crs, path)
        return crs

    def find_up(self, path: Path) -> str | None:
        """Return the axis that points up in a file; None where its format does not say."""
        return None if self.finds_up is None else str(_call(self.finds_up, path))


@dataclass(frozen=True, slots=True)
class PointWriter:
    """What writes points, and what is held of them.

    Parameters
    ----------
    takes : tuple of {"crs", "unit", "height_unit", "scans"}
        What the function is given by name, beside a path and a cloud.
    choose_attributes : callable, optional
        Names the only attributes of a cloud that are held; all by default.
    holds_crs : callable
        Tells whether a coordinate reference system is held.
    holds_unit : callable
        Tells whether a unit is held, given the coordinate reference system, too.
    """

    function: str
    takes: tuple[str, ...] = ()
    choose_attributes: Callable[[PointCloud], Collection[str]] | None = None
    holds_crs: Callable[[str], bool] = lambda _: False
    holds_unit: Callable[[str, str | None], bool] = lambda *_: False

    def write(
        self,
        path: Path,
        cloud: PointCloud,
        crs: str | None,
        unit: str | None,
        scans: Sequence[Scan],
        height_unit: str | None,
    ) -> None:
        """Write a file."""
        known = {"crs": crs, "unit": unit, "scans": scans, "height_unit": height_unit}
        _call(self.function, path, cloud, **{name: known[name] for name in self.takes})

    def find_losses(self, cloud: PointCloud, frame: Crs, scans: Sequence[Scan]) -> list[str]:
        """Return what is not held: names of attributes, and words for the rest."""
        lost: list[str] = []
        if self.choose_attributes is not None:
            kept = self.choose_attributes(cloud)
            lost += [name for name in cloud.attributes if name not in kept]
        crs, unit = frame.text, frame.unit
        if crs and not self.holds_crs(crs):
            shown = crs if len(crs) <= _LONGEST else f"{crs[:_LONGEST]}..."
            lost.append(f"CRS ({shown})")
        if unit and not self.holds_unit(unit, crs):
            lost.append(f"unit ({unit})")
        if frame.height_scale != 1.0 and "height_unit" not in self.takes:
            lost.append(f"unit of heights ({frame.height_unit})")
        if "scans" not in self.takes and any(scan.scanner is not None for scan in scans):
            lost.append("scanner positions")
        return lost


@dataclass(frozen=True, slots=True)
class MeshWriter:
    """What writes a mesh, and which columns of its vertices are held.

    Parameters
    ----------
    makes_folder : bool
        Of files, in place of one file.
    is_near : bool
        Whether programs read it in single precision, so that it is written near zero.
    turns : bool
        Whether it says which axis points up, so that a mesh is turned.
    is_bare : bool
        Whether it holds triangles in single precision and no word of what they mean.
    textures : bool
        Whether a texture is held.
    texture_files : str, optional
        Function that names the files beside a mesh that hold it.
    """

    function: str
    normals: bool = False
    colours: bool = False
    attributes: bool = False
    makes_folder: bool = False
    is_near: bool = False
    turns: bool = False
    is_bare: bool = False
    textures: bool = False
    texture_files: str | None = None

    def write(self, path: Path, mesh: MeshStream) -> None:
        """Write a file."""
        _call(self.function, path, mesh)

    def list_texture_files(self, path: Path) -> list[Path]:
        """Return the files beside a mesh that hold its texture."""
        return [] if self.texture_files is None else list(_call(self.texture_files, path))

    @property
    def holds_all(self) -> bool:
        """Whether nothing that vertices can carry is lost."""
        return self.normals and self.colours and self.attributes

    def find_losses(self, layout: PointCloud) -> list[str]:
        """Return which columns of vertices are not held."""
        lost = ["normals"] if layout.normals is not None and not self.normals else []
        lost += ["colours"] if layout.colours is not None and not self.colours else []
        return lost if self.attributes else [*lost, *layout.attributes]


@dataclass(frozen=True, slots=True)
class Format:
    """A file format, by its suffixes: in lower case, with the dot."""

    suffixes: tuple[str, ...]
    point_reader: PointReader | None = None
    mesh_reader: MeshReader | None = None
    point_writer: PointWriter | None = None
    mesh_writer: MeshWriter | None = None


def _is_wkt(crs: str) -> bool:
    return "[" in crs


def _choose_for_text(cloud: PointCloud) -> Collection[str]:
    return ("intensity",) if cloud.colours is not None and cloud.normals is None else ()


def _is_in_las(crs: str) -> bool:
    from hpcapp.io.crs import parse_epsg

    return _is_wkt(crs) or parse_epsg(crs) is not None


def _is_unit_in_las(unit: str, crs: str | None) -> bool:
    from hpcapp.io.crs import UNIT_CODES

    return unit in UNIT_CODES or (crs is not None and _is_in_las(crs))


_TEXT = PointReader("text.points:open_text", 6)
_NUMPY = PointReader("numpy_files.points:open_npy", 3, states_count=True)
_LAS = PointWriter(
    "las.writer:write_las",
    ("crs", "unit", "height_unit"),
    holds_crs=_is_in_las,
    holds_unit=_is_unit_in_las,
)

FORMATS = (
    Format(
        (".ply",),
        PointReader("ply.points:open_ply", 3, states_count=True),
        MeshReader(
            "ply.format:read_ply_mesh", "ply.format:holds_ply_faces", "ply.format:find_ply_crs"
        ),
        PointWriter(
            "ply.format:write_ply_points",
            ("crs", "unit", "height_unit", "scans"),
            holds_crs=lambda _: True,
            holds_unit=lambda *_: True,
        ),
        MeshWriter("ply.format:write_ply_mesh", normals=True, colours=True, attributes=True),
    ),
    Format(
        (".xyz", ".txt", ".asc", ".pts"),  # blanks separate in any program
        _TEXT,
        None,
        PointWriter("text.writer:write_text_points", choose_attributes=_choose_for_text),
    ),
    Format((".csv", ".xyzn", ".xyzrgb", ".xyzi", ".pwn"), _TEXT),
    Format((".ptx",), PointReader("text.ptx:open_ptx", 6)),
    Format(
        (".las",),
        PointReader("las.points:open_las", 20, states_count=True, knows_noise=True),
        None,
        _LAS,
    ),
    Format(
        (".laz",),
        PointReader("las.points:open_las", 0.25, True, needs_library=True, knows_noise=True),
        None,
        _LAS,
    ),
    Format(
        (".e57",),
        PointReader("e57.points:open_e57", 1, states_count=True, needs_library=True),
        None,
        PointWriter(
            "e57.writer:write_e57",
            ("crs",),
            choose_attributes=lambda _: ("intensity",),
            holds_crs=_is_wkt,
            holds_unit=lambda unit, _: unit == "m",
        ),
    ),
    Format(
        (".obj",),
        PointReader("points.mesh_points:open_obj", 8),
        MeshReader("meshes.obj:read_obj", "meshes.obj:holds_obj_faces"),
        None,
        MeshWriter(
            "meshes.obj:write_obj",
            True,
            True,
            is_near=True,
            textures=True,
            texture_files="meshes.mtl:name_texture_files",
        ),
    ),
    Format(
        (".off",),
        PointReader("points.mesh_points:open_off", 6),
        MeshReader("meshes.off:read_off"),
        None,
        MeshWriter("meshes.off:write_off"),
    ),
    Format(
        (".stl",),
        PointReader("points.mesh_points:open_stl", 8),
        MeshReader("meshes.stl:read_stl"),
        None,
        MeshWriter("meshes.stl:write_stl", is_near=True, is_bare=True),
    ),
    Format((".vtk",), PointReader("points.vtk:open_vtk", 6)),
    Format((".pcd",), PointReader("pcd.points:open_pcd", 3, states_count=True)),
    Format((".npy",), _NUMPY),
    Format((".bin",), PointReader("numpy_files.kitti:open_kitti", 16)),
    Format((".npz",), _NUMPY, None, PointWriter("numpy_files.writer:write_npz_points")),
    Format(
        (".glb",),
        None,
        MeshReader("glb.reader:read_glb", finds_up="glb.reader:find_glb_up"),
        None,
        MeshWriter(
            "glb.writer:write_glb", True, True, True, is_near=True, turns=True, textures=True
        ),
    ),
    Format(
        (".vtp",),
        None,
        MeshReader("meshes.vtp_reader:read_vtp"),
        None,
        MeshWriter("meshes.vtp:write_vtp", normals=True, colours=True, attributes=True),
    ),
    Format(
        (".3mf",), mesh_writer=MeshWriter("meshes.threemf:write_3mf", colours=True, is_near=True)
    ),
    Format(
        (".3dtiles",),
        mesh_writer=MeshWriter(
            "meshes.tileset:write_tileset", True, True, True, makes_folder=True, turns=True
        ),
    ),
    Format(
        (TILES_SUFFIX,),
        mesh_writer=MeshWriter("meshes.tiles:write_tile", False, True, True, makes_folder=True),
    ),
)
"""In the order in which messages name their suffixes."""


def list_suffixes(has_role: Callable[[Format], object]) -> tuple[str, ...]:
    """Return the suffixes of the formats that have a role."""
    return tuple(suffix for one in FORMATS if has_role(one) for suffix in one.suffixes)


def find_point_reader(path: Path) -> PointReader:
    """Return what opens the points of a file; UsageError where its suffix is unknown."""
    return _find(path, lambda one: one.point_reader, UsageError, "a point cloud is read from")


def find_mesh_reader(path: Path) -> MeshReader:
    """Return what reads the mesh of a file; UsageError where its suffix is unknown."""
    return _find(path, lambda one: one.mesh_reader, UsageError, "a mesh is read from")


def find_point_writer(path: Path) -> PointWriter:
    """Return what writes points to a file; OutputError where its suffix is unknown."""
    return _find(path, lambda one: one.point_writer, OutputError, "a point cloud is written to")


def find_mesh_writer(path: Path) -> MeshWriter:
    """Return what writes a mesh to a file; OutputError where its suffix is unknown."""
    return _find(path, lambda one: one.mesh_writer, OutputError, "a mesh is written to")


def _find(
    path: Path, role: Callable[[Format], Role | None], error: type[UsageError], sentence: str
) -> Role:
    """Return what a file's format has, by its suffix in any case."""
    suffix = path.suffix.lower()
    found = next((role(one) for one in FORMATS if suffix in one.suffixes), None)
    if found is None:
        named = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise error(f"{path}: {named}", f"{sentence} {', '.join(list_suffixes(role))}")
    return found
