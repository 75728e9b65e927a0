"""The command ``hpcapp VERB``: finds the verb; an error becomes one line and an exit code.

Verbs are click commands registered as entry points ``hpc.commands``; a verb's module is imported
when it is used, and heavy libraries only inside it, so that the command starts quickly.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sys
from importlib import import_module
from typing import NoReturn

import click

from hpcapp.interrupts import EXIT_INTERRUPTED, obey_signals
from hpccomponent.cli.option_names import speaking_flags
from hpccomponent.cli.terminal import echo, write_block
from hpccomponent.cli.verb import COMMON
from hpccomponent.cli.verbosity import Verbosity, set_verbosity
from hpccomponent.errors import ConfigError, HpcError
from hpccomponent.posix import ADVICE, MODULES
from hpccomponent.runtime.garbage_collection import rare_collections

# The verbs that ship; named here so that finding them costs no search through installed packages.
SHIPPED = {
    "reconstruct": "hpcapp.applications.surface.cli.command:reconstruct",
    "simulate": "hpcapp.lab.simulate.command:simulate",
    "align": "hpcapp.alignment.command:align",
    "info": "hpcapp.applications.points.command:info",
    "convert": "hpcapp.applications.points.command:convert",
    "mend": "hpcapp.mending.command:mend",
    "simplify": "hpcapp.simplification.command:simplify",
    "view": "hpcapp.applications.view.command:view",
    "heights": "hpcapp.applications.heights.command:heights",
    "section": "hpcapp.applications.section.command:section",
    "compare": "hpcapp.applications.compare.command:compare",
    "reproduce": "hpcapp.lab.reproduce.command:reproduce",
}
EXIT_FAILED, EXIT_USAGE = 1, 2
# The verbs as help shows them; those of a plug-in come last.
SECTIONS = {
    "Mesh": ("reconstruct", "align", "mend", "simplify", "convert", "heights", "section"),
    "Look": ("info", "view", "compare"),
    "Clusters": (
        "init", "validate", "plan", "doctor", "up", "status", "ls", "scale", "ssh", "exec", "put",
        "get", "adopt", "down", "reap",
    ),
    "Jobs on a cluster": ("submit", "jobs", "logs", "attach", "cancel", "fetch"),
    "Paper and lab": ("simulate", "reproduce", "quadrature"),
}  # fmt: skip
OTHERS = "Others"


class Verbs(click.Group):
    """A group whose commands are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all verbs, as help shows them."""
        return [name for names in self.list_sections(ctx).values() for name in names]

    def list_sections(self, ctx: click.Context) -> dict[str, list[str]]:
        """Return the names of all verbs below their headings."""
        del ctx
        from importlib.metadata import entry_points  # 20 ms that a shipped verb can save

        installed = {*SHIPPED, *(entry.name for entry in entry_points(group="hpc.commands"))}
        sections = {
            title: [name for name in names if name in installed]
            for title, names in SECTIONS.items()
        }
        sections[OTHERS] = sorted(installed.difference(*sections.values()))
        return sections

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs, section by section, in columns of one width."""
        sections = self.list_sections(ctx)
        width = max(map(len, self.list_commands(ctx)))
        for title, names in sections.items():
            commands = [(name, self.get_command(ctx, name)) for name in names]
            rows = [
                (f"{name:<{width}}", command.get_short_help_str(formatter.width - width - 6))
                for name, command in commands
                if command is not None and not command.hidden
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Have the logs shown as usual, until an option asks for more or less."""
        set_verbosity(Verbosity.NORMAL)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; name those that are spelled alike where there is none."""
        try:
            return super().resolve_command(ctx, args)
        except click.exceptions.NoSuchCommand as error:
            raise click.exceptions.NoSuchCommand(
                error.command_name, possibilities=self.list_commands(ctx), ctx=ctx
            ) from None

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the verb `cmd_name`; None where there is none."""
        del ctx
        if cmd_name in SHIPPED:
            module, _, attribute = SHIPPED[cmd_name].partition(":")
            command = getattr(import_module(module), attribute)
        else:
            from importlib.metadata import entry_points

            entries = entry_points(group="hpc.commands", name=cmd_name)
            if not entries:
                return None
            command = next(iter(entries)).load()
        assert isinstance(command, click.Command)  # noqa: S101 - a plug-in's own mistake
        return command


def _print_version(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    del param
    if value and not ctx.resilient_parsing:
        from importlib.metadata import version

        from hpccomponent.runtime.numerics import numerics_id  # it imports the kernels

        echo(f"hpcapp {version('hpcapp')} (kernels {numerics_id()})")
        ctx.exit()


@click.group(
    cls=Verbs,
    context_settings={"help_option_names": ["-h", "--help"]},
    subcommand_metavar="VERB [ARGUMENTS]",
)
@click.option("--version", is_flag=True, expose_value=False, is_eager=True,
              callback=_print_version, help="Print the version and leave.")  # fmt: skip
def hpcapp() -> None:
    """Turn point clouds into watertight meshes, on one machine or on many.

    'hpcapp VERB --help' has the options of a verb, and examples.
    """
    from hpccomponent.files.held_folders import remove_killed  # --help needs no such thing

    remove_killed()


hpcapp.params += COMMON


def _report(text: str) -> None:
    """Write one line to stderr, whatever file names and logs the text quotes."""
    _write("hpcapp: " + " | ".join(part for part in text.splitlines() if part))


def _report_error(error: HpcError) -> None:
    """Write an error: a file's mistakes one a line, an excerpt below in a block of its own."""
    if isinstance(error, ConfigError):
        for mistake in str(error).splitlines():
            _report(mistake)
    else:
        _report(str(error))
    if error.excerpt:
        _write(write_block(error.excerpt))


def _write(text: str) -> None:
    with contextlib.suppress(OSError):  # nobody can be told that stderr is full or closed
        echo(text, err=True)


def _fill_closed_descriptors() -> None:
    """Put the null device where the caller closed stdin, stdout or stderr.

    A file or socket opened later would get its number, and be written to in its stead.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, this one
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - for good


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command and leave with its exit code."""
    if arguments is None:  # the process is the command's own, and so are its signals
        arguments = sys.argv[1:]
        obey_signals()
    debug = "--debug" in arguments
    _fill_closed_descriptors()
    with rare_collections():
        code = _run(arguments, debug)
    sys.exit(code)


def _is_interruption(error: BaseException | None) -> bool:
    """Tell whether an error came of an interruption.

    Python up to 3.11 makes a RuntimeError of whatever is raised while a class names its attributes,
    as those of numpy do when it is imported.
    """
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


def _report_interruption() -> int:
    """Say that the command was interrupted; return its exit code."""
    # An interruption that came out of the execution of a string, as of dataclasses, has `python -m`
    # end by SIGINT whoever catches it, until the next such execution.
    exec("")  # noqa: S102
    _report("interrupted")
    return EXIT_INTERRUPTED


def _run(arguments: list[str], debug: bool) -> int:
    """Run the command; return its exit code."""
    try:
        with speaking_flags():
            code = hpcapp.main(arguments, prog_name="hpcapp", standalone_mode=False)
        return code or 0  # what a verb has left with; click catches that itself
    except click.exceptions.NoArgsIsHelpError as error:
        echo(error.format_message(), err=True)
        return EXIT_USAGE
    except click.ClickException as error:
        _report(error.format_message().replace("\n", " "))
        return EXIT_USAGE
    except (KeyboardInterrupt, click.Abort):
        return _report_interruption()
    except HpcError as error:
        if debug:
            logging.getLogger("hpcapp").exception("the error's way:")
        _report_error(error)
        return error.exit_code
    except OSError as error:
        if debug:
            logging.getLogger("hpcapp").exception("the error's way:")
        _report(f"{error.filename or 'the standard output'}: {error.strerror or error}; "
                "make room or choose another place")  # fmt: skip
        return EXIT_FAILED
    except MemoryError:
        _report("out of memory; choose a smaller --grid or a machine with more memory")
        return EXIT_FAILED
    except Exception as error:
        if _is_interruption(error):
            return _report_interruption()
        if isinstance(error, RuntimeError) and "start new thread" in str(error):
            _report("no further thread can be started; raise 'ulimit -u', or use fewer --workers")
            return EXIT_FAILED
        if isinstance(error, ModuleNotFoundError) and error.name in MODULES:
            _report(f"this needs {error.name}, which this system has not; {ADVICE}")
            return EXIT_USAGE
        if debug:
            logging.getLogger("hpcapp").exception("the error's way:")
        _report(f"internal error: {type(error).__name__}: {error}; "
                "please report it with the output of 'hpcapp --debug ...'")  # fmt: skip
        return EXIT_FAILED
