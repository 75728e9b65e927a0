"""Every parameter that names a file says whether it is read or written, and no call loses one."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from itertools import combinations, product
from pathlib import Path

import click
import pytest

from hpcapp.applications.surface.job.settings import GridSize
from hpcapp.cli import hpcapp
from hpccomponent.cli.named_files import InputFile, OutputFile, PrintedFlag
from hpccomponent.files.outputs import Role

Run = Callable[..., tuple[int, str, str]]

ROOT = click.Context(hpcapp, info_name="hpcapp")
PARAMETERS = [
    (name, parameter)
    for name in hpcapp.list_commands(ROOT)
    if (verb := hpcapp.get_command(ROOT, name)) is not None
    for parameter in verb.params
]
NUMBERS = (click.types.IntParamType, click.types.FloatParamType, click.types.BoolParamType)
KNOWN = (InputFile, OutputFile, click.Choice, GridSize, *NUMBERS)
WORDS = {
    "above", "around", "attributes", "backend", "box", "classes", "command", "dashboard", "eye",
    "integrand", "job", "max_memory", "name", "node", "nodes", "not_classes", "options", "origin",
    "plane", "shape", "size", "fill_holes", "trim", "scale", "height", "wall",
}  # fmt: skip
"""Parameters that take text and never the name of a file."""
THERE = {("put", "target"), ("get", "source")}
"""Files of another machine."""
SUFFIXES = {"page": "html", "picture": "png", "mesh": "ply", "points": "ply", "GeoTIFF": "tif",
            "GeoJSON": "json", "drawing": "svg", "table": "csv",
            "poses": "json", "file": "x"}  # fmt: skip


def list_pairs() -> Iterator[tuple[str, click.Parameter, click.Parameter]]:
    """Yield two files of a verb at a time, of which the first is written."""
    for name in hpcapp.list_commands(ROOT):
        named = [one for verb, one in PARAMETERS if verb == name]
        written = [
            one
            for one in named
            if isinstance(one.type, OutputFile) and one.type.role is not Role.SCRATCH
        ]
        read = [one for one in named if isinstance(one.type, InputFile)]
        yield from ((name, *pair) for pair in combinations(written, 2))
        yield from ((name, *pair) for pair in product(written, read))


PAIRS = list(list_pairs())


def name_file(kind: click.ParamType[object], stem: str) -> str:
    return f"{stem}.{SUFFIXES[kind.what] if isinstance(kind, OutputFile) else 'ply'}"


def words_of(name: str, given: dict[str | None, str]) -> list[str]:
    """Return words that give values to some parameters, and to those that must be there."""
    words = [name]
    for verb, parameter in PARAMETERS:
        if verb != name or not (parameter.required or parameter.name in given):
            continue
        value, kind = given.get(parameter.name), parameter.type
        if value is None:
            value = str(kind.choices[0]) if isinstance(kind, click.Choice) else "1"
            if isinstance(kind, InputFile | OutputFile):
                value = name_file(kind, f"its-{parameter.name}")
        is_argument = isinstance(parameter, click.Argument)
        words.append(value if is_argument else f"{parameter.opts[-1]}={value}")
    return words


def test_every_parameter_says_whether_its_file_is_read_or_written() -> None:
    for name, one in PARAMETERS:
        where = f"{name}: {one.name}: declare it InputFile or OutputFile; or it names no file"
        assert isinstance(one.type, KNOWN) or one.name in WORDS or (name, one.name) in THERE, where
        assert one.name != "as_json" or isinstance(one.type, PrintedFlag), where
    assert len(PAIRS) > 60


@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
@pytest.mark.parametrize(
    ("name", "one", "other"), PAIRS, ids=[f"{verb}-{a.name}-{b.name}" for verb, a, b in PAIRS]
)
def test_a_file_that_is_named_twice_is_refused_and_stays(
    run: Run,
    tmp_path: Path,
    name: str,
    one: click.Parameter,
    other: click.Parameter,
    link: Callable[[Path, Path], None],
) -> None:
    output, kept = name_file(one.type, "output"), name_file(other.type, "kept")
    (tmp_path / kept).write_text("scan")
    link(tmp_path / output, tmp_path / kept)
    for parameter in (p for verb, p in PARAMETERS if verb == name):
        if isinstance(parameter.type, InputFile):
            (tmp_path / f"its-{parameter.name}.ply").write_text("others")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    code, _, err = run(*words_of(name, {one.name: output, other.name: kept}))
    [line] = [line for line in err.splitlines() if line.startswith("hpcapp: ")]
    assert any(
        words in line for words in ("is the input itself", "is the file of --", "are one file")
    ), line
    assert code == 2
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("words", "lost"),
    [
        ("reconstruct {} -o a.obj --texture 256 --faces 99", "a.mtl"),
        ("reconstruct {} -o a.obj --texture 256 --faces 99", "a_colours.png"),
        ("reconstruct in.ply -o a.ply --polygon {}", "a.ply.origin.json"),
        ("reconstruct in.ply -o a.tiles --viewpoint {}", "a.tiles.origin.json"),
        ("convert in.ply -o b.ply --rejected c.xyz --polygon {}", "c.xyz"),
        ("simplify in.ply -o a.glb --polygon {} --faces 99", "a.glb.origin.json"),
        ("mend {} -o a.stl --pieces 1", "a.stl.origin.json"),
        ("view in.ply --report {} -o a.html", "a.html"),
        ("heights {} -o a.tif --contours in.glb.origin.json --interval 1", "in.glb"),
        ("reproduce fig2 {} --out .", "fig2.md"),
        ("reproduce fig7-8 {} --out .", "fig8.png"),
    ],
)
def test_what_lies_beside_an_output_or_an_input_counts(
    run: Run, tmp_path: Path, words: str, lost: str
) -> None:
    for name in ("in.ply", "in.glb.origin.json", lost):
        (tmp_path / name).write_text("scan")
    is_input = "contours" in words
    given = tmp_path / (lost if is_input else "link.ply")
    if not is_input:
        given.symlink_to(lost)
    code, _, err = run(*words.format(given.name).split())
    assert code == 2, err
    assert "is the input itself" in err or "is the file of --" in err
    assert (tmp_path / lost).read_text() == "scan"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("convert in.ply -o - --rejected -", "both want the standard output"),
        ("reconstruct in.ply -o - --json", "-o - and --json both want the standard output"),
        ("reconstruct in.ply -o a.ply --json --trace /dev/stdout", "both want the standard output"),
        ("reconstruct in.ply -o a.tiles --events a.tiles/e", "--events a.tiles/e lies in -o"),
        ("reconstruct in.ply -o a.tiles --temp-dir ./a.tiles/tmp", "lies in -o a.tiles"),
        ("reconstruct in.ply -o a.ply --temp-dir a.ply", "are one file"),
        ("reconstruct in.ply -o a.obj --trace A.OBJ", "are one file"),
        ("simulate --scene yard -o a.xyz -n 99", "beside -o, a_truth.ply: is not a file"),
        ("convert in.ply -o a.ply --rejected b.foo", "b.foo: suffix '.foo'; a point cloud is"),
        ("convert in.ply -o a.ply --rejected folder.ply", "folder.ply: is not a file"),
        ("reconstruct in.ply -o b.ply", "beside -o, b.ply.origin.json: is not a file"),
        ("reconstruct in.ply -o - --size 0", "no mesh fits"),
        ("simplify in.ply -o a.ply --size 0", "no mesh fits"),
        ("reconstruct in.ply --trace -", "give -o MESH. Mesh to write: .ply"),
        ("reconstruct in.ply -o a.ply --trace -", "--trace - names no file"),
        ("convert -o a.ply", "give POINTS"),
    ],
)
def test_what_cannot_be_is_refused_at_once(run: Run, tmp_path: Path, words: str, said: str) -> None:
    (tmp_path / "in.ply").write_text("scan")
    for folder in ("folder.ply", "a_truth.ply", "b.ply.origin.json"):
        (tmp_path / folder).mkdir()
    before = sorted(os.listdir(tmp_path))
    code, _, err = run(*words.split())
    assert (code, len(err.splitlines())) == (2, 1), err
    assert said in err
    assert sorted(os.listdir(tmp_path)) == before


def test_the_standard_streams_count_as_the_files_that_they_are(
    start_command: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    text = "1 2 3\n4 5 6\n7 8 10\n" * 9
    (tmp_path / "in.xyz").write_text(text)
    for words, stream in (("- -o in.xyz", "stdin"), ("in.xyz -o -", "stdout")):
        with (
            (tmp_path / "in.xyz").open("r+b") as file,
            start_command("convert", *words.split(), **{stream: file}) as process,
        ):
            _, err = process.communicate()
        assert process.returncode == 2
        assert "is the input itself" in err
        assert (tmp_path / "in.xyz").read_text() == text
