"""The constants of the Python modules as a C++ header: each is written once.

The build runs this file as a program (see ``CMakeLists.txt``), so that it imports nothing but the
standard library; modules are read, not run.
"""

from __future__ import annotations

import ast
import operator
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

_SHARED = (
    "kernels/types/field.py",
    "kernels/types/grid.py",
    "geometry/lattice.py",
    "kernels/case_table.py",
)
_NAME = re.compile(r"_?([A-Z][A-Z\d_]*)")
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.USub: operator.neg,
}


def read_constants(source: str) -> dict[str, Any]:
    r"""Return the constants that a module defines by numbers, tuples of them, and earlier ones.

    They are ints, floats or nested tuples of these by name, without leading underscores. What the
    source computes in another way is left out.

    Examples
    --------
    >>> read_constants("_BITS = 21\n_LEAST, _MOST = 0.5, 1 << _BITS\nTABLE = make()\n")
    {'BITS': 21, 'LEAST': 0.5, 'MOST': 2097152}
    """
    constants: dict[str, Any] = {}
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign):
            continue
        try:
            value = _evaluate(node.value, constants)
        except (KeyError, TypeError):
            continue
        (target,) = node.targets
        parts = (target.elts, value) if isinstance(target, ast.Tuple) else ([target], [value])
        for name, part in zip(*parts, strict=True):
            if isinstance(name, ast.Name) and (match := _NAME.fullmatch(name.id)):
                constants[match[1]] = part
    return constants


def _evaluate(node: ast.AST, known: dict[str, Any]) -> Any:
    """Return what an expression is; `KeyError` or `TypeError` where it is no number."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return number
        case ast.Name(id=name):
            return known[name.removeprefix("_")]
        case ast.Tuple(elts=parts):
            return tuple(_evaluate(part, known) for part in parts)
        case ast.UnaryOp(op=operation, operand=only):
            return _OPERATORS[type(operation)](_evaluate(only, known))
        case ast.BinOp(left=left, op=operation, right=right):
            return _OPERATORS[type(operation)](_evaluate(left, known), _evaluate(right, known))
        case ast.Call(func=ast.Name(id="range"), args=[stop]):
            return tuple(range(_evaluate(stop, known)))
    raise KeyError(type(node))


def make_header(package: Path) -> str:
    """Return the header of `hpcapp`'s folder: a namespace for each module, in `hpc::constants`."""
    kernels = package / "kernels"
    modules = [package / name for name in _SHARED]
    modules += sorted((kernels / "portable").rglob("*.py"))
    lines = ["// Made from the Python modules (see constants_header.py).", "#pragma once"]
    lines += ["#include <cstdint>", "namespace hpc::constants {"]
    lines += _declare((kernels / "constants.py").read_text("utf-8"))
    for module in modules:
        if declared := _declare(module.read_text("utf-8")):
            lines += [f"namespace {module.stem} {{", *declared, "}"]
    return "\n".join([*lines, "}", ""])


def _declare(source: str) -> list[str]:
    """Return the lines that declare the constants of a module."""
    return [
        f"constexpr {_type_of(value)} {name}{_sides(value)} = {_literal(value)};"
        for name, value in read_constants(source).items()
    ]


def _type_of(value: Any) -> str:
    numbers = [value]
    while any(isinstance(number, tuple) for number in numbers):
        numbers = [part for number in numbers for part in number]
    if any(isinstance(number, float) for number in numbers):
        return "double"
    return "int" if all(-(1 << 31) <= number < 1 << 31 for number in numbers) else "int64_t"


def _sides(value: Any) -> str:
    return f"[{len(value)}]{_sides(value[0])}" if isinstance(value, tuple) else ""


def _literal(value: Any) -> str:
    if isinstance(value, tuple):
        return "{" + ", ".join(_literal(part) for part in value) + "}"
    return repr(value)


if __name__ == "__main__":
    sys.stdout.write(make_header(Path(sys.argv[1])))
