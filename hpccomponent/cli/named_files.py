"""Options and arguments that name a file, by their click types: what a verb reads and writes.

Each says which it is, so that `Verb` knows all files of a call before it begins, and asks
`check_files`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import click
from click.types import BoolParamType

from hpccomponent.errors import OutputError
from hpccomponent.files.outputs import STANDARD_INPUT, STANDARD_OUTPUT, Read, Role, Written
from hpccomponent.files.paths import expand_pattern

Lister: TypeAlias = "Callable[[str, str, Mapping[str, Any]], Iterable[Written]]"
"""Lists all that comes of an output: of its name, the option, and all parameters of the call."""

Decorator: TypeAlias = "Callable[[Callable[..., Any]], Callable[..., Any]]"

_ADVICE = "name a file to write to"


class InputFile(click.Path):
    """A file that is read; of several, a pattern, and - is the standard input.

    `beside` names what else is read for it. With `is_word` it may be a folder, or a word that names
    no file; `path_type` is str where it need not name a file.
    """

    def __init__(
        self,
        beside: Callable[[Path], Iterable[Path]] | None = None,
        *,
        is_word: bool = False,
        exists: bool = False,
        path_type: type[Path | str] = Path,
    ) -> None:
        super().__init__(exists=exists, dir_okay=is_word, path_type=path_type)
        self._beside = beside

    def list_read(self, value: str | Path, option: str) -> Iterator[Read]:
        """Yield what is read for a value; there need be nothing."""
        name = os.fspath(value)
        for path in map(Path, expand_pattern("/dev/stdin" if name in STANDARD_INPUT else name)):
            yield Read(path, option)
            if self._beside is not None:
                yield from (Read(other, option) for other in self._beside(path))


class OutputFile(click.Path):
    """A file that is written, with `suffixes`, a role and a word for `what` it is, as of `Written`.

    `lists` lists all that comes of a value, by default the one file; `printed` are names of the
    standard output that it may have.
    """

    def __init__(
        self,
        what: str = "file",
        suffixes: tuple[str, ...] = (),
        role: Role = Role.FILE,
        *,
        lists: Lister | None = None,
        printed: tuple[str, ...] = (),
        path_type: type[Path | str] = Path,
    ) -> None:
        super().__init__(path_type=path_type)
        self.name = "file"  # in help
        self.what = what
        self._suffixes = suffixes
        self.role = role
        self._lists = lists
        self._printed = printed

    def list_written(
        self,
        value: str | PathLike[str],
        option: str = "",
        params: Mapping[str, Any] | None = None,
    ) -> Iterator[Written]:
        """Yield what is written for a value; raise OutputError where it names no file."""
        name = os.fspath(value)
        if name in self._printed:
            yield _print_by(f"{option} {name}")
            return
        if self._printed and name in STANDARD_OUTPUT[1:]:
            raise OutputError(f"{name} cannot be replaced", f"give {option} - for a PLY there")
        is_folder_name = self.role is Role.FILE and name.endswith("/")
        if name in ("", "-") or is_folder_name:
            raise OutputError(f"{option} {name or repr(name)} names no file", _ADVICE)
        if self._lists is not None:
            yield from self._lists(name, option, params or {})
        else:
            yield Written(Path(name), option, self.role, self._suffixes, self.what)


STREAM = OutputFile(role=Role.STREAM, printed=STANDARD_OUTPUT[1:])
"""A file that is written as it comes; it may be a pipe, or a device."""


class PrintedFlag(BoolParamType):
    """A flag that has a verb print what another program reads on the standard output."""


def json_option(what: str = "Print one JSON object on standard output.") -> Decorator:
    """Return the option ``--json``."""
    return click.option("--json", "as_json", is_flag=True, type=PrintedFlag(), help=what)


def list_files(ctx: click.Context) -> tuple[list[Written], list[Read]]:
    """Return what a call of a verb writes and reads; OutputError where an output names no file."""
    written: list[Written] = []
    read: list[Read] = []
    for parameter in ctx.command.params:
        kind, value = parameter.type, ctx.params.get(parameter.name or "")
        option = parameter.opts[0] if isinstance(parameter, click.Option) else ""
        for one in value if isinstance(value, tuple) else (value,):
            if one is None or one is False:
                continue
            if isinstance(kind, InputFile):
                read += kind.list_read(one, option)
            elif isinstance(kind, OutputFile):
                shown = option or parameter.human_readable_name
                written += kind.list_written(one, shown, ctx.params)
            elif isinstance(kind, PrintedFlag):
                written.append(_print_by(option))
    return written, read


def _print_by(words: str) -> Written:
    return Written(Path(STANDARD_OUTPUT[1]), words, Role.PRINTED)
