from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from hpccomponent.protocol.messages import (
    Batch,
    Call,
    ComponentMessage,
    Drain,
    Farewell,
    Forget,
    Goodbye,
    Heartbeat,
    Lost,
    MasterMessage,
    Need,
    Ping,
    Refused,
    Register,
    RegisterAgain,
    Registered,
    Results,
    Share,
    encode_message,
)
from hpccomponent.protocol.session import (
    MAX_CRASHES,
    WINDOW,
    Action,
    Discard,
    ExitCode,
    Keep,
    RunBatch,
    Send,
    StartWorker,
    Stop,
    WorkerSession,
)

REGISTER = Register(1, "1", "w", "i", "b", "n", 1, 1, 1 << 20)
WELCOME = Registered("s", 1.0, 10.0, 1 << 20)


def joined(worker_is_up: bool = True) -> WorkerSession:
    session = WorkerSession(REGISTER, 0.0)
    session.begin()
    session.receive(WELCOME, (), 0.0)
    if worker_is_up:
        session.worker_started()
    return session


def batch(number: int, session: str = "s") -> Batch:
    return Batch(session, number, [Call(number, "t", b"", [])])


KEY, OTHER_KEY = b"k" * 16, b"o" * 16


def naming(number: int, *keys: bytes) -> Batch:
    return Batch("s", number, [Call(number, "t", b"", [], list(keys))])


def finished(number: int) -> tuple[Results, bytes, memoryview]:
    results = Results("s", number, [], True)
    return results, encode_message(results), memoryview(b"")


def runs(actions: list[Action]) -> list[tuple[int, list[bytes]]]:
    return [(a.batch.batch, list(a.blobs)) for a in actions if isinstance(a, RunBatch)]


def sent(actions: list[Action]) -> list[ComponentMessage]:
    return [action.message for action in actions if isinstance(action, Send)]


def test_it_introduces_itself_until_it_is_heard() -> None:
    session = WorkerSession(REGISTER, 0.0)
    assert session.begin() == [Send(REGISTER), StartWorker(0.0)]
    assert session.tick(1.0) == []
    assert session.tick(2.5) == [Send(REGISTER)]
    session.receive(WELCOME, (), 3.0)
    assert sent(session.tick(4.5)) == [Heartbeat("s", 0, 0, [])]


def test_a_refusal_ends_it_with_the_reason() -> None:
    (stop,) = joined().receive(Refused("wrong version"), (), 0.0)
    assert isinstance(stop, Stop)
    assert stop.code is ExitCode.REFUSED
    assert "wrong version" in stop.reason


def test_two_batches_are_in_the_channel_and_the_others_wait() -> None:
    session = joined()
    runs = [session.receive(batch(n), (), 0.0) for n in range(3)]
    assert [len(actions) for actions in runs] == [1, 1, 0]
    actions = session.worker_results(*finished(0), 0.0)
    assert [a.batch.batch for a in actions if isinstance(a, RunBatch)] == [2]


def test_heartbeats_acknowledge_what_was_received() -> None:
    session = joined()
    session.receive(batch(4), (), 0.0)
    session.receive(Ping("s", 5), (), 0.0)
    assert sent(session.tick(1.5)) == [Heartbeat("s", 0, 5, [4])]


def test_messages_of_another_session_and_repeated_batches_are_dropped() -> None:
    session = joined()
    assert session.receive(batch(0, "other"), (), 0.0) == []
    assert session.receive(Farewell("other"), (), 0.0) == []
    session.receive(batch(1), (), 0.0)
    assert session.receive(batch(1), (), 0.0) == []
    assert session.dropped == 3


def test_a_dead_worker_is_reported_blamed_once_and_started_again() -> None:
    session = joined()
    session.receive(batch(1), (), 0.0)
    session.receive(batch(2), (), 0.0)
    session.receive(batch(3), (), 0.0)
    actions = session.worker_died("signal 9")
    assert sent(actions) == [Lost("s", 1, "signal 9", True), Lost("s", 2, "signal 9", False)]
    assert actions[-1] == StartWorker(0.0)
    assert [a.batch.batch for a in session.worker_started() if isinstance(a, RunBatch)] == [3]


def test_backoff_grows_and_ends() -> None:
    session = joined()
    delays = []
    for _ in range(MAX_CRASHES - 1):
        delays += [a.delay_s for a in session.worker_died("it") if isinstance(a, StartWorker)]
        session.worker_started()
    assert delays == sorted(delays)
    actions = session.worker_died("it")
    assert isinstance(sent(actions)[-1], Goodbye)
    assert isinstance(actions[-1], Stop)
    assert actions[-1].code is ExitCode.WORKER_CRASHES


def test_a_finished_batch_forgives_crashes() -> None:
    session = joined()
    for number in range(3 * MAX_CRASHES):
        session.receive(batch(number), (), 0.0)
        session.worker_results(*finished(number), 0.0)
        assert isinstance(session.worker_died("it")[-1], StartWorker)
        session.worker_started()


def test_a_drained_session_leaves_after_its_last_batch() -> None:
    session = joined()
    session.receive(batch(1), (), 0.0)
    assert session.receive(Drain("s"), (), 0.0) == []
    actions = session.worker_results(*finished(1), 0.0)
    assert isinstance(sent(actions)[-1], Goodbye)
    assert actions[-1] == Stop(ExitCode.DONE, "drained")


def test_a_silent_master_is_left_and_a_pinging_one_is_not() -> None:
    session = joined()
    session.receive(Ping("s", 0), (), 9.0)
    assert not any(isinstance(action, Stop) for action in session.tick(18.0))
    (stop,) = session.tick(19.5)
    assert isinstance(stop, Stop)
    assert stop.code is ExitCode.MASTER_SILENT
    assert session.tick(30.0) == []


def test_asked_to_register_again_it_does_and_keeps_what_it_has() -> None:
    session = joined()
    session.receive(batch(1), (), 0.0)
    assert session.receive(RegisterAgain(), (), 1.0) == [Send(REGISTER)]
    session.receive(WELCOME, (), 2.0)
    actions = session.worker_results(*finished(1), 0.0)
    assert sent(actions) == [Results("s", 1, [], True, 1)]


def test_a_resumed_master_gets_no_batches_of_the_old_one_run() -> None:
    session = joined()
    for number in range(4):
        session.receive(batch(number), (), 0.0)
    session.receive(Registered("new", 1.0, 10.0, 1 << 20), (), 1.0)
    actions = session.worker_results(*finished(0), 0.0)
    assert not any(isinstance(action, RunBatch) for action in actions)


def test_a_blob_is_kept_and_handed_over_once() -> None:
    session = joined()
    share = Share("s", KEY, b"", [5])
    assert session.receive(share, (b"value",), 0.0) == [Keep(share, (b"value",))]
    assert session.receive(share, (b"value",), 0.0) == []
    assert runs(session.receive(naming(1, KEY), (), 0.0)) == [(1, [KEY])]
    assert runs(session.receive(naming(2, KEY), (), 0.0)) == [(2, [])]
    session.worker_died("it")
    session.worker_started()
    assert runs(session.receive(naming(3, KEY), (), 0.0)) == [(3, [KEY])]


def test_a_batch_without_its_blob_is_put_back() -> None:
    session = joined()
    (need,) = sent(session.receive(naming(1, KEY, OTHER_KEY), (), 0.0))
    assert need == Need("s", 1, [KEY, OTHER_KEY])
    assert sent(session.tick(1.5)) == [Heartbeat("s", 0, 0, [])]


def test_beyond_its_memory_only_what_batches_need_is_kept() -> None:
    session = joined()  # it announced that it keeps nothing
    for number, key in enumerate((KEY, OTHER_KEY)):
        session.receive(Share("s", key, b"", [5]), (b"value",), 0.0)
        assert not any(
            isinstance(a, Discard) for a in session.receive(naming(number, key), (), 0.0)
        )
    for number, key in enumerate((KEY, OTHER_KEY)):
        actions = session.worker_results(*finished(number), 0.0)
        assert Discard([key]) in actions
    assert isinstance(sent(session.receive(naming(3, KEY), (), 0.0))[0], Need)


def test_a_forgotten_blob_goes_when_the_worker_listens() -> None:
    session = WorkerSession(msgspec.structs.replace(REGISTER, blob_bytes=1000), 0.0)
    session.begin()
    session.receive(WELCOME, (), 0.0)
    session.worker_started()
    session.receive(Share("s", KEY, b"", [5]), (b"value",), 0.0)
    session.receive(naming(1), (), 0.0)
    assert session.receive(Forget("s", [KEY]), (), 0.0) == []
    actions = session.worker_results(*finished(1), 0.0)
    assert Discard([KEY]) in actions


EVENTS = st.one_of(
    st.tuples(st.just("batch"), st.integers(0, 20), st.sampled_from(["s", "other"])),
    st.tuples(st.just("finish")),
    st.tuples(st.just("die")),
    st.tuples(st.just("start")),
    st.tuples(st.just("tick"), st.floats(0.0, 20.0)),
    st.tuples(st.sampled_from(["again", "welcome", "drain", "ping", "terminate"])),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(EVENTS, max_size=60))
def test_whatever_happens_windows_hold_and_it_stops_once(events: list[tuple[Any, ...]]) -> None:
    session, now = joined(), 0.0
    running: list[int] = []
    tally: Counter[str] = Counter()
    for event in events:
        now += event[1] if event[0] == "tick" else 0.0
        actions: list[Action] = []
        if event[0] == "batch":
            actions = session.receive(batch(event[1], event[2]), (), now)
        elif event[0] == "finish" and running:
            actions = session.worker_results(*finished(running.pop(0)), now)
        elif event[0] == "die":
            running.clear()
            actions = session.worker_died("it")
        elif event[0] == "start":
            actions = session.worker_started()
        elif event[0] == "tick":
            actions = session.tick(now)
        elif event[0] == "terminate":
            actions = session.terminate("told to")
        elif event[0] in ("again", "welcome", "drain", "ping"):
            known: dict[str, MasterMessage] = {
                "again": RegisterAgain(), "welcome": WELCOME, "drain": Drain("s"),
                "ping": Ping("s", 0),
            }  # fmt: skip
            actions = session.receive(known[event[0]], (), now)
        running += [action.batch.batch for action in actions if isinstance(action, RunBatch)]
        tally.update(type(action).__name__ for action in actions)
        assert len(running) <= WINDOW
        assert len(set(running)) == len(running)
        assert tally["Stop"] <= 1
        if tally["Stop"]:
            assert not any(isinstance(action, RunBatch | StartWorker) for action in actions)
