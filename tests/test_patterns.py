"""No regular expression backtracks over what a file, a machine or a user says.

All calls of `re` in the sources are found, and their patterns, as they are when the module is
there, are looked at: nothing is timed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from backtracking import backtracks

ROOT = Path(__file__).parents[1]
CALLS = [
    f"re.{name}"
    for name in ("compile", "match", "fullmatch", "search", "findall", "finditer", "split", "sub")
]


def find_patterns(path: Path) -> Iterator[tuple[str, str | bytes, int]]:
    """Yield what is called of the patterns of a source, these, and their flags."""
    text = path.read_text()
    tree = ast.parse(text)
    names = vars(import_module(name_module(path.relative_to(ROOT))))
    targets = {
        id(node.value): ast.unparse(node.targets[0])
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
    }
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and ast.unparse(node.func) in CALLS):
            continue
        call = ast.unparse(node.func).removeprefix("re.")
        calls, flags = {call}, 0
        if call == "compile":
            used = re.findall(rf"\b{targets.get(id(node), '')}\.(\w+)", text)
            calls = {name for name in used if f"re.{name}" in CALLS} or {"search"}
            flags = sum(evaluate(argument, names) for argument in node.args[1:])
        for one in calls:
            yield one, evaluate(node.args[0], names), flags


def name_module(source: Path) -> str:
    parts = source.parts if source.parts[0].startswith("hpc") else source.parts[1:]
    return ".".join(parts).removesuffix(".py").removesuffix(".__init__")


class _Plain(ast.NodeTransformer):
    """Puts a letter for what is escaped: it is matched as it is."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        return ast.Constant("a") if ast.unparse(node.func) == "re.escape" else node


def evaluate(node: ast.expr, names: dict[str, Any]) -> Any:
    """Return what an expression is in a module."""
    expression = ast.fix_missing_locations(ast.Expression(_Plain().visit(node)))
    return eval(compile(expression, "<pattern>", "eval"), names)  # noqa: S307 - our own sources


BY_HAND = {
    "hpcapp/kernels/digest.py": "sees our own sources alone",
    "deploy/hpcdeploy/install/probe.py": "a table of patterns of one repeat each",
    "deploy/hpcdeploy/providers/ec2/bucket.py": "what follows a name has one repeat",
}
SOURCES = [
    str(path.relative_to(ROOT))
    for package in ("hpcapp", "hpccomponent", "loader/hpcloader", "deploy/hpcdeploy")
    for path in sorted((ROOT / package).rglob("*.py"))
    if any(call in path.read_text() for call in CALLS)
    and str(path.relative_to(ROOT)) not in BY_HAND
]


@pytest.mark.parametrize("source", SOURCES)
def test_no_pattern_backtracks(source: str) -> None:
    for call, pattern, flags in find_patterns(ROOT / source):
        assert not backtracks(pattern, call, flags), (call, pattern)


@pytest.mark.parametrize(
    ("pattern", "call", "does"),
    [
        (r"\d+\.?\d*x", "match", True),
        (r"\d++\.?\d*x", "match", False),
        (r"\d+\.\d*x", "match", False),
        (r"(\d+)*x", "match", True),
        (r"(a|b|ab)*x", "match", True),
        (r"\d*,", "match", False),
        (r"\d*,", "search", True),
        (r"[\s,]+", "split", False),
        (r"<a[^>]*>", "search", True),
        (r"<a[^<>]*>", "search", False),
        (r".*a.*", "fullmatch", True),
        (r"a*b*", "fullmatch", False),
    ],
)
def test_what_backtracks_is_found(pattern: str, call: str, does: bool) -> None:
    assert backtracks(pattern, call) == does
