"""Whatever number an option is given: a result, or one line, and nothing is left behind."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
import pytest
from spheres import make_sphere

import hpcapp
from hpcapp.cli import hpcapp as command
from hpcapp.geometry.points import PointCloud

Run = Callable[..., tuple[int, str, str]]

NUMBERS = ["0", "1e-300", "1.2e-16", "9e15", "1e300", "-1", "-1e300", "nan", "inf", "-inf",
           str(2**31), str(10**30)]  # fmt: skip
DOCUMENTED = {0, 1, 2, 3, 4}
WORDS = {"CLUSTER", "FILE", "MESH", "NAME", "NAMES", "PLACE", "POINTS", "[HOST:PORT]"}
"""Metavariables of what is text and no number."""

# What a verb is run with, arguments first; one that is not listed takes no number.
BASES: dict[str, list[tuple[list[str], list[str]]]] = {
    "reconstruct": [
        (["ball.ply"], ["-o", "out.ply"]),
        (["ball.ply"], ["-o", "out.ply", "--method", "paper", "--grid", "16"]),
    ],
    "mend": [(["mesh.ply"], ["-o", "out.ply", "--pieces", "1"])],
    "simplify": [(["mesh.ply"], ["-o", "out.ply", "--faces", "100"])],
    "convert": [(["ball.ply"], ["-o", "out.xyz"])],
    "heights": [(["ground.ply"], ["-o", "a.tif", "--contours", "a.json", "--interval", "1"])],
    "align": [(["none.ply", "none.xyz"], ["-o", "out.ply"])],
    "info": [(["ball.ply"], [])],
    "view": [(["mesh.ply"], ["--png", "out.png", "--size", "16"])],
    "compare": [
        (["mesh.ply", "ball.ply"], ["--samples", "100"]),
        (["moved.ply", "ground.ply"], ["--volume"]),
        (["mesh.ply", "mesh.ply"], ["--volume"]),
        (
            ["ground.ply"],
            ["--volume", "--above", "rim", "--polygon", "POLYGON ((3 3, 7 3, 7 7, 3 7, 3 3))"],
        ),
    ],
    "section": [
        (["mesh.ply"], ["-o", "out.svg", "--plane", "z", "--step", "0.5"]),
        (["mesh.ply"], ["-o", "out.svg", "--along", "LINESTRING (-2 0, 2 0)", "--step", "1"]),
    ],
    "simulate": [(["--shape", "sphere"], ["-o", "out.ply", "--points", "50"])],
    "quadrature": [(["wave", "0", "1"], ["--tolerance", "1"])],
    "scale": [(["none.yaml", "2"], [])],
    "reproduce": [(["fig2", "none.ply"], [])],
}


def takes_number(parameter: click.Parameter) -> bool:
    """Tell whether a parameter is a number, or text that may be one."""
    if isinstance(parameter, click.Option) and (parameter.is_flag or parameter.count):
        return False
    if isinstance(parameter.type, click.types.IntParamType | click.types.FloatParamType):
        return True
    is_text = isinstance(parameter, click.Option) and type(parameter.type).__name__ in (
        "StringParamType", "GridSize",
    )  # fmt: skip
    return is_text and parameter.metavar not in WORDS


def find_cases() -> list[tuple[str, int, click.Parameter]]:
    """Return each number that each verb takes, and by which base it is tried."""
    root = click.Context(command)
    verbs = {name: command.get_command(root, name) for name in command.list_commands(root)}
    return [
        (name, base, parameter)
        for name, verb in verbs.items()
        for parameter in getattr(verb, "params", [])
        if takes_number(parameter)
        for base in range(len(BASES.get(name, [()])))
    ]


def write_words(verb: str, base: int, parameter: click.Parameter, number: str) -> list[str]:
    """Return a command in which a parameter is a number; of several, the first ones are 0."""
    arguments, options = BASES[verb][base]
    if isinstance(parameter, click.Argument):
        holder = command.get_command(click.Context(command), verb)
        assert holder is not None
        names = [one.name for one in holder.params if isinstance(one, click.Argument)]
        at = names.index(parameter.name)
        return [verb, *options, "--", *arguments[:at], number, *arguments[at + 1 :]]
    count = 1 + (parameter.metavar or "").count(",")
    text = ",".join(["0"] * (count // 2) + [number] * (count - count // 2))
    return [verb, *arguments, *options, f"{parameter.opts[-1]}={text}"]


CASES = find_cases()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball of points, its mesh, and ground twice."""
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(3)
    hpcapp.write_points(folder / "ball.ply", make_sphere(300))
    hpcapp.reconstruct(folder / "ball.ply", grid=16).save(folder / "mesh.ply")
    places = np.column_stack([rng.random((2000, 2)) * 10.0, rng.normal(scale=0.01, size=2000)])
    up = np.tile([0.0, 0.0, 1.0], (2000, 1))
    hpcapp.write_points(folder / "ground.ply", PointCloud(places, up))
    hpcapp.write_points(folder / "moved.ply", PointCloud(places + np.array([0.0, 0.0, 0.3])))
    return folder


@pytest.fixture
def folder(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The inputs, and a folder for temporary files."""
    for path in inputs.iterdir():
        os.link(path, tmp_path / path.name)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    return tmp_path


@pytest.mark.parametrize("verb", sorted({verb for verb, _, _ in CASES}))
def test_each_verb_with_numbers_is_tried(run: Run, folder: Path, verb: str) -> None:
    assert verb in BASES, "add what it is run with"
    for arguments, options in BASES[verb]:
        code, _, said = run(verb, *arguments, *options)
        is_there = not any(word.startswith("none") for word in arguments)
        assert code == 0 or not is_there, said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "base", "parameter"), CASES, ids=[f"{v} {b} {p.opts[-1]}" for v, b, p in CASES]
)
def test_any_number_is_a_result_or_one_line(
    run: Run, folder: Path, verb: str, base: int, parameter: click.Parameter
) -> None:
    there = set(folder.rglob("*"))
    for number in NUMBERS:
        words = write_words(verb, base, parameter, number)
        code, _, said = run(*words)
        made = set(folder.rglob("*")) - there
        assert code in DOCUMENTED, words
        for never in ("internal error", "Traceback", "out of memory"):
            assert never not in said, (words, said)
        assert not (code and made), (words, said)
        for path in made:
            path.unlink()
