"""Variables of the environment in the values of a YAML file: ``${NAME}``, ``${NAME:-default}``.

They are filled in once the text has been parsed, so that what a variable holds is never YAML: it
can add no key. A value without quotes is then read as if it had stood there: a number where it
looks like one. Keys are taken as they are.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import yaml

from hpccomponent.config.problems import TAG, Location, Problem
from hpccomponent.config.tree import MOST_TEXT, refuse_text

_DOLLAR = re.compile(r"\$(?:\$|\{(?P<name>[A-Za-z_]\w*)(?::-(?P<default>[^{}]*))?\}|(?P<odd>\{))")
_FORM = "a variable is written ${NAME} or ${NAME:-default}; $$ stands for a dollar sign"


def expand_variables(
    root: yaml.MappingNode, environment: Mapping[str, str] | None, found: list[Problem], name: str
) -> None:
    """Fill in the variables of all values, in place, within the bounds of a file's text.

    Without an environment values are taken literally, and only measured. `found` gets a problem for
    each variable that is not set. Raise ConfigError where all together are beyond `MOST_TEXT`.
    """
    seen: set[int] = set()
    remaining = MOST_TEXT
    for node, location, is_key in _scalars(root, ()):
        is_new = id(node) not in seen  # an alias is the node that it names
        if environment is not None and is_new and not is_key and "$" in node.value:
            seen.add(id(node))
            try:
                _expand(node, location, environment, found, remaining)
            except _TooLongError:
                refuse_text(name, node)
        remaining -= len(node.value)
        if remaining < 0:
            refuse_text(name, node)


class _TooLongError(Exception):
    """A value would come to more than is left."""


def _scalars(
    node: yaml.Node, location: Location, is_key: bool = False
) -> Iterator[tuple[yaml.ScalarNode, Location, bool]]:
    """Yield the scalars below a node, and whether each is a key."""
    if isinstance(node, yaml.ScalarNode):
        yield node, location, is_key
    elif isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            yield from _scalars(child, (*location, index))
    elif isinstance(node, yaml.MappingNode):
        for key, child in node.value:
            yield from _scalars(key, location, is_key=True)
            yield from _scalars(child, (*location, str(key.value)))


def _expand(
    node: yaml.ScalarNode,
    location: Location,
    environment: Mapping[str, str],
    found: list[Problem],
    most: int,
) -> None:
    """Fill in the variables of one value, to so many characters at most."""
    problems: list[str] = []
    length = 0

    def fill(match: re.Match[str]) -> str:
        nonlocal length
        text = value_of(match)
        length += len(text)
        if length > most:
            raise _TooLongError
        return text

    def value_of(match: re.Match[str]) -> str:
        name, default = match["name"], match["default"]
        if match["odd"]:
            problems.append(_FORM)
        elif name is None:
            return "$"
        elif default is not None:  # as a shell does: what is empty is as good as not set
            return environment.get(name) or default
        elif name in environment:
            return environment[name]
        else:
            problems.append(f"{name} is not set: set it, or give a default, ${{{name}:-value}}")
        return match[0]

    text = _DOLLAR.sub(fill, node.value)
    found += [(node, location, problem) for problem in problems]
    node.value = text
    if node.style is None and node.tag == f"{TAG}str":  # without quotes and without a tag
        resolver = yaml.SafeLoader("")
        node.tag = resolver.resolve(  # type: ignore[no-untyped-call]  # PyYAML has no types
            yaml.ScalarNode, text, (True, False)
        )
