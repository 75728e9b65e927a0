"""JSON of somebody else: a value of the wanted type, or one line."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated

import pytest
from msgspec import Meta

from hpccomponent.foreign_json import decode


@dataclass(frozen=True, slots=True)
class Told:
    name: Annotated[str, Meta(pattern=r"^[a-z]+\Z")]
    count: Annotated[int, Meta(ge=0, le=9)] = 0


def test_what_is_right_is_read_and_what_is_new_is_left_out() -> None:
    assert decode(b'{"name": "a", "later": [1]}', Told) == Told("a")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "{}",
        '{"name": 1}',
        '{"name": "a\\n"}',
        '{"name": "../a"}',
        '{"name": "a", "count": -1}',
        '{"name": "a", "count": 1e3}',
        '{"name": "a", "count": true}',
        '{"name": "a", "count": NaN}',
        '{"name": "a", "count": -Infinity}',
        '{"name": "a", "count": ' + "9" * 5000 + "}",
        "[" * 100_000,
        '{"name": ' * 100_000,
        b"\xff",
        b'{"name": "\xff"}',
    ],
)
def test_anything_else_is_one_line(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        decode(text, Told)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_names_that_are_not_utf_8_survive() -> None:
    name = b"\xff.ply".decode(errors="surrogateescape")
    assert decode(json.dumps([name]), list[object]) == [name]
