"""The task registry: names on the wire, functions on the worker, nothing unpickled in between.

A task is an importable, module-level function of values. It is registered as an entry point of
the group ``hpc.tasks``, or by ``NAME=module:function`` on the command line of a component. It
may declare what it costs and how it can be split; a plain function need not.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any, TypeVar

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.protocol.declared import ANYTHING, Declared, Each, EachOf
from hpccomponent.protocol.frames import DEFAULT_RESULT_BYTES

TASK_GROUP = "hpc.tasks"
EACH = "each:"  # before a name: the task is run for each item, its arguments come as columns
_REFERENCE = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<function>[A-Za-z_]\w*)")

Split = Callable[..., Sequence[tuple[Any, ...]] | None]
Join = Callable[[list[Any]], object]
FunctionT = TypeVar("FunctionT", bound=Callable[..., object])


@dataclass(frozen=True, slots=True)
class Traits:
    """What a task declares beside its function; all of it runs in the master.

    Parameters
    ----------
    cost : callable, optional
        From the task's arguments to its work, in any unit that its other calls share; above 0.
        By default every call is as much work.
    split : callable, optional
        From the task's arguments to tuples of arguments that together make the same result, or
        None if it cannot be split.
    join : callable, optional
        From the list of their results to the result; with `split` only.
    result : Declared or callable, optional
        What the result must be (see `hpccomponent.protocol.declared`), or a function from the
        task's arguments to it. By default it may be anything.
    limit : int or callable, optional
        How large the encoded result may be, in bytes, or a function from the arguments to it; by
        default `DEFAULT_RESULT_BYTES`.
    is_verified : bool
        Whether honest machines give the same answer: not where it is about the machine itself.

    Notes
    -----
    A shared value among the arguments is seen as what ``share`` returned.
    """

    cost: Callable[..., float] | None = None
    split: Split | None = None
    join: Join | None = None
    result: Declared | Callable[..., Declared] = ANYTHING
    limit: int | Callable[..., int] = DEFAULT_RESULT_BYTES
    is_verified: bool = True

    def result_of(self, arguments: tuple[object, ...]) -> Declared:
        """Return what the result of one call must be."""
        return self.result(*arguments) if callable(self.result) else self.result

    def limit_of(self, arguments: tuple[object, ...]) -> int:
        """Return how large the encoded result of one call may be, in bytes."""
        return int(self.limit(*arguments)) if callable(self.limit) else self.limit

    def __post_init__(self) -> None:
        if (self.split is None) != (self.join is None):
            raise UsageError(
                "a task declares only one of split and join", "declare both, or neither"
            )


PLAIN = Traits()


def declare(
    cost: Callable[..., float] | None = None,
    split: Split | None = None,
    join: Join | None = None,
    result: Declared | Callable[..., Declared] = ANYTHING,
    limit: int | Callable[..., int] = DEFAULT_RESULT_BYTES,
    is_verified: bool = True,
) -> Callable[[FunctionT], FunctionT]:
    """Declare what a task costs, returns, and how to split it; the function stays what it is.

    Raises
    ------
    UsageError
        Only one of `split` and `join` is given.

    Examples
    --------
    >>> @declare(cost=len)
    ... def count_up(values):
    ...     return [value + 1 for value in values]
    >>> traits_of(count_up).cost([1, 2, 3])
    3
    """
    traits = Traits(cost, split, join, result, limit, is_verified)

    def mark(function: FunctionT) -> FunctionT:
        function.task_traits = traits  # type: ignore[attr-defined]
        return function

    return mark


def traits_of(task: Callable[..., object] | str) -> Traits:
    """Return what a task declares; nothing if only its name is given."""
    traits: Traits = getattr(task, "task_traits", PLAIN)
    return traits


class TaskRegistry:
    """Tasks by name, imported when they are first called.

    `extra` are ``NAME=module:function`` entries, beside the installed ones and before them. Raise
    UsageError where one has another form, or names one task twice with different functions.

    Examples
    --------
    >>> registry = TaskRegistry(["example.root=math:sqrt"])
    >>> registry.resolve("example.root")(9.0)
    3.0
    """

    def __init__(self, extra: Iterable[str] = ()) -> None:
        self._extra: dict[str, str] = {}
        for entry in extra:
            name, _, reference = entry.partition("=")
            if not name or not _REFERENCE.fullmatch(reference):
                raise UsageError(
                    f"task {entry!r} is not of the form NAME=module:function",
                    'write for example "mine.fit=my_package.tasks:fit"',
                )
            if self._extra.setdefault(name, reference) != reference:
                raise UsageError(
                    f"task {name!r} is given twice, as {self._extra[name]} and as {reference}",
                    "keep one of them",
                )
        self._installed: dict[str, str] | None = None
        self._functions: dict[str, Callable[..., object]] = {}
        self._names: dict[str, str] = {}

    def references(self) -> dict[str, str]:
        """Return every known name with its ``module:function``."""
        if self._installed is None:
            from importlib.metadata import entry_points  # 20 ms that most workers can save

            self._installed = {entry.name: entry.value for entry in entry_points(group=TASK_GROUP)}
        return self._installed | self._extra

    def resolve(self, name: str) -> Callable[..., object]:
        """Import and return the task's function; behind `EACH`, that for each item of its columns.

        Raise UsageError where there is no such task, or its module cannot be imported or lacks it.
        """
        if name.startswith(EACH):
            return _each(self.resolve(name.removeprefix(EACH)))
        if name not in self._functions:
            reference = self._extra.get(name) or self.references().get(name)
            if reference is None:
                raise UsageError(
                    f"no task is registered as {name!r}",
                    f"register it as an entry point of the group {TASK_GROUP!r}, or pass "
                    "--task NAME=module:function to the component",
                )
            self._functions[name] = _import(name, reference)
        return self._functions[name]

    def import_ahead(self) -> Iterator[str]:
        """Import all tasks, one by one, so that the first call of each does not wait for it.

        Yield the name of each one that was tried: what fails says so when the task is called.
        """
        for name in self.references():
            with suppress(Exception, SystemExit):
                self.resolve(name)
            yield name

    def name_of(self, task: Callable[..., object] | str) -> str:
        """Return the name under which a function, or a name, is registered; else UsageError."""
        if isinstance(task, str):
            reference, known = task, task in self._extra or task in self.references()
        else:
            module = getattr(task, "__module__", None)
            reference = f"{module}:{getattr(task, '__qualname__', task)}"
            if reference not in self._names:
                self._names = {value: name for name, value in self.references().items()}
            known = reference in self._names
        if not known:
            raise UsageError(
                f"{reference!r} is not a registered task",
                f"register it as an entry point of the group {TASK_GROUP!r}, or pass "
                "NAME=module:function as an extra task",
            )
        return reference if isinstance(task, str) else self._names[reference]


def each_result(single: Traits) -> Callable[..., Declared]:
    """Return what is declared of the results of a task that is run for each item of columns."""

    def result(*columns: list[object]) -> Declared:
        if not callable(single.result):
            return Each(single.result, len(columns[0]))
        return EachOf([single.result(*item) for item in zip(*columns, strict=True)])

    return result


def _each(function: Callable[..., object]) -> Callable[..., list[object]]:
    def run(*columns: object) -> list[object]:
        return [function(*item) for item in zip(*columns, strict=True)]

    return declare(result=each_result(traits_of(function)))(run)


def _import(name: str, reference: str) -> Callable[..., object]:
    module, _, function = reference.partition(":")
    try:
        function_object = getattr(import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"task {name!r}: {reference} cannot be imported ({error})",
            "install the package that holds it on every worker, or correct the name",
        ) from error
    if not callable(function_object):
        raise UsageError(f"task {name!r}: {reference} is not a function")
    return function_object  # type: ignore[no-any-return]
