"""NaN, infinity and what no length can be are no numbers, in whatever way a user gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from inspect import signature
from math import inf, nan
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import hpcapp
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.job.settings import Settings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.cli import hpcapp as command
from hpcapp.lab.simulate.raw.scan import RawSettings
from hpccomponent.cli.verb import Verb
from hpccomponent.errors import UsageError

Run = Callable[..., tuple[int, str, str]]

ROOT = click.Context(command, info_name="hpcapp")
VERBS = {name: command.get_command(ROOT, name) for name in command.list_commands(ROOT)}
FLOATS = [
    (name, parameter.name)
    for name, verb in VERBS.items()
    if verb is not None
    for parameter in verb.params
    if isinstance(parameter.type, click.types.FloatParamType)
]


def words_of(verb: click.Command, values: Mapping[str | None, str]) -> list[str]:
    """Return words that give values to some parameters, and to those that must be there."""
    words: list[str] = []
    for parameter in verb.params:
        if parameter.name in values or parameter.required:
            value = values.get(parameter.name, "1")
            is_argument = isinstance(parameter, click.Argument)
            words.append(value if is_argument else f"{parameter.opts[-1]}={value}")
    return words


def test_each_verb_holds_to_the_rule() -> None:
    assert all(isinstance(verb, Verb) for verb in VERBS.values())
    assert len(FLOATS) > 20


@pytest.mark.parametrize(("name", "option"), FLOATS)
@pytest.mark.parametrize(
    "value", ["nan", "inf", "NaN", "Infinity", "1e16", "1e300", "1e-17", "5e-324"]
)
def test_no_verb_takes_what_is_not_finite(name: str, option: str, value: str) -> None:
    verb = VERBS[name]
    assert verb is not None
    with pytest.raises(click.BadParameter) as caught:
        verb.make_context(name, words_of(verb, {option: value}))
    assert caught.value.param is not None
    assert caught.value.param.name == option


def test_one_line_says_so(run: Run, tmp_path: Path) -> None:
    for verify in ("nan", "-inf"):
        code, out, err = run("reconstruct", "a.ply", "-o", "b.ply", f"--verify={verify}", "--json")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "--verify" in err
    code, _, err = run("view", "a.ply", "--png", str(tmp_path / "a.png"), "--eye", "30,nan")
    assert code == 2
    assert "--eye" in err
    assert "give a number" in err


@pytest.mark.parametrize("value", [nan, inf, -inf, 1e300, -1e300, 1e-300])
@pytest.mark.parametrize("settings", [Hierarchical, Paper, Settings, RawSettings])
def test_settings_are_finite(settings: type[Any], value: float) -> None:
    numbers = [one.name for one in fields(settings) if str(one.type).startswith(("float", "int"))]
    assert numbers
    for name in numbers:
        with pytest.raises(UsageError, match=name):
            settings(**{name: value})


CALLS: dict[str, Callable[..., object]] = {
    "reconstruct": lambda **given: hpcapp.reconstruct(np.eye(3), **given),
    "simulate": lambda **given: hpcapp.simulate("torus", **given),
    "compare": lambda **given: hpcapp.compare("a.ply", "b.ply", **given),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("value", [nan, inf, 1e300, 1e-300])
def test_python_takes_none_either(name: str, value: float) -> None:
    asked = signature(getattr(hpcapp, name)).parameters.values()
    numbers = [one.name for one in asked if str(one.annotation).startswith(("float", "int"))]
    for number in numbers:
        with pytest.raises(UsageError, match=number):
            CALLS[name](**{number: value})
