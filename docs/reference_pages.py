"""Makes the reference pages: command line, cluster file, API, results, measured figures."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from command_pages import describe_commands
from constant_pages import describe_constants
from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from result_pages import describe_results

import hpcapp
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.provider import ProviderSpec


def describe_cluster_file() -> Iterator[str]:
    """Yield the page of the cluster file, made from its pydantic models."""
    yield "# Cluster file\n"
    guide = "[Describe a cluster](../../how-to/describe-a-cluster.md)"
    yield f"Every key with its default. How to write one: {guide}.\n"
    seen: set[type[BaseModel]] = set()
    waiting: list[tuple[str, type[BaseModel]]] = [("", ClusterSpec)]
    while waiting:
        place, model = waiting.pop(0)
        if model in seen:
            continue
        seen.add(model)
        kind = model.model_fields.get("type")
        types = [f"`{name}`" for name in get_args(kind.annotation)] if kind else []
        heading = f"`{place}`" if place else "The file"
        yield f"## {heading}{' of ' * bool(types)}{', '.join(types)}\n"
        summary, texts = _read_docstring(model)
        yield f"{summary}\n"
        yield "| key | default | counts with | meaning |\n|---|---|---|---|"
        for key, field in model.model_fields.items():
            path = f"{place}.{key}" if place else key
            default = _default(field.default, field.default_factory)
            yield f"| `{path}` | {default} | {_honoured(path)} | {_cell(texts.get(key, ''))} |"
            waiting.extend((path, inner) for inner in _models(field.annotation))
        yield ""


def _honoured(path: str) -> str:
    """Name the providers that a key counts with; nothing where it is a block, or within theirs."""
    blocks = get_args(get_args(ProviderSpec)[0])
    honoured = [
        f"`{get_args(block.model_fields['type'].annotation)[0]}`"
        for block in blocks
        if path in block.honours
    ]
    return "all" if len(honoured) == len(blocks) else ", ".join(honoured)


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models within a field's type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Union, UnionType, dict, tuple, list) or get_args(annotation):
        for part in get_args(annotation):
            if part is not NoneType:
                yield from _models(part)


def _default(value: Any, factory: Any) -> str:
    if factory is not None:
        value = factory()
    if value is PydanticUndefined:
        return "required"
    if value is None or value == () or value == {}:
        return ""
    if isinstance(value, BaseModel):
        return "see below"
    return f"`{json.dumps(value) if not isinstance(value, str | tuple) else _plain(value)}`"


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else ", ".join(map(str, value))


def _read_docstring(model: type[BaseModel]) -> tuple[str, dict[str, str]]:
    """Return a model's summary, and what it and its bases say of each parameter."""
    texts = [inspect.cleandoc(kind.__doc__ or "") for kind in model.__mro__]
    found: dict[str, str] = {}
    for text in reversed(texts):
        names: list[str] = []
        for line in text.partition("Parameters\n----------\n")[2].splitlines():
            if match := re.match(r"([\w, ]+) : ", line):
                names = [name.strip() for name in match[1].split(",")]
                found.update(dict.fromkeys(names, ""))
            elif names and line.startswith("    "):
                for name in names:
                    found[name] = f"{found[name]} {line.strip()}".strip()
    return texts[0].split("\n\n", 1)[0], found


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def describe_python() -> Iterator[str]:
    """Yield the page of the interface for Python, which autodoc fills."""
    yield "# Python\n"
    yield "`import hpcapp` gives all of this, each imported when it is first used.\n"
    for name in sorted(hpcapp.__all__):
        public = getattr(hpcapp, name)
        yield f"## `hpcapp.{name}`\n"
        yield "```{eval-rst}"
        if not isinstance(public, type):
            yield f".. autofunction:: hpcapp.{name}"
        elif issubclass(public, Exception):
            yield f".. autoexception:: hpcapp.{name}"
        elif is_dataclass(public):  # its fields are its parameters; the rest is for the job
            yield f".. autoclass:: hpcapp.{name}"
        else:
            yield f".. autoclass:: hpcapp.{name}\n   :members:"
        yield "```\n"


def describe_benchmarks(folder: Path) -> Iterator[str]:
    """Yield the page of measured figures: the introduction, then a table for each result."""
    introduction = (folder / "README.md").read_text(encoding="utf-8")
    yield introduction.replace("](../docs/", "](../../")
    for path in sorted((folder / "results").glob("*.json")):
        result = json.loads(path.read_text(encoding="utf-8"))
        yield f"({path.stem})=\n## {result['title']}\n"
        yield f"```text\n{result['command']}\n```\n"
        yield f"Commit: {result['commit']}. Machine: {result['machine']}.\n"
        yield f"| {' | '.join(result['columns'])} |\n|{'---|' * len(result['columns'])}"
        yield from (f"| {' | '.join(map(str, row))} |" for row in result["rows"])
        yield ""
        yield from (f"- {note}" for note in result["notes"])
        yield ""


def write(docs: Path) -> None:
    """Write the pages that changed into ``reference/generated``.

    Parameters
    ----------
    docs : Path
        The folder of the site's sources.
    """
    folder = docs / "reference" / "generated"
    folder.mkdir(exist_ok=True)
    for name, lines in (
        ("command-line.md", describe_commands()),
        ("cluster-file.md", describe_cluster_file()),
        ("python.md", describe_python()),
        ("results.md", describe_results()),
        ("benchmarks.md", describe_benchmarks(docs.parent / "benchmarks")),
        ("constants.inc", describe_constants()),  # a table within the page of the method
    ):
        text = "\n".join(lines) + "\n"
        page = folder / name
        if not page.is_file() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
