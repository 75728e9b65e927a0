"""Where a mistake in a YAML file is, and how it is said."""

from __future__ import annotations

import re
import types
from collections.abc import Collection, Iterator
from difflib import get_close_matches
from typing import TypeGuard, Union, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic_core import ErrorDetails

from hpccomponent.errors import ConfigError

TAG = "tag:yaml.org,2002:"
PLAIN = {TAG + kind for kind in ("str", "timestamp")}  # nothing here wants a date
COLLECTION = {TAG + "map": "a mapping", TAG + "seq": "a list"}

_SECRET = re.compile(r"secret|passw|passphrase|token|credential", re.IGNORECASE)

_MOST_LINES = 100  # of mistakes that are told at once

Location = tuple[int | str, ...]
Problem = tuple[yaml.Node, Location, str]


def problems_error(name: str, problems: list[Problem]) -> ConfigError:
    """Write one line per place, in the order of the text; what a union says twice is joined.

    The problems may be in any order; the first 100 places are told.
    """
    lines: dict[tuple[int, int, str], list[str]] = {}
    for node, location, message in problems:
        mark = node.start_mark
        messages = lines.setdefault((mark.line + 1, mark.column + 1, _dotted(location)), [])
        if message not in messages:
            messages.append(message)
    reported = [
        f"{name}:{line}:{column}: " + (f"{path}: " if path else "") + ", or ".join(messages)
        for (line, column, path), messages in sorted(lines.items())
    ]
    if len(reported) > _MOST_LINES:
        reported[_MOST_LINES:] = [f"{name}: and more; these are the first {_MOST_LINES}"]
    return ConfigError("\n".join(reported))


def _dotted(location: Location) -> str:
    """Write ('tasks', 2, 'name') as tasks[2].name."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def show(node: yaml.Node, location: Location = ()) -> str:
    """Show a node as the user wrote it, cut to a readable length.

    A collection is shown as what it is, an address without its password, and what a key at its
    location calls a secret not at all.
    """
    if node.tag in COLLECTION:
        return COLLECTION[node.tag]
    if node.tag == TAG + "null":
        return "nothing"
    if _SECRET.search(next((part for part in reversed(location) if isinstance(part, str)), "")):
        return "what is not shown"
    text = re.sub(r"(://[^/@:]*:)[^/@]*@", r"\1...@", str(node.value))  # no password in a log
    text = text if len(text) <= 60 else text[:57] + "..."
    return repr(text) if node.tag in PLAIN else text


def is_miscounted(detail: ErrorDetails, root: yaml.MappingNode) -> bool:
    """Tell whether pydantic finds too few entries only because it counts those that are right."""
    if detail["type"] != "too_short":
        return False
    _, value, _ = _locate(root, detail["loc"])
    return value.tag in COLLECTION and len(value.value) >= detail["ctx"]["min_length"]


def place_finding(detail: ErrorDetails, root: yaml.MappingNode, model: type[BaseModel]) -> Problem:
    """Put one of pydantic's findings about a `model` into our words, at its place in the text.

    Return the node, its path, and what is said of it.
    """
    kind, context = detail["type"], detail.get("ctx", {})
    loc: Location = detail["loc"]
    if kind == "union_tag_invalid":
        loc = (*loc, str(context["discriminator"]).strip("'"))
    key, value, location = _locate(root, loc)
    if kind in ("missing", "union_tag_not_found"):
        absent = loc[-1] if kind == "missing" else str(context["discriminator"]).strip("'")
        return key, (*location, absent), "missing key"
    message = _reworded(kind, detail["msg"])
    if kind == "extra_forbidden":  # whose value helps nobody, and may be a secret
        choices = list(_valid_keys(model, loc))
    else:
        choices = []
        message += f" (got {show(value, location)})"
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


def place_misfit(
    location: Location, message: str, choices: Collection[str], root: yaml.MappingNode
) -> Problem:
    """Put a misfit at its place in the text, or where the longest part of its path is.

    Of `choices`, what would fit, the nearest is named, or all of them.
    """
    for end in range(len(location), -1, -1):
        key, value, path = _locate(root, location[:end])
        if path == location[:end]:
            break
    if path == location and isinstance(value, yaml.ScalarNode):
        message += f" (got {show(value, location)}){_nearest(str(value.value), choices)}"
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
    candidates: list[object] = list(_members(model))
    for part in loc[:-1]:
        inner = [member for kind in candidates for member in _step(kind, part)]
        named = [kind for kind in candidates if _is_tagged(kind, part)]
        candidates = inner or named or candidates
    models = [kind for kind in candidates if _is_model(kind)]
    return {field.alias or name for kind in models for name, field in kind.model_fields.items()}


def _members(annotation: object) -> Iterator[object]:
    """Yield the types that an annotation allows: itself, or each member of a union."""
    if hasattr(annotation, "__metadata__"):  # Annotated[X, ...]
        yield from _members(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, types.UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _step(kind: object, part: int | str) -> Iterator[object]:
    """Yield what lies one part of a path below a type."""
    if _is_model(kind) and part in kind.model_fields:
        yield from _members(kind.model_fields[str(part)].annotation)
    elif isinstance(part, int) and get_origin(kind) in (list, tuple) and get_args(kind):
        yield from _members(get_args(kind)[0])
    elif isinstance(part, str) and get_origin(kind) is dict:
        yield from _members(get_args(kind)[1])


def _is_model(kind: object) -> TypeGuard[type[BaseModel]]:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _is_tagged(kind: object, part: int | str) -> bool:
    """Tell whether pydantic names this member of a union `part`: by class, or by a literal."""
    if not _is_model(kind):
        return False
    literals = (get_args(field.annotation) for field in kind.model_fields.values())
    return bool(kind.__name__ == part or any(part in values for values in literals))
