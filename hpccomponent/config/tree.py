"""From YAML text to nodes that know their line and column, within bounds; used by `config` only.

A few lines of YAML can name themselves a billion times (``b: [*a, *a]``, ``c: [*b, *b]`` and so
on), be nested without end, or be merged into each other: what a file comes to is measured before
anything is made of it. Merge keys (``<<``) are resolved here as YAML 1.1 has them: a key of the
mapping itself counts before a merged one, and what is merged first before what comes later.
https://yaml.org/type/merge.html
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NoReturn

import yaml

from hpccomponent.config.problems import TAG, show
from hpccomponent.errors import ConfigError

MOST_BYTES = 1 << 18
"""Of a file; 2,000 machines take less."""

MOST_TEXT = 1 << 20
"""Characters of all values, with what variables and aliases stand for."""

_MOST_DEPTH = 50
_MOST_VALUES = 50_000
MERGE = TAG + "merge"
"""The tag of a merge key."""
_ADVICE = "leave out what is no setting, or make it several files"

Pairs = list[tuple[yaml.Node, yaml.Node]]


class _Loader(yaml.SafeLoader):
    """Counts what it composes."""

    def __init__(self, text: str, name: str) -> None:
        super().__init__(text)
        self._source = name
        self._depth = self._values = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node, unless it is one too many."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        self._values += 1
        self._depth += 1
        if self._depth > _MOST_DEPTH:
            _refuse(self._source, event, f"nested more than {_MOST_DEPTH} deep")
        if self._values > _MOST_VALUES:
            _refuse(self._source, event, f"more than {_MOST_VALUES} values")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def compose(text: str, name: str) -> yaml.MappingNode:
    """Parse YAML text, and resolve its merge keys.

    Raise ConfigError for no YAML, no mapping, or more than a file of settings has any use for.
    """
    if len(text) > MOST_BYTES:
        refuse_length(text, name)
    root = _parse(text, name)
    if root is None:
        raise ConfigError(f"{name}: the file is empty")
    if not isinstance(root, yaml.MappingNode):
        at = root.start_mark
        raise ConfigError(
            f"{name}:{at.line + 1}:{at.column + 1}: "
            f"should be a mapping of keys to values (got {show(root)})"
        )
    _resolve(root, name)
    return root


def _parse(text: str, name: str) -> yaml.Node | None:
    """Return the root of YAML; None where there is none."""
    try:
        return _Loader(text, name).get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
        if error.problem and "'\\t'" in error.problem:
            raise ConfigError(
                f"{where}: a tab where YAML wants spaces", "indent by spaces"
            ) from None
        context = f" {error.context}" if error.context else ""
        raise ConfigError(f"{where}: not YAML: {error.problem}{context}") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        column = error.position - (text.rfind("\n", 0, error.position) + 1) + 1
        raise ConfigError(f"{name}:{line}:{column}: not YAML: {error.reason}") from None


def refuse_length(text: str, name: str) -> NoReturn:
    """Raise ConfigError for a text of more than `MOST_BYTES`, at the line that goes beyond."""
    line = text.count("\n", 0, MOST_BYTES) + 1
    raise ConfigError(
        f"{name}:{line}: here the file is longer than {MOST_BYTES // 1024} KiB, which is the most",
        _ADVICE,
    )


def refuse_text(name: str, where: yaml.Node) -> NoReturn:
    """Raise ConfigError for what comes to more than `MOST_TEXT`, at the value that goes beyond."""
    most = f"more than {MOST_TEXT >> 10} KiB of text"
    _refuse(name, where, f"what variables and aliases stand for makes this file {most}")


def _resolve(root: yaml.Node, name: str) -> None:
    """Resolve the merge keys of a tree, each node after what is below it; measure what it makes."""
    sizes: dict[int, int] = {}  # of a node with all that it holds, each alias anew
    depths: dict[int, int] = {}
    merged = 0
    for node in _bottom_up(root, name):
        if isinstance(node, yaml.MappingNode):
            merged += sum(len(source.value) for source in _sources(node))
            if merged > _MOST_VALUES:
                _refuse(name, node, f"merge keys (<<) bring more than {_MOST_VALUES} values")
            _merge(node)
        children = _children(node)
        sizes[id(node)] = 1 + sum(sizes[id(child)] for child in children)
        depths[id(node)] = 1 + max((depths[id(child)] for child in children), default=0)
        if sizes[id(node)] > _MOST_VALUES:
            _refuse(name, node, f"aliases (*) make this more than {_MOST_VALUES} values")
        if depths[id(node)] > _MOST_DEPTH:
            _refuse(name, node, f"aliases (*) nest this more than {_MOST_DEPTH} deep")


def _bottom_up(root: yaml.Node, name: str) -> Iterator[yaml.Node]:
    """Yield each node of a tree once, after those below it; refuse one that is below itself."""
    done: set[int] = set()
    above = {id(root)}
    waiting = [(root, iter(_children(root)))]
    while waiting:
        node, children = waiting[-1]
        child = next((child for child in children if id(child) not in done), None)
        if child is None:
            waiting.pop()
            above.discard(id(node))
            done.add(id(node))
            yield node
        elif id(child) in above:
            _refuse(name, child, "an alias that contains itself", "write out what it stands for")
        else:
            above.add(id(child))
            waiting.append((child, iter(_children(child))))


def _refuse(name: str, where: Any, problem: str, advice: str = _ADVICE) -> NoReturn:
    """Raise ConfigError at a node, or at an event of the parser."""
    mark = where.start_mark
    raise ConfigError(f"{name}:{mark.line + 1}:{mark.column + 1}: {problem}", advice)


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


def _sources(node: yaml.MappingNode) -> list[yaml.MappingNode]:
    """Return the mappings that the first merge key of one names, first those that count most."""
    value = next((value for key, value in node.value if key.tag == MERGE), None)
    named = value.value if isinstance(value, yaml.SequenceNode) else [value]
    sources = [source for source in named if isinstance(source, yaml.MappingNode)]
    return sources if len(sources) == len(named) else []


def _merge(node: yaml.MappingNode) -> None:
    """Put the keys of merged mappings behind a mapping's own; a wrong merge key stays."""
    sources = _sources(node)
    if not sources:
        return
    first = next(key for key, _ in node.value if key.tag == MERGE)
    pairs: Pairs = [pair for pair in node.value if pair[0] is not first]
    for source in sources:
        known = {key.value for key, _ in pairs if isinstance(key, yaml.ScalarNode)}
        pairs += [pair for pair in source.value if pair[0].value not in known]
    node.value = pairs
