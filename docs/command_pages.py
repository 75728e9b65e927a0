"""Makes the pages of the command line from click: the site's, and the one of ``man hpcapp``.

``python docs/command_pages.py`` writes the latter anew, into ``share/man/man1``.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from hpcapp.cli import hpcapp as command_line
from hpccomponent.cli.verb import COMMON, Verb

MAN_PAGE = Path(__file__).parents[1] / "share" / "man" / "man1" / "hpcapp.1"

Rows = Sequence[tuple[str, str]]

EXIT_CODES = (
    (0, "done"),
    (1, "the job failed"),
    (2, "usage or configuration"),
    (3, "bad input"),
    (4, "cloud or provisioning"),
    (130, "interrupted"),
)


@dataclass(frozen=True, slots=True)
class VerbPage:
    """What is to be said of a verb.

    Parameters
    ----------
    paragraphs : tuple of str
        Those that begin with a backspace are tables, whose lines stay as they are.
    groups : dict of str to rows
        Options and what they mean, below their headings; those of every verb are left out.
    """

    name: str
    usage: str
    paragraphs: tuple[str, ...]
    arguments: Rows
    groups: dict[str, Rows]
    examples: Rows


def describe_verbs() -> Iterator[tuple[str, list[VerbPage]]]:
    """Yield each section of the command with its verbs."""
    root = click.Context(command_line, info_name="hpcapp")
    for title, names in command_line.list_sections(root).items():
        verbs = ((name, command_line.get_command(root, name)) for name in names)
        pages = [
            _describe_verb(click.Context(verb, info_name=name, parent=root), verb)
            for name, verb in verbs
            if isinstance(verb, Verb)
        ]
        if pages:
            yield title, pages


def _describe_verb(context: click.Context, verb: Verb) -> VerbPage:
    parameters = verb.get_params(context)
    hidden = {id(option) for option in (*COMMON, parameters[-1])}  # help is the last
    groups = {
        title: [
            record
            for option in options
            if id(option) not in hidden and (record := option.get_help_record(context))
        ]
        for title, options in verb.group_options(context).items()
    }
    return VerbPage(
        name=context.info_name or "",
        usage=context.get_usage().removeprefix("Usage: "),
        paragraphs=tuple(inspect.cleandoc(verb.help or "").split("\n\n")),
        arguments=[
            argument.get_help_record(context)
            for argument in parameters
            if isinstance(argument, click.Argument)
        ],
        groups={title: rows for title, rows in groups.items() if rows},
        examples=verb.examples,
    )


def _describe_common() -> Rows:
    context = click.Context(command_line, info_name="hpcapp")
    return [record for option in COMMON if (record := option.get_help_record(context))]


def describe_commands() -> Iterator[str]:
    """Yield the site's page of the command line."""
    yield "# Command line\n"
    yield "`hpcapp VERB` does the work; `hpcapp VERB --help` says what stands here.\n"
    yield "| exit code | meaning |\n|---|---|"
    yield from (f"| {code} | {meaning} |" for code, meaning in EXIT_CODES)
    yield "\nThese may be given before the verb and, but for `exec`, behind it:\n"
    yield from _define(_describe_common())
    for title, pages in describe_verbs():
        yield f"## {title}\n"
        for page in pages:
            yield from _describe_page(page)


def _describe_page(page: VerbPage) -> Iterator[str]:
    yield f"### {page.name}\n"
    yield f"```text\n{page.usage}\n```\n"
    for paragraph in page.paragraphs:
        if paragraph.startswith("\b"):
            yield f"```text{paragraph[1:]}\n```\n"
        else:
            yield f"{paragraph}\n"
    yield from _define(page.arguments)
    for title, rows in page.groups.items():
        if len(page.groups) > 1:
            yield f"#### {title}\n"
        yield from _define(rows)
    yield "**Examples**\n\n```text"
    yield from (f"{command}\n    {meaning}" for command, meaning in page.examples)
    yield "```\n"


def _define(rows: Rows) -> Iterator[str]:
    for term, meaning in rows:
        yield f"`{term}`\n: {' '.join(meaning.split())}\n"


def describe_man_page() -> Iterator[str]:
    """Yield the lines of ``hpcapp.1``, in the macros of man(7)."""
    yield '.TH HPCAPP 1 "" hpcapp "User commands"'
    yield ".SH NAME\nhpcapp \\- watertight meshes from point clouds"
    yield ".SH SYNOPSIS\n.B hpcapp\n[\\fIOPTIONS\\fR] \\fIVERB\\fR [\\fIARGUMENTS\\fR]"
    yield ".SH OPTIONS\nThese may be given before the verb and, but for exec, behind it."
    yield from _list_terms(_describe_common())
    for title, pages in describe_verbs():
        yield f".SH {_escape(title).upper()}"
        for page in pages:
            yield f".SS {_escape(page.usage.removeprefix('hpcapp '))}"
            for paragraph in page.paragraphs:
                is_table = paragraph.startswith("\b")
                text = _escape(paragraph.strip("\b\n"))
                yield f".PP\n.nf\n{text}\n.fi" if is_table else f".PP\n{text}"
            yield from _list_terms(page.arguments)
            for heading, rows in page.groups.items():
                yield f".PP\n\\fI{_escape(heading)}\\fR"
                yield from _list_terms(rows)
            yield ".PP\n\\fIExamples\\fR"
            yield from _list_terms(page.examples)
    yield ".SH EXIT STATUS"
    yield from _list_terms([(str(code), f"{meaning}.") for code, meaning in EXIT_CODES])


def _list_terms(rows: Rows) -> Iterator[str]:
    for term, meaning in rows:
        yield f".TP\n\\fB{_escape(term)}\\fR\n{_escape(' '.join(meaning.split()))}"


def _escape(text: str) -> str:
    r"""Return text as roff prints it.

    Examples
    --------
    >>> print(_escape(".ply or a\\b --all"))
    \&.ply or a\eb \-\-all
    """
    lines = text.replace("\\", "\\e").replace("-", "\\-").splitlines()
    return "\n".join(f"\\&{line}" if line[:1] in (".", "'") else line for line in lines)


def write_man_page() -> None:
    """Write the manual page."""
    MAN_PAGE.write_text("\n".join(describe_man_page()) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_man_page()
