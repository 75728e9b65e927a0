"""A strict reader of YAML files: every mistake at once, each with its file, line and column.

::

    text ── yaml.compose ──> nodes with marks ── plain values ──> pydantic model
                               │                                       │ errors with key paths
                               ├──────── line and column of a path <───┤
                               └──────── and of what does not fit <── check(model), if there is one

A message reads ``loader.yaml:5:1: restart.frist_s: unknown key, did you mean "first_s"?``.

Values are validated in pydantic's strict JSON mode: text is never taken for a number, ``yes``
never for text, while a string still makes a path and a list a tuple.

May be imported by anyone. The component leaves it alone, because pydantic is slow to import.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Collection, Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import NamedTuple, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from hpccomponent.config.problems import (
    COLLECTION,
    PLAIN,
    TAG,
    Location,
    Problem,
    is_miscounted,
    place_finding,
    place_misfit,
    problems_error,
    show,
)
from hpccomponent.config.tree import MERGE, MOST_BYTES, compose, refuse_length
from hpccomponent.config.variables import expand_variables
from hpccomponent.errors import ConfigError
from hpccomponent.files.paths import read_regular

ModelT = TypeVar("ModelT", bound=BaseModel)
_MOST_PLACED = 300  # of pydantic's findings; each takes a walk through the text
_ONE_MERGE = "a mapping has one merge key (<<), whose value is a mapping or a list of mappings"
_TYPED = {TAG + kind for kind in ("null", "bool", "int", "float")}


class ConfigModel(BaseModel):
    """The base of every model of a configuration file: unknown keys, NaN, infinities are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Misfit(NamedTuple):
    """A value that is right by itself and does not fit the others.

    Its path need not be in the text. Of `choices`, what would fit, the nearest is named.
    """

    location: Location
    message: str
    choices: Collection[str] = ()


def read_config(
    path: Path | str,
    model: type[ModelT],
    check: Callable[[ModelT], Iterable[Misfit]] | None = None,
    environment: Mapping[str, str] | None = None,
) -> ModelT:
    """Read a YAML file, in UTF-8, into `model`, best a `ConfigModel`.

    `check` tells which values do not fit together; `environment` is where ``${NAME}`` in a value is
    looked up: without it, values are taken literally. Raise ConfigError where the file cannot be
    read, or is not what the model describes.
    """
    try:
        content = read_regular(Path(path), MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            refuse_length(content.decode(errors="replace"), str(path))
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: byte {error.start} is not UTF-8", "save the file as UTF-8"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror})", "name a YAML file that you may read"
        ) from error
    return parse_config(text, str(path), model, check, environment)


def parse_config(
    text: str,
    name: str,
    model: type[ModelT],
    check: Callable[[ModelT], Iterable[Misfit]] | None = None,
    environment: Mapping[str, str] | None = None,
) -> ModelT:
    """Read YAML text into `model`, best a `ConfigModel`.

    `check` tells which values do not fit together. Where a block of the text is wrong by itself,
    the others are checked against that block's defaults, if it has any. Raise ConfigError, with one
    line for each mistake, in the order of the text.

    Examples
    --------
    >>> class Restart(ConfigModel):
    ...     first_s: float
    >>> parse_config("first_s: 2", "loader.yaml", Restart)
    Restart(first_s=2.0)
    >>> parse_config("frist_s: 2", "loader.yaml", Restart)
    Traceback (most recent call last):
    hpccomponent.errors.ConfigError: loader.yaml:1:1: first_s: missing key
    loader.yaml:1:1: frist_s: unknown key, did you mean "first_s"?
    """
    problems: list[Problem] = []
    root = compose(text, name)
    expand_variables(root, environment, problems, name)
    value = _plain_mapping(root, (), problems)
    valid = _validate(value, root, model, problems)
    if check is not None:
        _check_together(value, root, model, check, problems)
    if valid is None or problems:
        raise problems_error(name, problems)
    return valid


def _validate(
    value: object, root: yaml.MappingNode, model: type[ModelT], found: list[Problem]
) -> ModelT | None:
    """Return the model; or None, with what pydantic finds wrong added to what was found."""
    try:
        return model.model_validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        known = {location for _, location, _ in found}
        for detail in islice(error.errors(include_url=False, include_input=False), _MOST_PLACED):
            if is_miscounted(detail, root):
                continue
            problem = place_finding(detail, root, model)
            if problem[1] not in known:  # a value that could not be read is not wrong twice
                found.append(problem)
    return None


def _check_together(
    value: dict[str, object],
    root: yaml.MappingNode,
    model: type[ModelT],
    check: Callable[[ModelT], Iterable[Misfit]],
    found: list[Problem],
) -> None:
    """Add what does not fit together, as far as the blocks that are right tell."""
    wrong = {location[:1] for _, location, _ in found}
    right = {key: block for key, block in value.items() if (key,) not in wrong}
    try:
        whole = model.model_validate_json(json.dumps(right), strict=True)
    except ValidationError:  # a block that has no defaults is wrong
        return
    for location, message, choices in check(whole):
        if location[:1] not in wrong:
            found.append(place_misfit(location, message, choices, root))


def _plain_value(node: yaml.Node, location: Location, found: list[Problem]) -> object:
    """Turn a node into JSON values, and note what YAML allows and we do not."""
    if isinstance(node, yaml.MappingNode) and node.tag in COLLECTION:
        return _plain_mapping(node, location, found)
    if isinstance(node, yaml.SequenceNode) and node.tag in COLLECTION:
        return [_plain_value(child, (*location, i), found) for i, child in enumerate(node.value)]
    if node.tag in PLAIN:
        return node.value
    if node.tag in _TYPED:
        # an explicit tag may stand before what it does not fit: !!int x
        with contextlib.suppress(ValueError, KeyError, yaml.YAMLError):
            return yaml.SafeLoader("").construct_object(node)
    found.append((node, location, f"not a value that {node.tag.removeprefix(TAG)!r} can describe"))
    return None


def _plain_mapping(
    node: yaml.MappingNode, location: Location, found: list[Problem]
) -> dict[str, object]:
    """Turn a mapping into a dict; keys must be text, and each may come once."""
    values: dict[str, object] = {}
    lines: dict[str, int] = {}
    for key, child in node.value:
        if key.tag == MERGE:
            found.append((key, location, _ONE_MERGE))
        elif key.tag not in PLAIN:
            found.append((key, location, f"a key must be text (got {show(key)}), quote it"))
        elif key.value in values:
            first = lines[key.value]
            found.append((key, (*location, key.value), f"key given twice, first in line {first}"))
        else:
            lines[key.value] = key.start_mark.line + 1
            values[key.value] = _plain_value(child, (*location, key.value), found)
    return values
