"""The pages of the command line: the site's, the manual page, and what completes it in a shell."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from command_pages import MAN_PAGE, describe_commands, describe_man_page

from hpcapp.cli import hpcapp

COMPLETION = MAN_PAGE.parents[2] / "bash-completion" / "completions" / "hpcapp"


def test_the_manual_page_is_that_of_this_command() -> None:
    assert (
        MAN_PAGE.read_text(encoding="utf-8").splitlines()
        == "\n".join(describe_man_page()).splitlines()
    ), "write it anew: python docs/command_pages.py"


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_the_manual_page_has_no_mistake() -> None:
    done = subprocess.run(
        ["man", "--warnings", "-l", str(MAN_PAGE)],
        env={**os.environ, "LC_ALL": "C.UTF-8", "MANWIDTH": "100", "MANPAGER": "cat"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert "--voxel-size S" in done.stdout


def test_the_page_of_the_site_has_every_verb_with_all_that_can_be_typed() -> None:
    page = "\n".join(describe_commands())
    root = click.Context(hpcapp, info_name="hpcapp")
    for name in hpcapp.list_commands(root):
        verb = hpcapp.get_command(root, name)
        assert verb is not None
        section = page.partition(f"\n### {name}\n")[2].partition("\n### ")[0]
        for parameter in verb.params:
            if isinstance(parameter, click.Option):
                assert all(flag in section for flag in parameter.opts)
            else:
                assert f"\n`{parameter.make_metavar(root)}`\n: " in section
        assert f"\nhpcapp {name} " in section.partition("**Examples**")[2]
    assert "\b" not in page


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("hpcapp recon", ["reconstruct"]),
        ("hpcapp reconstruct --vie", ["--viewpoint"]),
        ("hpcapp simulate --shape kn", ["knot"]),
        ("hpcapp reconstruct --close ", ["auto", "yes", "no"]),
    ],
)
def test_bash_completes(typed: str, completed: list[str]) -> None:
    script = (
        f"source '{COMPLETION}'; IFS=' '; COMP_WORDS=({typed.rstrip()}); words=\"$1\"\n"
        '[[ "$words" == *" " ]] && COMP_WORDS+=("")\n'
        "COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _hpcapp_completion hpcapp\n"
        "printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        ["bash", "-c", script, "bash", typed],
        env={**os.environ, "PATH": programs},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == completed
