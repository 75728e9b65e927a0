from __future__ import annotations

from collections.abc import Callable

import pytest

from hpcapp.communicator.scheduling.policy import AdaptivePolicy, EqualPolicy, PullPolicy
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.state import (
    Action,
    AskRegister,
    Assign,
    Deliver,
    Fail,
    Forgotten,
    Refuse,
    Task,
    Welcome,
)
from hpccomponent.clock import ManualClock
from hpccomponent.errors import NoWorkersError, WorkerLostError
from hpccomponent.protocol.blobs import Blob
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Failure, Register, Result

OK = 0.001  # seconds that a task takes


def introduce(name: str = "w", **changes: object) -> Register:
    fields: dict[str, object] = {
        "protocol": PROTOCOL_VERSION,
        "package": "1",
        "worker": name,
        "incarnation": "i",
        "build": "portable",
        "numerics": "n",
        "cores": 1,
        "memory_bytes": 1,
        "largest_frame": 1 << 20,
    }
    return Register(**(fields | changes))  # type: ignore[arg-type]


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def scheduler(clock: ManualClock) -> Scheduler:
    return Scheduler(PullPolicy(), clock, "1", lambda _: True)


def submit(scheduler: Scheduler, count: int, size: int = 10) -> list[Action]:
    first = len(scheduler.tasks)
    for number in range(first, first + count):
        assert not scheduler.submit(Task(number, "t", size))
    return scheduler.dispatch()


def assigned(actions: list[Action]) -> list[tuple[bytes, tuple[int, ...]]]:
    return [(action.worker, action.tasks) for action in actions if isinstance(action, Assign)]


def finish(scheduler: Scheduler, assign: Action, seconds: float = OK) -> list[Action]:
    assert isinstance(assign, Assign)
    results = [Result(number, seconds, b"", []) for number in assign.tasks]
    return scheduler.results(assign.worker, assign.batch, results, True, lambda _: b"")


def errors(actions: list[Action]) -> list[Exception]:
    return [action.error for action in actions if isinstance(action, Fail)]


def fail(scheduler: Scheduler, assign: Action) -> list[Action]:
    assert isinstance(assign, Assign)
    failure = Failure("ValueError", "ValueError: a bad number", "", "")
    results = [Result(number, OK, b"", [], failure) for number in assign.tasks]
    return scheduler.results(assign.worker, assign.batch, results, True, lambda _: b"")


def delivered(actions: list[Action]) -> list[bool]:
    """Return for each result that is delivered whether it is one."""
    return [action.result.failure is None for action in actions if isinstance(action, Deliver)]


def test_what_fails_on_one_machine_alone_is_no_failure(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce("a"))
    (first,) = submit(scheduler, 1)
    scheduler.register(b"b", introduce("b"))
    actions = fail(scheduler, first)
    assert delivered(actions) == []
    (again,) = actions
    assert assigned([again]) == [(b"b", (0,))]
    assert delivered(finish(scheduler, again)) == [True]
    assert scheduler.counts["doubted"] == 1


@pytest.mark.parametrize("is_lost", [False, True])
def test_a_failure_that_comes_twice_or_late_is_not_believed(
    scheduler: Scheduler, is_lost: bool
) -> None:
    scheduler.register(b"a", introduce("a"))
    (first,) = submit(scheduler, 1)
    second = first
    if is_lost:  # its old batch is still at work when it comes again and is given the task anew
        scheduler.disconnected([b"a"], "it has been silent")
        _, second = scheduler.register(b"a", introduce("a"))
    scheduler.register(b"b", introduce("b"))
    actions = fail(scheduler, first) + fail(scheduler, second)
    assert delivered(actions) == []
    (again,) = actions
    assert assigned([again]) == [(b"b", (0,))]
    assert delivered(fail(scheduler, first) + finish(scheduler, again)) == [True]
    assert (scheduler.counts["doubted"], scheduler.counts["dropped"]) == (1, 2)


def test_no_machine_confirms_its_own_failure(scheduler: Scheduler) -> None:
    for name in (b"a", b"b"):
        scheduler.register(name, introduce(name.decode()))
    (first,) = submit(scheduler, 1)
    fail(scheduler, first)
    (second,) = scheduler.goodbye(b"b", "it was told to")
    scheduler.register(b"c", introduce("c"))
    (third,) = fail(scheduler, second)
    assert assigned([second, third]) == [(b"a", (0,)), (b"c", (0,))]
    assert delivered(fail(scheduler, third)) == [False]


def test_what_two_machines_fail_at_is_a_failure_and_held_against_neither(
    scheduler: Scheduler,
) -> None:
    for name in (b"a", b"b", b"c"):
        scheduler.register(name, introduce(name.decode()))
    for _ in range(10):
        (first,) = submit(scheduler, 1)
        (second,) = fail(scheduler, first)
        assert delivered(fail(scheduler, second)) == [False]
        assert not scheduler.tasks
    assert not any(worker.is_retired for worker in scheduler.workers.values())


def test_a_machine_that_fails_at_what_others_can_do_is_retired(scheduler: Scheduler) -> None:
    for name in (b"a", b"b"):
        scheduler.register(name, introduce(name.decode()))
    for _ in range(10):
        waiting = submit(scheduler, 1)
        while waiting:
            act = finish if waiting[0].worker == b"b" else fail  # type: ignore[union-attr]
            actions = act(scheduler, waiting.pop())
            assert all(delivered(actions))
            waiting += [action for action in actions if isinstance(action, Assign)]
        if scheduler.workers[b"a"].is_retired:
            return
    raise AssertionError("it still gets tasks")


def test_the_only_machine_is_believed(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce("a"))
    (first,) = submit(scheduler, 1)
    assert delivered(fail(scheduler, first)) == [False]


@pytest.mark.parametrize(
    ("register", "word"),
    [
        (introduce(protocol=99), "protocol"),
        (introduce(package="2"), "hpcapp 2"),
        (introduce(numerics="other"), "last bits"),
        (introduce(largest_frame=10), "frame"),
    ],
)
def test_a_worker_that_does_not_fit_is_refused_with_a_reason(
    scheduler: Scheduler, register: Register, word: str
) -> None:
    scheduler.register(b"first", introduce("first"))
    (refuse,) = scheduler.register(b"second", register)
    assert isinstance(refuse, Refuse)
    assert word in refuse.reason
    assert list(scheduler.workers) == [b"first"]


def test_another_key_cannot_take_over_a_name_at_work(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce("w"), key="one")
    (refuse,) = scheduler.register(b"b", introduce("w"), key="two")
    assert isinstance(refuse, Refuse)
    assert list(scheduler.workers) == [b"a"]


def test_pull_levels_queues_one_for_all_then_two(scheduler: Scheduler) -> None:
    for name in (b"a", b"b", b"c"):
        scheduler.register(name, introduce(name.decode()))
    order = [worker for worker, _ in assigned(submit(scheduler, 20))]
    assert order == [b"a", b"b", b"c", b"a", b"b", b"c"]


def test_equal_gives_every_worker_the_same_number_in_advance(clock: ManualClock) -> None:
    scheduler = Scheduler(EqualPolicy(), clock, "1", lambda _: True)
    for name in (b"a", b"b", b"c"):
        scheduler.register(name, introduce(name.decode()))
    pending = [action for action in submit(scheduler, 300) if isinstance(action, Assign)]
    share = dict.fromkeys((b"a", b"b", b"c"), 0)
    while pending:  # the first worker is the fastest: it may not take from the others
        pending.sort(key=lambda assign: assign.worker)
        assign = pending.pop(0)
        share[assign.worker] += len(assign.tasks)
        pending += [a for a in finish(scheduler, assign) if isinstance(a, Assign)]
    assert share == {b"a": 100, b"b": 100, b"c": 100}


def test_what_a_lost_worker_leaves_is_spread_equally(clock: ManualClock) -> None:
    scheduler = Scheduler(EqualPolicy(), clock, "1", lambda _: True)
    for name in (b"a", b"b", b"c"):
        scheduler.register(name, introduce(name.decode()))
    *_, last = submit(scheduler, 90)
    scheduler.disconnected([b"a"], "it died")
    finish(scheduler, last)  # the one that was at work there goes to who has room first
    assert [worker.placed for worker in scheduler.workers.values()] == [45, 45]


def test_short_tasks_share_a_batch_and_long_ones_do_not(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    first, second = submit(scheduler, 200)
    assert len(first.tasks) == 1  # type: ignore[union-attr]  # nothing is known of their duration
    (quick,) = assigned(finish(scheduler, first))
    assert len(quick[1]) > 40
    (slow,) = assigned(finish(scheduler, second, seconds=2.0))
    assert len(slow[1]) == 1


def test_large_tasks_do_not_share_a_batch(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    first, _ = submit(scheduler, 200, size=400_000)
    (batch,) = assigned(finish(scheduler, first))
    assert len(batch[1]) == 2


def test_a_result_that_comes_twice_is_dropped(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    (assign,) = submit(scheduler, 1)
    assert [type(action) for action in finish(scheduler, assign)] == [Deliver]
    assert finish(scheduler, assign) == []
    assert scheduler.counts["dropped"] == 1


def test_a_result_of_a_worker_given_up_is_asked_to_register_again(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    (assign,) = submit(scheduler, 1)
    scheduler.disconnected([b"a"], "its connection broke")
    assert finish(scheduler, assign) == [AskRegister(b"a")]
    again = scheduler.register(b"a", introduce())
    assert isinstance(again[0], Welcome)
    # The first answer still counts, although the batch that it belonged to is forgotten.
    assert Deliver in [type(action) for action in finish(scheduler, assign)]
    assert not scheduler.tasks


def lose_by_disconnection(scheduler: Scheduler, assign: Assign) -> list[Action]:
    return scheduler.disconnected([assign.worker], "its connection broke")


def lose_by_crash(scheduler: Scheduler, assign: Assign) -> list[Action]:
    return scheduler.batch_lost(assign.worker, assign.batch, "signal 9", True)


def test_no_task_is_blamed_for_many_connections_that_break_at_once(scheduler: Scheduler) -> None:
    names = [b"a", b"b", b"c", b"d"]
    for name in names:
        scheduler.register(name, introduce(name.decode()))
    submit(scheduler, 1)
    assert scheduler.disconnected(names, "its connection broke") == []
    again = scheduler.register(b"e", introduce("e"))
    assert assigned(again) == [(b"e", (0,))]


def test_no_task_is_blamed_for_workers_that_it_never_got_to(scheduler: Scheduler) -> None:
    names = [b"a", b"b", b"c", b"d", b"e"]
    for name in names:
        scheduler.register(name, introduce(name.decode()))
    (assign,) = submit(scheduler, 1)
    for _ in names[1:]:
        assert isinstance(assign, Assign)
        (assign,) = scheduler.undelivered(assign.worker, assign.batch, "its connection broke")
    assert isinstance(assign, Assign)
    assert len(scheduler.workers) == 1


@pytest.mark.parametrize("lose", [lose_by_disconnection, lose_by_crash])
def test_a_task_is_given_up_with_the_third_worker(
    scheduler: Scheduler, lose: Callable[[Scheduler, Assign], list[Action]]
) -> None:
    for name in (b"a", b"b", b"c", b"d"):
        scheduler.register(name, introduce(name.decode()))
    (assign,) = submit(scheduler, 1)
    for _ in range(2):
        assert isinstance(assign, Assign)
        (assign,) = lose(scheduler, assign)
    (fail,) = lose(scheduler, assign)  # type: ignore[arg-type]
    assert isinstance(fail, Fail)
    assert isinstance(fail.error, WorkerLostError)
    assert "3 workers" in str(fail.error)


def test_preemption_is_not_held_against_a_task(scheduler: Scheduler) -> None:
    submit(scheduler, 1)
    for number in range(10):
        actions = scheduler.register(b"%d" % number, introduce(str(number)))
        assert len(assigned(actions)) == 1
        assert scheduler.goodbye(b"%d" % number, "preempted") == []
    assert not scheduler.tasks[0].losses


def test_a_drained_worker_gets_nothing_more(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    scheduler.drain(b"a")
    assert submit(scheduler, 5) == []
    assert len(assigned(scheduler.register(b"b", introduce("b")))) == 2


def test_a_revoked_key_is_expelled(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce(), key="k")
    submit(scheduler, 1)
    (refuse,) = scheduler.expel("k")
    assert refuse == Refuse(b"a", "its key was revoked")
    assert not scheduler.workers
    assert not scheduler.tasks[0].losses


def test_a_silent_worker_is_lost(scheduler: Scheduler, clock: ManualClock) -> None:
    scheduler.register(b"a", introduce("a"))
    scheduler.register(b"b", introduce("b"))
    submit(scheduler, 1)
    clock.advance(14.0)
    scheduler.heartbeat(b"b", 0, 0, [])
    clock.advance(2.0)
    assert assigned(scheduler.tick()) == [(b"b", (0,))]
    assert list(scheduler.workers) == [b"b"]


def test_tasks_fail_when_no_worker_ever_comes(scheduler: Scheduler, clock: ManualClock) -> None:
    clock.advance(1000.0)  # the deadline counts from the first task, not from the start
    submit(scheduler, 2)
    clock.advance(59.0)
    assert scheduler.tick() == []
    clock.advance(2.0)
    assert [type(error) for error in errors(scheduler.tick())] == [NoWorkersError] * 2


def test_tasks_fail_at_once_when_all_workers_are_gone(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    submit(scheduler, 2)
    assert scheduler.workers_gone("all loaders have ended") == []
    (first, _) = errors(scheduler.disconnected([b"a"], "its connection broke"))
    assert "all loaders have ended" in str(first)
    (later,) = errors(scheduler.submit(Task(7, "t", 1)))
    assert isinstance(later, NoWorkersError)


def test_the_launchers_word_outlives_a_registration_that_was_on_its_way(
    scheduler: Scheduler,
) -> None:
    submit(scheduler, 1)
    scheduler.register(b"a", introduce())
    scheduler.workers_gone("all loaders have ended")
    scheduler.register(b"b", introduce("b"))
    scheduler.disconnected([b"a"], "its connection broke")
    (error,) = errors(scheduler.disconnected([b"b"], "its connection broke"))
    assert "all loaders have ended" in str(error)


def test_cancelled_tasks_never_leave(clock: ManualClock) -> None:
    scheduler = Scheduler(PullPolicy(), clock, "1", lambda number: number != 0)
    submit(scheduler, 3)
    scheduler.cancel(1)
    actions = scheduler.register(b"a", introduce())
    assert [numbers for _, numbers in assigned(actions)] == [(2,)]


def test_a_new_incarnation_replaces_the_old_at_once(scheduler: Scheduler) -> None:
    scheduler.register(b"a/1", introduce("a", incarnation="1"))
    submit(scheduler, 1)
    actions = scheduler.register(b"a/2", introduce("a", incarnation="2"))
    assert assigned(actions) == [(b"a/2", (0,))]
    assert list(scheduler.workers) == [b"a/2"]


def blob(number: int, size_bytes: int = 1000) -> Blob:
    return Blob(number.to_bytes(16, "little"), b"", (), size_bytes)


def sent_blobs(actions: list[Action]) -> list[tuple[bytes, list[Blob]]]:
    return [(a.worker, list(a.blobs)) for a in actions if isinstance(a, Assign)]


def test_a_blob_is_sent_to_a_worker_once(scheduler: Scheduler) -> None:
    shared = blob(1)
    scheduler.register(b"a", introduce())
    for number in range(20):
        scheduler.submit(Task(number, "t", 10, (shared,)))
    actions = scheduler.dispatch()
    assert sent_blobs(actions) == [(b"a", [shared]), (b"a", [])]
    while assigns := [action for action in actions if isinstance(action, Assign)]:
        actions = [action for assign in assigns for action in finish(scheduler, assign)]
        assert not any(blobs for _, blobs in sent_blobs(actions))
    assert scheduler.forget(shared.key) == [Forgotten(b"a", shared.key)]
    assert scheduler.forget(shared.key) == []


def test_a_blob_that_is_missing_is_sent_again_with_its_batch(scheduler: Scheduler) -> None:
    shared = blob(1)
    scheduler.register(b"a", introduce())
    scheduler.submit(Task(0, "t", 10, (shared,)))
    (assign,) = scheduler.dispatch()
    assert isinstance(assign, Assign)
    actions = scheduler.need(b"a", assign.batch, [shared.key])
    assert sent_blobs(actions) == [(b"a", [shared])]
    assert not scheduler.tasks[0].losses
    actions = scheduler.register(b"a2", introduce(incarnation="2"))  # a new one has nothing
    assert sent_blobs(actions) == [(b"a2", [shared])]


def test_workers_get_tasks_whose_blobs_they_have_and_never_wait_for_them(
    scheduler: Scheduler,
) -> None:
    blobs = [blob(number) for number in range(8)]
    for name in (b"a", b"b"):
        scheduler.register(name, introduce(name.decode()))
    for number in range(40):
        scheduler.submit(Task(number, "t", 2_000_000, (blobs[number % 8],)))
    pending = [action for action in scheduler.dispatch() if isinstance(action, Assign)]
    transfers = 0
    while pending:
        assign = pending.pop(0)
        transfers += len(assign.blobs)
        pending += [a for a in finish(scheduler, assign) if isinstance(a, Assign)]
        assert not scheduler.dispatcher.queue or all(
            w.queued == 2 for w in scheduler.workers.values()
        )
    assert transfers <= 9  # where 16 are possible


def test_an_idle_worker_that_has_the_blobs_of_a_task_gets_it(scheduler: Scheduler) -> None:
    """Though tasks come one by one, and each could go to the first that is idle."""
    names = [b"a", b"b", b"c"]
    for name in names:
        scheduler.register(name, introduce(name.decode()))
    for number in range(3):
        scheduler.submit(Task(number, "t", 10, (blob(number),)))
    first = scheduler.dispatch()
    had = {tasks[0]: worker for worker, tasks in assigned(first)}
    assert sorted(had.values()) == names
    for assign in first:
        finish(scheduler, assign)
    for number in (2, 0, 1):
        scheduler.submit(Task(3 + number, "t", 10, (blob(number),)))
        actions = scheduler.dispatch()
        assert assigned(actions) == [(had[number], (3 + number,))]
        assert sent_blobs(actions) == [(had[number], [])]


def test_of_two_workers_that_have_the_blobs_of_a_task_the_one_that_has_less_gets_it(
    clock: ManualClock,
) -> None:
    """Or the task whose blob only the other one has would go to a third, and so on."""
    scheduler = Scheduler(AdaptivePolicy(), clock, "1", lambda _: True)
    names = [b"a", b"b", b"c"]
    for name in names:
        scheduler.register(name, introduce(name.decode()))
    for number in range(3):
        scheduler.submit(Task(number, "t", 10, (blob(number),)))
    first, last, other = (action for action in scheduler.dispatch() if isinstance(action, Assign))
    clock.advance(1.0)
    actions = finish(scheduler, first) + finish(scheduler, other)
    clock.advance(9.0)  # the last one lags
    again = next(action for action in actions + scheduler.tick() if isinstance(action, Assign))
    assert again.tasks == last.tasks
    assert not any(isinstance(action, Assign) for action in finish(scheduler, again))
    finish(scheduler, last)
    scheduler.submit(Task(3, "t", 10, last.blobs))
    assert assigned(scheduler.dispatch()) == [(last.worker, (3,))]
    scheduler.submit(Task(4, "t", 10, first.blobs if again.worker == first.worker else other.blobs))
    assert assigned(scheduler.dispatch()) == [(again.worker, (4,))]


def test_the_first_task_of_a_name_goes_to_who_was_fastest_with_others(clock: ManualClock) -> None:
    scheduler = Scheduler(AdaptivePolicy(), clock, "1", lambda _: True)
    for name in (b"slow", b"fast"):
        scheduler.register(name, introduce(name.decode()))
    for assign in submit(scheduler, 2):
        assert isinstance(assign, Assign)
        finish(scheduler, assign, 4.0 if assign.worker == b"slow" else 1.0)
    scheduler.submit(Task(7, "another", 10))
    assert assigned(scheduler.dispatch()) == [(b"fast", (7,))]


def test_blobs_that_must_travel_count_as_bytes_of_the_batch(scheduler: Scheduler) -> None:
    scheduler.register(b"a", introduce())
    for number in range(200):
        scheduler.submit(Task(number, "t", 10, (blob(number, 400_000),)))
    first, _ = scheduler.dispatch()
    (batch,) = assigned(finish(scheduler, first))
    assert len(batch[1]) == 2
