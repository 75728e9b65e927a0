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

__all__ = ["expand_variables"]

_DOLLAR = re.compile(r"\$(?:\$|\{(?P<name>[A-Za-z_]\w*)(?::-(?P<default>[^{}]*))?\}|(?P<odd>\{))")
_FORM = "a variable is written ${NAME} or ${NAME:-default}; $$ stands for a dollar sign"


def expand_variables(
    root: yaml.MappingNode, environment: Mapping[str, str], found: list[Problem]
) -> None:
    """Fill in the variables of all values, in place.

    Parameters
    ----------
    root : yaml.MappingNode
        Of a document.
    environment : mapping of str to str
    found : list of Problem
        Gets a problem for each variable that is not set, with its place.
    """
    seen: set[int] = set()
    for node, location in _values(root, ()):
        if "$" in node.value and id(node) not in seen:  # an alias is the node that it names
            seen.add(id(node))
            _expand(node, location, environment, found)


def _values(node: yaml.Node, location: Location) -> Iterator[tuple[yaml.ScalarNode, Location]]:
    """Yield the scalars below a node that are values."""
    if isinstance(node, yaml.ScalarNode):
        yield node, location
    elif isinstance(node, yaml.SequenceNode):
        for index, child in enumerate(node.value):
            yield from _values(child, (*location, index))
    elif isinstance(node, yaml.MappingNode):
        for key, child in node.value:
            yield from _values(child, (*location, str(key.value)))


def _expand(
    node: yaml.ScalarNode,
    location: Location,
    environment: Mapping[str, str],
    found: list[Problem],
) -> None:
    problems: list[str] = []

    def fill(match: re.Match[str]) -> str:
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
