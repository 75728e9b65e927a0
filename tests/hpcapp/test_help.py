"""What the command says of itself: its help, its examples, and how much it says beside."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from hpcapp import cli
from hpcapp.cli import OTHERS, SECTIONS, hpcapp
from hpccomponent.cli.verb import COMMON, Verb

Run = Callable[..., tuple[int, str, str]]

ROOT = click.Context(hpcapp, info_name="hpcapp")
VERBS = hpcapp.list_commands(ROOT)


def find_verb(name: str) -> Verb:
    command = hpcapp.get_command(ROOT, name)
    assert isinstance(command, Verb)
    return command


def test_every_verb_stands_below_one_heading() -> None:
    sections = hpcapp.list_sections(ROOT)
    assert not sections.pop(OTHERS)
    assert sections == {title: list(names) for title, names in SECTIONS.items()}
    assert len(set(VERBS)) == len(VERBS)


def test_a_verb_of_a_plug_in_is_listed(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cli.SHIPPED, "measure", "hpcapp.applications.view.command:view")
    assert "\nOthers:\n  measure " in run("--help")[1]


def test_help_fits_into_eighty_columns(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for arguments in ([], *([name] for name in VERBS)):
        code, text, _ = run(*arguments, "--help")
        assert code == 0
        assert max(map(len, text.splitlines())) <= 80, arguments
        assert "..." not in text or arguments, "a summary is cut"


@pytest.mark.parametrize("name", VERBS)
def test_a_verb_explains_all_that_can_be_typed(name: str) -> None:
    for parameter in find_verb(name).get_params(ROOT):
        assert isinstance(parameter, click.Argument | click.Option)
        assert parameter.help, parameter.name


@pytest.mark.parametrize("name", VERBS)
def test_three_examples_can_be_typed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    examples = find_verb(name).examples
    assert len(examples) == 3
    for command, meaning in examples:
        words = shlex.split(command)
        for word in words:
            if "." in word and "/" not in word:  # a file that must be there
                Path(word).touch()
        assert words.pop(0) == "hpcapp"
        if words[0] in ("-q", "-v"):
            words.pop(0)
        assert words.pop(0) == name
        find_verb(name).make_context(name, words, parent=ROOT)
        assert meaning.endswith(".")


@pytest.mark.parametrize("name", VERBS)
def test_each_option_stands_below_one_heading(name: str) -> None:
    grouped = find_verb(name).group_options(ROOT)
    assert "Other options" not in grouped
    shown = [option.name for options in grouped.values() for option in options]
    given = [p.name for p in find_verb(name).get_params(ROOT) if isinstance(p, click.Option)]
    assert sorted(shown) == sorted(given)


def test_ten_options_come_first() -> None:
    title, options = next(iter(find_verb("reconstruct").group_options(ROOT).items()))
    assert (title, len(options)) == ("Most used", 10)


@pytest.mark.parametrize("typed", ["reconstrukt", "recon", "symplify", "quadratur", "staus"])
def test_a_verb_that_is_spelled_alike_is_named(typed: str, run: Run) -> None:
    code, _, err = run(typed)
    assert code == 2
    assert "Did you mean" in err


def test_quiet_and_verbose_hold_before_and_after_the_verb(run: Run, sphere_file: Path) -> None:
    job = (str(sphere_file), "-o", "mesh.ply", "--grid", "16")
    assert run("-q", "reconstruct", *job) == (0, "", "")
    assert run("reconstruct", *job, "-q") == (0, "", "")
    assert run("reconstruct", *job, "-q")[2] == ""
    plain = run("reconstruct", *job)[2]
    assert "read: done" in plain
    assert " s  mesh.ply: " not in plain
    for arguments in (("-v", "reconstruct", *job), ("-q", "reconstruct", *job, "--verbose")):
        said = run(*arguments)[2]
        assert "read: done" in said
        assert " s  mesh.ply: " in said


def test_a_quiet_command_says_its_errors_and_its_results(run: Run, sphere_file: Path) -> None:
    code, out, err = run("-q", "reconstruct", "none.ply", "-o", "mesh.ply")
    assert (code, out) == (3, "")
    assert err.startswith("hpcapp: none.ply")
    assert "points" in run("info", str(sphere_file), "-q")[1]


def test_debug_after_the_verb_shows_the_traceback(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hpcapp", "info", "none.ply"]
    for debug in (["--debug"], []):
        done = subprocess.run(
            [*command, *debug], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 3
        assert ("Traceback" in done.stderr) == bool(debug)


def test_a_verb_that_passes_options_on_keeps_none_of_them() -> None:
    assert not {*COMMON} & {*find_verb("exec").get_params(ROOT)}
    assert {*COMMON} < {*find_verb("up").get_params(ROOT)}


def test_the_help_of_all_verbs_imports_nothing_heavy() -> None:
    script = (
        "import sys; from hpcapp.cli import hpcapp\n"
        "hpcapp.main(['--help'], standalone_mode=False)\n"
        "heavy = {'numpy', 'scipy', 'zmq', 'rich', 'yaml', 'pydantic', 'boto3', 'paramiko'}\n"
        "assert not heavy & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-P", "-c", script], check=True, capture_output=True)
