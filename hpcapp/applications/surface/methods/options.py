"""Options of the command: each stands once, in a field of the settings that it is for.

A field made by `option` carries its range, its help and where help shows it; the command makes its
options of these fields, and `check_options` holds values from Python to the same ranges. Nothing
heavy is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import MISSING, Field, field, fields
from functools import cache
from math import inf
from numbers import Integral
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
class Option:
    """What an option may be, what it is for, and how it is typed; see `option`."""

    help: str
    low: float | None = None
    high: float | None = None
    is_open: bool = False
    choices: tuple[str, ...] = ()
    replaces: tuple[str, ...] = ()
    group: str = ""
    kind: click.ParamType[Any] | None = None
    metavar: str | None = None
    typed: Any = None
    parse: Callable[[Any], Any] | None = None
    words: tuple[str, ...] = ()
    multiple: bool = False


def option(
    default: Any,
    help: str,  # noqa: A002 - as click calls it
    **asked: Any,
) -> Any:
    """Return a dataclass field that is an option, with one sentence of help; others are `Option`'s.

    The default is None where it may be left out, MISSING where it must be given; `low` and `high`
    belong to its range, but `low` where `is_open`. `choices` are the words that may be given, and
    `replaces` names options that it takes the place of, so that they exclude each other. `group` is
    the heading of help that it stands below. What is typed is of the `kind` of click, by default
    told by the field's type, is `typed` where nothing is, and becomes the field's value by `parse`.
    `words` are how it is typed, where its name does not say so.
    """
    return field(default=default, metadata={_KEY: Option(help, **asked)})


def option_names(settings: type[Options]) -> tuple[str, ...]:
    """Return the names of the options, in the order of the fields."""
    return tuple(one.name for one in fields(settings) if _KEY in one.metadata)


def check_options(settings: Options) -> None:
    """Hold options to their ranges.

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
        if kind is int and not isinstance(value, Integral):
            raise UsageError(f"{name} is {value!r}", "give a whole number")
        if kind in (int, float):
            check_range(
                name,
                value,
                -inf if asked.low is None else asked.low,
                inf if asked.high is None else asked.high,
                is_open=asked.is_open,
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
    """Make the command line's options of settings."""
    for name, asked, kind in _options(settings):
        default = settings.__dataclass_fields__[name].default
        typed = default if asked.typed is None and not asked.multiple else asked.typed
        flag = "--" + name.replace("_", "-")
        words, is_switch = [flag], kind is bool and bool(asked.words)
        if asked.words:
            words = [*asked.words, name]
        elif kind is bool:
            words = [f"{flag}/--no-{flag[2:]}"]
        is_plain = asked.kind is None and not asked.choices and kind in _METAVARS
        yield click.Option(
            words,
            required=default is MISSING,
            is_flag=True if kind is bool else None,
            multiple=asked.multiple,
            type=asked.kind or _click_type(asked, kind),
            show_default=not is_switch and typed not in (None, MISSING),
            metavar=asked.metavar or (_METAVARS[kind] if is_plain else None),
            help=asked.help,
            **({} if typed in (None, MISSING) else {"default": typed}),
        )


def group_options(settings: type[Options], other: str) -> Iterator[tuple[str, str]]:
    """Yield the heading of help that each option stands below, or another, and its name."""
    for name, asked, _ in _options(settings):
        yield asked.group or other, name


def parse_typed(settings: type[Options], typed: dict[str, Any]) -> dict[str, Any]:
    """Return values of fields for what was typed, with all else that is there.

    UsageError, or InputError of a file, where something means nothing.
    """
    parsers = {name: asked.parse for name, asked, _ in _options(settings) if asked.parse}
    return {
        name: parsers[name](value) if name in parsers and value is not None else value
        for name, value in typed.items()
    }


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
    """Return the command to be typed again for the same mesh, page and picture."""
    words = typed_options(ctx, ("points", *WATCHED, "as_json", "details"))
    return ("hpcapp", ctx.command.name or "", *ctx.params["points"], *words)


def _click_type(
    asked: Option, kind: type
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
    return click.FloatRange(asked.low, asked.high, min_open=asked.is_open)


@cache
def _options(settings: type[Options]) -> tuple[tuple[str, Option, type], ...]:
    """Return name, description and type of each option; those that must be given come first."""
    # Users know some settings as of the module hpcapp, which has no such name.
    hints = get_type_hints(settings, localns={"ClassVar": ClassVar})
    found = []
    for one in sorted(fields(settings), key=lambda one: one.default is not MISSING):
        if _KEY in one.metadata:
            hint = hints[one.name]
            kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
            kind, *_ = [kind for kind in kinds if kind is not NoneType]
            found.append((one.name, one.metadata[_KEY], kind))
    return tuple(found)
