from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hpcapp.applications.compare.command import compare
from hpcapp.applications.points.command import convert, info
from hpcapp.applications.surface.cli.command import reconstruct
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.methods.options import WATCHED, option_names
from hpcapp.applications.surface.methods.table import METHODS, find_method
from hpcapp.applications.view.command import view
from hpcapp.io.registry import FORMATS
from hpcapp.lab.simulate.command import simulate
from hpcapp.printing.request import NAMES
from hpccomponent.errors import UsageError


@pytest.mark.parametrize("command", [reconstruct, simulate, info, convert, view, compare])
def test_every_option_is_explained(command: click.Command) -> None:
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.name


def test_every_setting_can_be_typed() -> None:
    typed = {parameter.name for parameter in reconstruct.params}
    own = {name for method in METHODS for name in option_names(find_method(method))}
    settings = JobSettings.__dataclass_fields__.keys() - {"inputs", "command", "crop", "printing"}
    parts = {"box", "around", "polygon", "classes", "not_classes", "ground"}
    assert typed == {*settings, *own, *WATCHED, "as_json", "plan", "sample", *parts, *NAMES}
    assert not own & JobSettings.__dataclass_fields__.keys()


def list_imports(*arguments: str) -> set[str]:
    """Return the modules that a command has imported in the end."""
    script = (
        "import sys; from hpcapp.cli import hpcapp\n"
        "hpcapp.main(sys.argv[1:], standalone_mode=False)\n"
        "print(*sys.modules)"
    )
    command = [sys.executable, "-P", "-c", script, "reconstruct", *arguments]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return set(done.stdout.split())


def test_help_imports_nothing_heavy() -> None:
    assert not {"numpy", "scipy", "zmq", "rich", "yaml"} & list_imports("--help")


def test_a_small_job_with_good_normals_imports_only_what_it_needs(
    sphere_file: Path, tmp_path: Path
) -> None:
    """No scipy, which takes as long as the rest of the program, no other format, no dashboard."""
    imported = list_imports(str(sphere_file), "-o", str(tmp_path / "m.ply"), "--grid", "32")
    assert not imported & {"scipy", "zmq"}
    others = {
        f"hpcapp.io.{role.function.partition(':')[0]}"
        for known in FORMATS
        for role in (known.point_reader, known.mesh_reader, known.point_writer, known.mesh_writer)
        if role is not None and ".ply" not in known.suffixes
    }
    assert not imported & {*others, "hpcapp.io.ply.joined", "hpcapp.dashboard.server"}
    assert not imported & {"xml", "http", "ssl", "email", "zipfile", "gzip", "asyncio", "csv"}
    assert not imported & {"multiprocessing", "urllib.request"}


def test_a_default_is_no_contradiction(sphere_file: Path, tmp_path: Path) -> None:
    arguments = [str(sphere_file), "-o", str(tmp_path / "m.ply"), "--method", "paper"]
    done = CliRunner().invoke(reconstruct, [*arguments, "--patches", "9", "--grid", "16"])
    assert done.exception is None


def test_two_options_of_one_meaning_contradict(sphere_file: Path) -> None:
    arguments = [str(sphere_file), "-o", "-", "--patches", "9", "--delta", "0.1"]
    done = CliRunner().invoke(reconstruct, [*arguments, "--method", "paper"])
    assert isinstance(done.exception, UsageError)
    assert "patches takes the place of delta" in str(done.exception)


def test_attributes_that_make_no_sense_are_refused_before_the_work(sphere_file: Path) -> None:
    arguments = [str(sphere_file), "-o", "mesh.ply", "--attributes", "none,colours"]
    done = CliRunner().invoke(reconstruct, arguments)
    assert isinstance(done.exception, UsageError)
    assert "none excludes all others" in str(done.exception)
