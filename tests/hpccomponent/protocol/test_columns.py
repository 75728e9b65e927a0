from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from numpy.typing import NDArray

from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.columns import Bounds, Column, pattern_of
from hpccomponent.protocol.declared import Exactly, check_result

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    nodes: Annotated[IntArray, Column("p", 2, low=0)]
    starts: Annotated[IntArray, Column("p+1", rises=True)]
    lengths: Annotated[NDArray[np.float32], Column("p", low=0.0, finite=False, unit="metres")]
    kind: int


def make_paths(nodes: object = ((0, 1), (1, 2)), kind: int = 3) -> Paths:
    return Paths(np.array(nodes), np.arange(3), np.array([1.0, np.inf], np.float32), kind)


def test_fields_say_dtype_shape_and_range() -> None:
    pattern = pattern_of(Paths)
    check_result(pattern, make_paths())
    for wrong, said in (
        (make_paths([[0, 1], [1, -1]]), "nodes has entries below 0"),
        (make_paths([[0.0, 1.0]]), "nodes has the dtype <f8, not <i8"),
        (make_paths([[0, 1]]), r"starts has the shape \(3,\), not \(p\+1,\) with p = 1"),
        (make_paths(kind=-1), "kind is not from 0"),
    ):
        with pytest.raises(ProtocolError, match=said):
            check_result(pattern, wrong)


def test_a_task_adds_what_its_arguments_say() -> None:
    even = Bounds(high=8, agrees=lambda nodes: not (nodes % 2).any(), rule="nodes are even")
    pattern = pattern_of(Paths, {"p": 2}, nodes=even, kind=Exactly(3))
    check_result(pattern, make_paths([[0, 2], [2, 8]]))
    for wrong, said in (
        (make_paths([[0, 2], [2, 10]]), "above 8"),
        (make_paths([[0, 2], [2, 7]]), "nodes are even"),
        (make_paths([[0, -2], [2, 8]]), "below 0"),  # what the field says still holds
        (make_paths([[0, 2]]), r"not \(2, 2\)"),
        (make_paths([[0, 2], [2, 8]], 4), "kind is not 3"),
    ):
        with pytest.raises(ProtocolError, match=said):
            check_result(pattern, wrong)


def test_a_field_that_is_not_there_or_says_nothing_is_a_mistake() -> None:
    @dataclass(frozen=True)
    class Silent:
        rows: IntArray

    with pytest.raises(TypeError, match="no ends"):
        pattern_of(Paths, ends=Bounds())
    with pytest.raises(TypeError, match="no Column"):
        pattern_of(Silent)
