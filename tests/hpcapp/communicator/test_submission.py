from __future__ import annotations

from concurrent.futures import Future

import numpy as np
import pytest

from hpcapp.communicator.submission import (
    Submission,
    each_traits,
    make_submission,
    split_submission,
)
from hpccomponent.errors import TaskError, UsageError
from hpccomponent.protocol.frames import DEFAULT_RESULT_BYTES
from hpccomponent.runtime.tasks import Traits


def halves(values: list[int]) -> list[tuple[list[int]]] | None:
    middle = len(values) // 2
    return [(values[:middle],), (values[middle:],)] if middle else None


TRAITS = Traits(cost=len, split=halves, join=sum)


def entry_of(values: list[int], traits: Traits = TRAITS) -> Submission:
    future: Future[object] = Future()
    future.set_running_or_notify_cancel()
    return make_submission(future, "total", (values,), traits)


def test_a_task_costs_what_it_declares_or_one() -> None:
    assert entry_of([1, 2, 3]).work == 3.0
    assert entry_of([1, 2, 3], Traits()).work == 1.0


@pytest.mark.parametrize("cost", [0.0, -1.0, float("nan"), float("inf")])
def test_a_cost_that_is_no_positive_number_is_refused(cost: float) -> None:
    with pytest.raises(UsageError, match="declares a cost"):
        entry_of([1], Traits(cost=lambda _: cost))


def test_a_split_task_is_done_when_its_parts_are() -> None:
    submission = entry_of([1, 2, 3])
    parts = split_submission(submission)
    assert [part.work for part in parts] == [1.0, 2.0]
    parts[1].future.set_result(5)
    assert not submission.future.done()
    parts[0].future.set_result(1)
    assert submission.future.result(0) == 6


def test_a_task_fails_with_its_first_part_that_does() -> None:
    submission = entry_of([1, 2, 3])
    one, other = split_submission(submission)
    one.future.set_exception(TaskError("no luck"))
    other.future.set_result(5)
    with pytest.raises(TaskError, match="no luck"):
        submission.future.result(0)


def test_what_cannot_be_split_is_not() -> None:
    assert split_submission(entry_of([1])) == []
    assert split_submission(entry_of([1, 2], Traits())) == []


def test_what_fails_in_the_master_is_told_in_words() -> None:
    with pytest.raises(TaskError, match=r"'total' could not be split: ZeroDivisionError"):
        split_submission(entry_of([1], Traits(split=lambda _: 1 / 0, join=sum)))  # type: ignore
    submission = entry_of([1, 2], Traits(split=halves, join=lambda _: 1 / 0))
    for part in split_submission(submission):
        part.future.set_result(1)
    with pytest.raises(TaskError, match="could not be joined"):
        submission.future.result(0)


def test_a_part_of_a_map_costs_as_its_items_and_is_halved() -> None:
    traits = each_traits(Traits(cost=lambda values: float(values.size)))
    items = [np.zeros(n) for n in (1, 2, 3)]
    assert traits.cost is not None
    assert traits.split is not None
    assert traits.join is not None
    assert traits.cost(items) == 6.0
    assert each_traits(Traits()).cost(items) == 3.0  # type: ignore[misc]
    assert [len(part) for (part,) in traits.split(items) or ()] == [1, 2]
    assert traits.split(items[:1]) is None
    both = traits.split([1, 2, 3, 4], list("abcd"))
    assert both == [([1, 2], ["a", "b"]), ([3, 4], ["c", "d"])]
    assert traits.join([[1], [2, 3]]) == [1, 2, 3]


def test_tasks_that_are_mapped_may_answer_as_much_as_each_may() -> None:
    traits = each_traits(Traits(limit=lambda number: 100 * number))
    assert 600 < traits.limit_of(([1, 2, 3],)) < 1000
    assert each_traits(Traits()).limit_of(([1, 2, 3],)) == DEFAULT_RESULT_BYTES
