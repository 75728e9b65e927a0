"""The task registry: names on the wire, functions on the worker, nothing unpickled in between.

A task is an importable, module-level function of values. It is registered as an entry point of
the group ``hpc.tasks``, or by ``NAME=module:function`` on the command line of a component.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any

from hpccomponent.errors import UsageError

__all__ = ["TASK_GROUP", "TaskRegistry"]

TASK_GROUP = "hpc.tasks"
_REFERENCE = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<function>[A-Za-z_]\w*)")


class TaskRegistry:
    """Tasks by name, imported when they are first called.

    Parameters
    ----------
    extra : iterable of str
        ``NAME=module:function`` entries, beside the installed ones and before them.

    Raises
    ------
    UsageError
        If an entry has another form, or names one task twice with different functions.

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
        self._functions: dict[str, Callable[..., Any]] = {}
        self._names: dict[str, str] = {}

    def references(self) -> dict[str, str]:
        """Return every known name with its ``module:function``."""
        if self._installed is None:
            from importlib.metadata import entry_points  # 20 ms that most workers can save

            self._installed = {entry.name: entry.value for entry in entry_points(group=TASK_GROUP)}
        return self._installed | self._extra

    def resolve(self, name: str) -> Callable[..., Any]:
        """Import and return the task's function.

        Raises
        ------
        UsageError
            If there is no task of this name, or its module cannot be imported, or holds no such
            function.
        """
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

    def name_of(self, task: Callable[..., Any] | str) -> str:
        """Return the name under which a function, or a name itself, is registered.

        Raises
        ------
        UsageError
            If it is not registered.
        """
        if isinstance(task, str):
            sought, known = task, task in self._extra or task in self.references()
        else:
            module = getattr(task, "__module__", None)
            sought = f"{module}:{getattr(task, '__qualname__', task)}"
            if sought not in self._names:
                self._names = {value: name for name, value in self.references().items()}
            known = sought in self._names
        if not known:
            raise UsageError(
                f"{sought!r} is not a registered task",
                f"register it as an entry point of the group {TASK_GROUP!r}, or pass "
                "NAME=module:function as an extra task",
            )
        return sought if isinstance(task, str) else self._names[sought]


def _import(name: str, reference: str) -> Callable[..., Any]:
    module, _, function = reference.partition(":")
    try:
        found = getattr(import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"task {name!r}: {reference} cannot be imported ({error})",
            "install the package that holds it on every worker, or correct the name",
        ) from error
    if not callable(found):
        raise UsageError(f"task {name!r}: {reference} is not a function")
    return found  # type: ignore[no-any-return]
