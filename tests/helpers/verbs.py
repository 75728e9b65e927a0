"""Verbs of the command, run in this process."""

from __future__ import annotations

import click
from click.testing import CliRunner


def run_verb(verb: click.Command, *words: object) -> str:
    """Run a verb, which must do what it is asked for, and return what it prints."""
    done = CliRunner().invoke(verb, list(map(str, words)), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout
