"""What the scheduler records of tasks: answers, losses, repeats and refusals."""

from __future__ import annotations

import pytest

from hpcapp.communicator.scheduling.policy import PullPolicy
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.state import Action, Assign, Task
from hpcapp.timeline import Timeline
from hpccomponent.clock import ManualClock
from hpccomponent.protocol.blobs import make_blob
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Failure, Register, Result


class Party:
    """A scheduler with a clock and a timeline, and workers that come when they are called."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.scheduler = Scheduler(PullPolicy(), self.clock, "1", lambda _: True)
        self.timeline = self.scheduler.recording.timeline = Timeline(self.clock.now)

    def come(self, name: str, package: str = "1") -> list[Action]:
        register = Register(PROTOCOL_VERSION, package, name, "i", "b", "n", 1, 1, 1 << 20)
        return self.scheduler.register(name.encode(), register)

    def outcomes(self) -> list[tuple[str, str, str]]:
        return [(span.name, span.worker, span.outcome) for span in self.timeline.spans]


@pytest.fixture
def party() -> Party:
    return Party()


def assign_of(actions: list[Action]) -> Assign:
    [assign] = [action for action in actions if isinstance(action, Assign)]
    return assign


def test_answers_that_come_together_ran_one_after_the_other(party: Party) -> None:
    party.come("w")
    blob = make_blob(b"head", [bytes(1000)])
    party.scheduler.submit(Task(1, "fit", 10, (blob,)))
    assign = assign_of(party.scheduler.dispatch())
    party.scheduler.submit(Task(2, "fit", 20, (blob,)))
    other = assign_of(party.scheduler.dispatch())
    party.clock.advance(4.0)
    results = [Result(1, 1.5, b"ab", [5])]
    party.scheduler.results(b"w", assign.batch, results, True, lambda _: b"")
    party.clock.advance(2.0)
    party.scheduler.results(b"w", other.batch, [Result(2, 2.0, b"", [])], True, lambda _: b"")
    first, second = party.timeline.spans
    assert (first.begin, first.end, second.begin, second.end) == (2.5, 4.0, 4.0, 6.0)
    assert (first.bytes_in, first.bytes_out) == (7, 10 + blob.size_bytes)
    assert (second.bytes_in, second.bytes_out) == (0, 20)  # the blob was there already


def test_a_lost_worker_loses_its_tasks_and_another_does_them(party: Party) -> None:
    party.come("w")
    for number in (1, 2):
        party.scheduler.submit(Task(number, "fit", 10))
        party.scheduler.dispatch()
    party.clock.advance(3.0)
    party.scheduler.disconnected([b"w"], "gone")
    assert [(span.begin, span.end, span.outcome) for span in party.timeline.spans] == [
        (0.0, 3.0, "lost"),
        (3.0, 3.0, "lost"),  # it had not begun
    ]
    for assign in [action for action in party.come("x") if isinstance(action, Assign)]:
        party.scheduler.results(
            b"x", assign.batch, [Result(assign.tasks[0], 0.0, b"", [])], True, lambda _: b""
        )
    assert ("fit", "x", "done") in party.outcomes()


@pytest.mark.parametrize(
    ("failure", "outcome"),
    [(None, "repeated"), (Failure("ValueError", "no", "", ""), "failed")],
)
def test_a_second_answer_is_a_repeat_and_one_that_raises_has_failed(
    party: Party, failure: Failure | None, outcome: str
) -> None:
    party.come("w")
    party.scheduler.submit(Task(1, "fit", 10))
    assign = assign_of(party.scheduler.dispatch())
    if failure is None:
        party.scheduler.tasks.pop(1).is_done = True  # another worker has answered it
    party.scheduler.results(
        b"w", assign.batch, [Result(1, 0.0, b"", [], failure)], True, lambda _: b""
    )
    assert party.outcomes() == [("fit", "w", outcome)]


def test_liars_and_strangers_are_refused(party: Party) -> None:
    party.come("w")
    party.scheduler.submit(Task(1, "fit", 10))
    party.scheduler.dispatch()
    party.scheduler.expose(b"w", "it lies")
    party.come("old", package="0")
    assert party.outcomes() == [("fit", "w", "refused"), ("register", "old", "refused")]
