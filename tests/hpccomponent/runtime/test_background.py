"""Background work is done in turn where it is enabled, and is kept nowhere else."""

from __future__ import annotations

from functools import partial

from hpccomponent.runtime.background import Background


def fail() -> bool:
    raise ValueError("nobody needs it")


def do_step(done: list[str], name: str, steps: int) -> bool:
    done.append(name)
    return done.count(name) < steps


def test_work_is_done_in_turn_whatever_fails() -> None:
    done: list[str] = []
    work = Background()
    work.enable()
    for name, steps in (("first", 1), ("second", 3)):
        work.add(partial(do_step, done, name, steps))
        work.add(fail)
    for _ in range(6):
        assert work
        work.run_one()
    assert not work
    assert done == ["first", *["second"] * 3]


def test_nothing_is_kept_where_it_is_not_enabled() -> None:
    work = Background()
    work.add(fail)
    work.enable()
    assert not work
