from __future__ import annotations

import math
from importlib.metadata import entry_points

import pytest

from hpccomponent.errors import UsageError
from hpccomponent.runtime.tasks import (
    TASK_GROUP,
    TaskRegistry,
    Traits,
    declare,
    traits_of,
)


def test_extra_tasks_are_found_by_name_and_by_function() -> None:
    registry = TaskRegistry(["a.root=math:sqrt", "a.up=math:ceil"])
    assert registry.resolve("a.root") is math.sqrt
    assert registry.name_of(math.ceil) == "a.up"
    assert registry.name_of("a.root") == "a.root"


def test_every_installed_task_can_be_imported_and_is_found_by_its_function() -> None:
    registry = TaskRegistry()
    for entry in entry_points(group=TASK_GROUP):
        function = registry.resolve(entry.name)
        assert registry.name_of(function) == entry.name


@pytest.mark.parametrize(
    "entry", ["", "name", "=math:sqrt", "n=math", "n=math:", "n=o;x:y", "n=a:b.c"]
)
def test_malformed_entries_are_refused(entry: str) -> None:
    with pytest.raises(UsageError, match="NAME=module:function"):
        TaskRegistry([entry])


def test_one_name_for_two_functions_is_refused() -> None:
    TaskRegistry(["a=math:sqrt", "a=math:sqrt"])
    with pytest.raises(UsageError, match="given twice"):
        TaskRegistry(["a=math:sqrt", "a=math:ceil"])


@pytest.mark.parametrize(
    ("entry", "word"),
    [
        ("a=no_such_module:f", "cannot be imported"),
        ("a=math:no_such_function", "cannot be imported"),
        ("a=math:pi", "not a function"),
        ("b=math:sqrt", "no task is registered"),
    ],
)
def test_what_cannot_be_resolved_says_why(entry: str, word: str) -> None:
    with pytest.raises(UsageError, match=word):
        TaskRegistry([entry]).resolve("a")


@pytest.mark.parametrize("task", [math.ceil, lambda: None, "b", 5])
def test_what_is_not_registered_has_no_name(task: object) -> None:
    with pytest.raises(UsageError, match="not a registered task"):
        TaskRegistry(["a=math:sqrt"]).name_of(task)  # type: ignore[arg-type]


def test_a_task_is_run_for_each_item_under_its_name_with_a_prefix() -> None:
    registry = TaskRegistry(["a.root=math:sqrt"])
    assert registry.resolve("each:a.root")([4.0, 9.0]) == [2.0, 3.0]


def test_a_declared_task_stays_a_plain_function() -> None:
    @declare(cost=abs)
    def task(value: float) -> float:
        return value + 1.0

    assert task(1.0) == 2.0
    assert traits_of(task).cost is abs
    assert traits_of(math.sqrt) == traits_of("a.root") == Traits()


def test_split_and_join_belong_together() -> None:
    with pytest.raises(UsageError, match="only one of split and join"):
        declare(split=lambda values: [(values,)])
