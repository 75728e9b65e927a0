"""HTML is made by templates alone, and what these show they escape."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SOURCES = [
    path
    for part in ("hpcapp", "hpccomponent", "loader/hpcloader", "deploy/hpcdeploy")
    for path in (ROOT / part).rglob("*.py")
]
# Of HTML and SVG; "object" and "text" are XML's, too.
_TAG = re.compile(
    r"<!doctype|</?(a|article|aside|b|body|br|button|canvas|caption|circle|code|dd|details|div|dl|dt"
    r"|em|footer|form|g|h[1-6]|head|header|hr|html|i|iframe|img|input|label|li|line|link|main|meta"
    r"|nav|noscript|ol|option|output|p|path|polygon|polyline|pre|progress|rect|script|section|select"
    r"|small|span|strong|style|sub|summary|sup|svg|table|tbody|td|textarea|th|thead|title|tr|u|ul"
    r"|video)[\s/>]",
    re.IGNORECASE,
)


def strings_of(source: str) -> Iterator[str]:
    """Yield the strings of a module, those with values in them as one; without docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = None
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) for part in node.values if isinstance(part, ast.Constant))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@pytest.mark.parametrize(
    "source", ["'<p>' + text", "f'<td class=\"{kind}\">'", "'</Script>'", "f'<path d={d}/>'"]
)
def test_a_tag_in_a_string_is_found(source: str) -> None:
    assert any(map(_TAG.search, strings_of(f"page = {source}")))


def test_no_tag_stands_in_a_string_of_the_sources() -> None:
    found = {
        f"{path.relative_to(ROOT)}: {text[:60]}"
        for path in SOURCES
        for text in strings_of(path.read_text())
        if _TAG.search(text)
    }
    assert found == set()


def test_only_files_of_our_own_are_taken_as_html() -> None:
    templates = [one.read_text() for one in files("hpcapp.pages").joinpath("templates").iterdir()]
    assert len(templates) > 5
    taken = [name for text in templates for name in re.findall(r"\{\{ *(.*?) *\|\s*safe", text)]
    assert sorted(taken) == ["boot", "style"]
    assert not any("autoescape" in text for text in templates)


def test_our_scripts_put_words_into_pages_as_text() -> None:
    scripts = [path for path in (ROOT / "hpcapp").rglob("*.js") if "three" not in path.parts]
    assert len(scripts) > 5
    for path in scripts:
        text = path.read_text()
        assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|srcdoc", text), (
            path
        )
