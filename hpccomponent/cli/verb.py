"""A verb of the command: click's command with grouped options, examples, and -v, -q and --debug.

Imported for every ``--help``: nothing heavy is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click

from hpccomponent.cli.named_files import list_files
from hpccomponent.cli.verbosity import Verbosity, set_verbosity
from hpccomponent.files.outputs import check_files
from hpccomponent.ranges import NUMBERS, is_number


def _obey(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        set_verbosity(Verbosity[str(param.name).upper()])


def _flag(names: Sequence[str], words: str) -> click.Option:
    return click.Option(names, is_flag=True, expose_value=False, callback=_obey, help=words)


COMMON = (
    _flag(["-v", "--verbose"], "Say more: all that was logged and decided, with times."),
    _flag(["-q", "--quiet"], "Say nothing but errors and what was asked for."),
    _flag(["--debug"], "Log everything; show the traceback of an error."),
)
"""Options of the command and of each of its verbs; the last that was typed holds."""


def _say_missing(error: click.MissingParameter, ctx: click.Context) -> str:
    """Say which parameter is missing, and what it is to be."""
    missing, problem = error.param, " ".join(error.format_message().split()).rstrip(".")
    is_told = missing is None or missing.type.get_missing_message(missing, ctx)
    if is_told or not isinstance(missing, click.Option | click.Argument):
        return problem
    words = [*missing.opts[:1]] if isinstance(missing, click.Option) else []
    meaning = (missing.help or "").partition(". ")[0].rstrip(".")
    return f"{problem}; give {' '.join([*words, missing.make_metavar(ctx)])}. {meaning}"


class Verb(click.Command):
    """A verb of the command.

    `groups` are headings, and below each the names of parameters in the order in which help shows
    them; `examples` are commands that can be typed, and what each does.
    """

    def __init__(
        self,
        name: str | None,
        *,
        callback: Callable[..., Any] | None = None,
        params: list[click.Parameter] | None = None,
        help: str | None = None,  # noqa: A002 - as click calls it
        context_settings: dict[str, Any] | None = None,
        groups: Mapping[str, Sequence[str]] | None = None,
        examples: Sequence[tuple[str, str]] = (),
    ) -> None:
        super().__init__(name, context_settings, callback, params, help)
        self.groups = groups or {}
        self.examples = examples

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the verb's own parameters, and the common ones.

        A verb that passes options on to another program leaves these to it.
        """
        own = super().get_params(ctx)
        passes_on = self.context_settings.get("ignore_unknown_options")
        return own if passes_on else [*own[:-1], *COMMON, own[-1]]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what was typed; no option takes NaN, infinity, or what is beyond `is_number`."""
        try:
            rest = super().parse_args(ctx, args)
        except click.MissingParameter as error:
            raise click.UsageError(_say_missing(error, ctx), ctx) from None
        for parameter in self.params:
            value = ctx.params.get(parameter.name or "")
            if not is_number(value):
                raise click.BadParameter(f"give {NUMBERS}", ctx, parameter)
        return rest

    def invoke(self, ctx: click.Context) -> Any:
        """Run it, once all files of the call are known to be safe."""
        check_files(*list_files(ctx))
        return super().invoke(ctx)

    def group_options(self, ctx: click.Context) -> dict[str, list[click.Option]]:
        """Return the options below their headings, the common ones last."""
        shown = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        common = [option for option in shown if option in (*COMMON, shown[-1])]  # help is the last
        options = {option.name: option for option in shown if option not in common}
        grouped = {
            title: [options.pop(name) for name in names] for title, names in self.groups.items()
        }
        grouped["Other options" if grouped else "Options"] = list(options.values())
        grouped["Common to all verbs"] = common
        return {title: below for title, below in grouped.items() if below}

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, group by group."""
        for title, options in self.group_options(ctx).items():
            with formatter.section(title):
                records = (option.get_help_record(ctx) for option in options)
                formatter.write_dl([record for record in records if record is not None])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        del ctx
        if not self.examples:
            return
        with formatter.section("Examples"):
            for command, meaning in self.examples:
                formatter.write(f"{'':{formatter.current_indent}}{command}\n")
                with formatter.indentation():
                    formatter.write_text(meaning)
