"""Calls of a cloud: lists come page by page, and end."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest

from hpccomponent.errors import CloudError
from hpcdeploy.providers.ec2.client import Calls, Described


class Pages:
    """A cloud whose only list names its next page by these tokens."""

    def __init__(self, tokens: Iterator[str]) -> None:
        self._tokens = tokens

    def describe_things(self, **parameters: str) -> dict[str, object]:
        return {
            "Things": [{"Name": parameters.get("NextToken", "first")}],
            "NextToken": next(self._tokens, ""),
        }


def things(tokens: Iterator[str]) -> list[Described]:
    return Calls(Pages(tokens), "the cloud").all_of("describe_things", "Things", "list things")


def test_all_pages_of_a_list_come() -> None:
    names = [thing["Name"] for thing in things(iter(["b", "c"]))]
    assert names == ["first", "b", "c"]


@pytest.mark.parametrize(
    "tokens", [itertools.repeat("again"), map(str, itertools.count())], ids=["same", "new"]
)
def test_a_list_without_an_end_is_refused(tokens: Iterator[str]) -> None:
    with pytest.raises(CloudError, match="the cloud: cannot list things: its list has no end"):
        things(tokens)
