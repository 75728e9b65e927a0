"""Makes the page of what the surface's tasks return, from their annotations and their records."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from dataclasses import is_dataclass
from itertools import pairwise
from typing import Any, get_args, get_type_hints

import numpy as np

from hpccomponent.protocol.columns import field_types, read_column
from hpccomponent.runtime.tasks import TaskRegistry


def describe_results() -> Iterator[str]:
    """Yield the page: the tasks, then each record that they return."""
    yield "# Results of tasks\n"
    yield (
        "What workers answer, for who writes one or looks at what a worker has kept. "
        "A letter in a shape is an extent, the same wherever it stands in a result. "
        "[How a task declares more](../../how-to/write-an-application.md#1-the-task).\n"
    )
    yield "| task | returns |\n|---|---|"
    registry, records = TaskRegistry(), dict[type, None]()
    for name in sorted(name for name in registry.references() if name.startswith("surface.")):
        form = get_type_hints(registry.resolve(name), include_extras=True)["return"]
        records |= dict.fromkeys(_records(form))
        yield f"| `{name}` | {_say(form)} |"
    for kind in records:
        yield f"\n## {kind.__name__}\n\n{inspect.cleandoc(kind.__doc__ or '').splitlines()[0]}\n"
        yield "| field | what | range | unit | meaning |\n|---|---|---|---|---|"
        texts = _field_texts(kind)
        for field, form in field_types(kind).items():
            known = hasattr(form, "__metadata__")
            limits = f"{_range(form)} | {read_column(form)[1].unit}" if known else " | "
            yield f"| `{field}` | {_say(form)} | {limits} | {texts.get(field, '')} |"


def _records(form: Any) -> Iterator[type]:
    """Yield the records with columns in a type."""
    if is_dataclass(form) and isinstance(form, type):
        types = field_types(form).values()
        if all(hasattr(one, "__metadata__") or one in (int, float) for one in types):
            yield form
    else:
        for part in get_args(form):
            yield from _records(part)


def _say(form: Any) -> str:
    """Return a type in words: the items of a tuple one by one, an array with its shape."""
    if hasattr(form, "__metadata__"):
        dtype, column = read_column(form)
        return f"{np.dtype(dtype).name} ({', '.join(map(str, column.shape))})"
    if get_args(form) and getattr(form, "__origin__", None) is tuple:
        return f"({', '.join(map(_say, get_args(form)))})"
    if get_args(form) and not hasattr(form, "dtype"):
        return " or ".join(dict.fromkeys(map(_say, get_args(form))))
    if form is type(None):
        return "None"
    return str(getattr(form, "__name__", form))


def _range(form: Any) -> str:
    _, column = read_column(form)
    low, high = (
        f"{bound:.9g}" if isinstance(bound, int | float) and np.isfinite(bound) else ""
        for bound in (column.low, column.high)
    )
    limits = [f"{low} to {high}" if low and high else f"from {low}" if low else ""]
    if isinstance(column.low, tuple):
        limits = [f"first from {column.low[0]:g}"]
    rising, infinite = "rising" * column.rises, "or infinite" * (not column.finite)
    return ", ".join(filter(None, [*limits, rising, infinite]))


def _field_texts(kind: type) -> dict[str, str]:
    """Return what stands below each field of a class."""
    (tree,) = ast.parse(inspect.getsource(kind)).body
    body = getattr(tree, "body", [])
    return {
        ast.unparse(field.target): " ".join(ast.literal_eval(after.value).split())
        for field, after in pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr)
    }
