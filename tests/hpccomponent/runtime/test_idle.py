"""Work for idle times is done in turn where somebody serves it, and is kept nowhere else."""

from hpccomponent.runtime.idle import IdleWork


def fail() -> None:
    raise ValueError("nobody needs it")


def test_work_is_done_in_turn_whatever_fails() -> None:
    done: list[str] = []
    work = IdleWork()
    work.serve()
    work.add(lambda: done.append("first"))
    work.add(fail)
    work.add(lambda: done.append("last"))
    for _ in range(3):
        assert work
        work.run_one()
    assert not work
    assert done == ["first", "last"]


def test_nothing_is_kept_where_nobody_serves_it() -> None:
    work = IdleWork()
    work.add(fail)
    work.serve()
    assert not work
