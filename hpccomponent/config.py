"""A strict reader of YAML files: every mistake at once, each with its file, line and column.

::

    text ── yaml.compose ──> nodes with marks ── plain values ──> pydantic model
                               │                                       │ errors with key paths
                               ├──────── line and column of a path <───┤
                               └──────── and of what does not fit <── check(model), if there is one

A message reads ``loader.yaml:5:1: restart.frist_s: unknown key (got 2), did you mean "first_s"?``.

Values are validated in pydantic's strict JSON mode: text is never taken for a number, ``yes``
never for text, while a string still makes a path and a list a tuple.

May be imported by anyone. The component leaves it alone, because pydantic is slow to import.
"""

from __future__ import annotations

import contextlib
import json
import re
import types
from collections.abc import Callable, Collection, Iterable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from hpccomponent.errors import ConfigError

__all__ = ["ConfigModel", "Location", "Misfit", "parse_config", "read_config"]

ModelT = TypeVar("ModelT", bound=BaseModel)
Location = tuple[int | str, ...]
Problem = tuple[yaml.Node, Location, str]

_TAG = "tag:yaml.org,2002:"
_PLAIN = {_TAG + kind for kind in ("str", "timestamp")}  # nothing here wants a date
_TYPED = {_TAG + kind for kind in ("null", "bool", "int", "float")}
_COLLECTION = {_TAG + "map": "a mapping", _TAG + "seq": "a list"}


class ConfigModel(BaseModel):
    """The base of every model of a configuration file: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Misfit(NamedTuple):
    """A value that is right by itself and does not fit the others.

    Parameters
    ----------
    location : tuple of int and str
        The path of the value; it need not be in the text.
    message : str
    choices : collection of str
        What would fit; the nearest to the value is named.
    """

    location: Location
    message: str
    choices: Collection[str] = ()


def read_config(
    path: Path | str,
    model: type[ModelT],
    check: Callable[[ModelT], Iterable[Misfit]] | None = None,
) -> ModelT:
    """Read a YAML file into `model`.

    Parameters
    ----------
    path : path-like
        The file, UTF-8.
    model : type
        A pydantic model, best a `ConfigModel`.
    check : callable, optional
        Tells which values do not fit together.

    Returns
    -------
    instance of `model`

    Raises
    ------
    ConfigError
        The file cannot be read, or is not what the model describes.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: byte {error.start} is not UTF-8", "save the file as UTF-8"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror})", "name a YAML file that you may read"
        ) from error
    return parse_config(text, str(path), model, check)


def parse_config(
    text: str,
    name: str,
    model: type[ModelT],
    check: Callable[[ModelT], Iterable[Misfit]] | None = None,
) -> ModelT:
    """Read YAML text into `model`.

    Parameters
    ----------
    text : str
        One YAML document, a mapping at the top.
    name : str
        What messages call the text, normally the file's path.
    model : type
        A pydantic model, best a `ConfigModel`.
    check : callable, optional
        Tells which values do not fit together. Where a block of the text is wrong by itself, the
        others are checked against that block's defaults, if it has any.

    Returns
    -------
    instance of `model`

    Raises
    ------
    ConfigError
        With one line for each mistake in the text, in the order of the text.

    Examples
    --------
    >>> class Restart(ConfigModel):
    ...     first_s: float
    >>> parse_config("first_s: 2", "loader.yaml", Restart)
    Restart(first_s=2.0)
    >>> parse_config("frist_s: 2", "loader.yaml", Restart)
    Traceback (most recent call last):
    hpccomponent.errors.ConfigError: loader.yaml:1:1: first_s: missing key
    loader.yaml:1:1: frist_s: unknown key (got 2), did you mean "first_s"?
    """
    found: list[Problem] = []
    try:
        root = _compose(text, name)
        value = _plain_value(root, (), found, ())
        valid = _validate(value, root, model, found)
        if check is not None:
            _check_together(value, root, model, check, found)
    except RecursionError:
        raise ConfigError(f"{name}: nested too deeply to be read") from None
    if valid is None or found:
        raise _error(name, found)
    return valid


def _validate(
    value: Any, root: yaml.MappingNode, model: type[ModelT], found: list[Problem]
) -> ModelT | None:
    """Return the model; or None, with what pydantic finds wrong added to what was found."""
    try:
        return model.model_validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        known = {location for _, location, _ in found}
        for detail in error.errors(include_url=False, include_input=False):
            problem = _describe(detail, root, model)
            if problem[1] not in known:  # a value that could not be read is not wrong twice
                found.append(problem)
    return None


def _check_together(
    value: dict[str, Any],
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
            found.append(_describe_misfit(location, message, choices, root))


def _describe_misfit(
    location: Location, message: str, choices: Collection[str], root: yaml.MappingNode
) -> Problem:
    """Put a misfit at its place in the text, or where the longest part of its path is."""
    for end in range(len(location), -1, -1):
        key, value, path = _locate(root, location[:end])
        if path == location[:end]:
            break
    if path == location and isinstance(value, yaml.ScalarNode):
        message += f" (got {_shown(value)}){_nearest(str(value.value), choices)}"
    return key, location, message


def _compose(text: str, name: str) -> yaml.MappingNode:
    """Parse the text into nodes that know their line and column."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
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
    if root is None:
        raise ConfigError(f"{name}: the file is empty")
    if not isinstance(root, yaml.MappingNode):
        at = root.start_mark
        raise ConfigError(
            f"{name}:{at.line + 1}:{at.column + 1}: "
            f"should be a mapping of keys to values (got {_shown(root)})"
        )
    return root


def _plain_value(
    node: yaml.Node, location: Location, found: list[Problem], above: tuple[yaml.Node, ...]
) -> Any:
    """Turn a node into JSON values, and note what YAML allows and we do not."""
    if any(node is ancestor for ancestor in above):
        found.append((node, location, "an alias that contains itself"))
        return None
    above = (*above, node)
    if isinstance(node, yaml.MappingNode) and node.tag in _COLLECTION:
        return _plain_mapping(node, location, found, above)
    if isinstance(node, yaml.SequenceNode) and node.tag in _COLLECTION:
        return [
            _plain_value(child, (*location, i), found, above) for i, child in enumerate(node.value)
        ]
    if node.tag in _PLAIN:
        return node.value
    if node.tag in _TYPED:
        # an explicit tag may stand before what it does not fit: !!int x
        with contextlib.suppress(ValueError, KeyError, yaml.YAMLError):
            return yaml.SafeLoader("").construct_object(node)
    found.append((node, location, f"not a value that {node.tag.removeprefix(_TAG)!r} can describe"))
    return None


def _plain_mapping(
    node: yaml.MappingNode,
    location: Location,
    found: list[Problem],
    above: tuple[yaml.Node, ...],
) -> dict[str, Any]:
    """Turn a mapping into a dict; keys must be text, and each may come once."""
    values: dict[str, Any] = {}
    lines: dict[str, int] = {}
    for key, child in node.value:
        if key.tag == _TAG + "merge":
            found.append((key, location, "merge keys (<<) are not read, write the keys out"))
        elif key.tag not in _PLAIN:
            found.append((key, location, f"a key must be text (got {_shown(key)}), quote it"))
        elif key.value in values:
            first = lines[key.value]
            found.append((key, (*location, key.value), f"key given twice, first in line {first}"))
        else:
            lines[key.value] = key.start_mark.line + 1
            values[key.value] = _plain_value(child, (*location, key.value), found, above)
    return values


def _error(name: str, problems: list[Problem]) -> ConfigError:
    """Write one line per place, in the order of the text; what a union says twice is joined."""
    lines: dict[tuple[int, int, str], list[str]] = {}
    for node, location, message in problems:
        mark = node.start_mark
        said = lines.setdefault((mark.line + 1, mark.column + 1, _dotted(location)), [])
        if message not in said:
            said.append(message)
    return ConfigError(
        "\n".join(
            f"{name}:{line}:{column}: " + (f"{path}: " if path else "") + ", or ".join(said)
            for (line, column, path), said in sorted(lines.items())
        )
    )


def _dotted(location: Location) -> str:
    """Write ('tasks', 2, 'name') as tasks[2].name."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def _shown(node: yaml.Node) -> str:
    """Show a node as the user wrote it, cut to a readable length."""
    if node.tag in _COLLECTION:
        return _COLLECTION[node.tag]
    if node.tag == _TAG + "null":
        return "nothing"
    text = re.sub(r"(://[^/@:]*:)[^/@]*@", r"\1...@", str(node.value))  # no password in a log
    text = text if len(text) <= 60 else text[:57] + "..."
    return repr(text) if node.tag in _PLAIN else text


def _describe(detail: ErrorDetails, root: yaml.MappingNode, model: type[BaseModel]) -> Problem:
    """Put one of pydantic's findings into our words, at its place in the text."""
    kind, context = detail["type"], detail.get("ctx", {})
    loc: Location = detail["loc"]
    if kind == "union_tag_invalid":
        loc = (*loc, str(context["discriminator"]).strip("'"))
    key, value, location = _locate(root, loc)
    if kind in ("missing", "union_tag_not_found"):
        absent = loc[-1] if kind == "missing" else str(context["discriminator"]).strip("'")
        return key, (*location, absent), "missing key"
    message = f"{_reworded(kind, detail['msg'])} (got {_shown(value)})"
    choices = list(_valid_keys(model, loc)) if kind == "extra_forbidden" else []
    wrong = str(location[-1]) if location else ""
    if kind in ("literal_error", "enum", "union_tag_invalid"):
        choices = re.findall(
            r"'([^']*)'", str(context.get("expected", context.get("expected_tags")))
        )
        wrong = str(value.value)
    nearest = _nearest(wrong, choices)
    if "did you mean" in nearest or kind in ("extra_forbidden", "union_tag_invalid"):
        message += nearest
    return key, location, message


def _nearest(wrong: str, choices: Collection[str]) -> str:
    """Name the choice that is meant, or all of them where none is near."""
    if not choices:
        return ""
    nearest = get_close_matches(wrong, choices, n=1)
    if nearest:
        return f', did you mean "{nearest[0]}"?'
    return f", valid here: {', '.join(sorted(choices))}"


def _reworded(kind: str, message: str) -> str:
    """Say in our words what pydantic says in its own."""
    ours = {
        "extra_forbidden": "unknown key",
        "union_tag_invalid": "unknown value",
        "model_type": "should be a mapping of keys to values",
        "dict_type": "should be a mapping of keys to values",
        "list_type": "should be a list",
        "tuple_type": "should be a list",
        "too_short": "has too few entries",
        "too_long": "has too many entries",
    }
    if kind in ours:
        return ours[kind]
    return re.sub(r"^(Input |Value error, )", "", message)


def _locate(root: yaml.Node, loc: Location) -> tuple[yaml.Node, yaml.Node, Location]:
    """Follow a path of pydantic's; parts that name a member of a union are not in the text.

    Returns the node to point at (a key where there is one), the value, and the path in the text.
    """
    pointed, value = root, root
    path: Location = ()
    for part in loc:
        if isinstance(value, yaml.SequenceNode) and isinstance(part, int):
            pointed = value = value.value[part]
            path = (*path, part)
        elif isinstance(value, yaml.MappingNode):
            for key, child in value.value:
                if key.value == part:
                    pointed, value = key, child
                    path = (*path, part)
                    break
    return pointed, value, path


def _valid_keys(model: type[BaseModel], loc: Location) -> set[str]:
    """Return the keys that the model allows beside the last part of `loc`."""
    candidates = list(_members(model))
    for part in loc[:-1]:
        inner = [member for kind in candidates for member in _step(kind, part)]
        named = [kind for kind in candidates if _is_tagged(kind, part)]
        candidates = inner or named or candidates
    models = [kind for kind in candidates if _is_model(kind)]
    return {field.alias or name for kind in models for name, field in kind.model_fields.items()}


def _members(annotation: Any) -> Iterator[Any]:
    """Yield the types that an annotation allows: itself, or each member of a union."""
    if hasattr(annotation, "__metadata__"):  # Annotated[X, ...]
        yield from _members(annotation.__origin__)
    elif get_origin(annotation) in (Union, types.UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _step(kind: Any, part: int | str) -> Iterator[Any]:
    """Yield what lies one part of a path below a type."""
    if _is_model(kind) and part in kind.model_fields:
        yield from _members(kind.model_fields[str(part)].annotation)
    elif isinstance(part, int) and get_origin(kind) in (list, tuple) and get_args(kind):
        yield from _members(get_args(kind)[0])
    elif isinstance(part, str) and get_origin(kind) is dict:
        yield from _members(get_args(kind)[1])


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _is_tagged(kind: Any, part: int | str) -> bool:
    """Tell whether pydantic names this member of a union `part`: by class, or by a literal."""
    if not _is_model(kind):
        return False
    literals = (get_args(field.annotation) for field in kind.model_fields.values())
    return bool(kind.__name__ == part or any(part in values for values in literals))
