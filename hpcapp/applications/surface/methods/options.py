"""Options of a method: each stands once, in the method's settings.

A field made by `option` carries its range and its help; the command makes its options of these
fields, and `check_options` holds values from Python to the same ranges. Nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import Field, field, fields
from math import inf
from types import NoneType, UnionType
from typing import Any, ClassVar, Protocol, get_args, get_type_hints

import click

from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.ranges import check_range

_KEY = "option"
_METAVARS = {int: "N", float: "F", str: "LENGTH"}


class Options(Protocol):
    """A frozen dataclass of options."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


@dataclass(frozen=True, slots=True)
class _Option:
    """What an option may be, and what it is for."""

    help: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    replaces: tuple[str, ...]


def option(
    default: Any,
    help: str,  # noqa: A002 - as click calls it
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    replaces: tuple[str, ...] = (),
) -> Any:
    """Return a dataclass field that is an option, with one sentence of help.

    The default is None where it may be left out; `low` and `high` belong to its range. `choices`
    are the words that may be given, and `replaces` names options that it takes the place of, so
    that they exclude each other.
    """
    return field(default=default, metadata={_KEY: _Option(help, low, high, choices, replaces)})


def option_names(settings: type[Options]) -> tuple[str, ...]:
    """Return the names of a method's options, in the order of its fields."""
    return tuple(one.name for one in fields(settings))


def check_options(settings: Options) -> None:
    """Hold the options of a method to their ranges.

    Raises UsageError where one is beyond its range, none of the words that may be given, or stands
    beside one that it takes the place of.
    """
    defaults = {one.name: one.default for one in fields(settings)}
    check_exclusive(
        type(settings), {name for name in defaults if getattr(settings, name) != defaults[name]}
    )
    for name, asked, kind in _options(type(settings)):
        value = getattr(settings, name)
        if value is None:
            continue
        if asked.choices and value not in asked.choices:
            raise UsageError(f"{name} is {value!r}", f"choose {' or '.join(asked.choices)}")
        if kind in (int, float):
            check_range(
                name,
                value,
                -inf if asked.low is None else asked.low,
                inf if asked.high is None else asked.high,
            )


def check_exclusive(settings: type[Options], given: set[str]) -> None:
    """Raise UsageError where two of the options that somebody gave exclude each other."""
    for name, asked, _ in _options(settings):
        for other in asked.replaces:
            if name in given and other in given:
                raise UsageError(
                    f"{name_option(name)} takes the place of {name_option(other)}, so they exclude "
                    "each other",
                    "give one of them",
                )


def make_click_options(settings: type[Options]) -> Iterator[click.Option]:
    """Make the command line's options of a method's settings."""
    for name, asked, kind in _options(settings):
        default = settings.__dataclass_fields__[name].default
        flag = "--" + name.replace("_", "-")
        yield click.Option(
            [f"{flag}/--no-{flag[2:]}" if kind is bool else flag],
            type=_click_type(asked, kind),
            default=default,
            show_default=default is not None,
            metavar=None if asked.choices or kind is bool else _METAVARS[kind],
            help=asked.help,
        )


def typed_options(ctx: click.Context, without: Collection[str]) -> list[str]:
    """Return the typed options as words to be typed again, but for those named in `without`."""
    words: list[str] = []
    for parameter in ctx.command.params:
        name = parameter.name or ""
        is_typed = ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if not is_typed or name in without or not parameter.expose_value:
            continue
        value = ctx.params[name]
        if isinstance(parameter, click.Option) and parameter.multiple:
            for one in value:
                words += [parameter.opts[-1], str(one)]
        elif value is False:
            words.append(parameter.secondary_opts[0])
        else:
            words += [parameter.opts[-1]] if value is True else [parameter.opts[-1], str(value)]
    return words


WATCHED = ("events", "trace", "dashboard")
"""Options by which a job is watched."""


def typed_command(ctx: click.Context) -> tuple[str, ...]:
    """Return the command to be typed again for the same mesh, but for what is written beside it."""
    words = typed_options(ctx, ("points", "report", "png", *WATCHED, "as_json", "details"))
    return ("hpcapp", ctx.command.name or "", *ctx.params["points"], *words)


def _click_type(
    asked: _Option, kind: type
) -> click.Choice[str] | click.IntRange | click.FloatRange | type[str] | None:
    if kind is bool:
        return None
    if asked.choices:
        return click.Choice(asked.choices)
    if kind is str:
        return str
    if kind is int:
        return click.IntRange(
            None if asked.low is None else int(asked.low),
            None if asked.high is None else int(asked.high),
        )
    return click.FloatRange(asked.low, asked.high)


def _options(settings: type[Options]) -> Iterator[tuple[str, _Option, type]]:
    """Yield name, description and type of each option."""
    # Users know some settings as of the module hpcapp, which has no such name.
    hints = get_type_hints(settings, localns={"ClassVar": ClassVar})
    for one in fields(settings):
        hint = hints[one.name]
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        [kind] = [kind for kind in kinds if kind is not NoneType]
        yield one.name, one.metadata[_KEY], kind
