"""The loop on a wire of the test's own."""

from __future__ import annotations

import queue
from collections.abc import Sequence
from concurrent.futures import Future

from hpcapp.communicator.loop import EventLoop, Timing
from hpcapp.communicator.pending import PendingTasks
from hpcapp.communicator.scheduling.policy import PullPolicy
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.state import Action, Task
from hpcapp.communicator.submission import Submission
from hpccomponent.clock import ManualClock
from hpccomponent.protocol.frames import LARGEST_FRAME, Buffer
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Batch, Register, decode_master_message


class Wire:
    """A transport whose way to one worker is broken."""

    def __init__(self, broken: bytes) -> None:
        self._broken = broken
        self._woken: queue.SimpleQueue[None] = queue.SimpleQueue()
        self.batches: queue.SimpleQueue[tuple[bytes, Batch]] = queue.SimpleQueue()

    def wake(self) -> None:
        self._woken.put(None)

    def wait(self, timeout_s: float) -> None:
        if timeout_s:
            self._woken.get(timeout=30)

    def receive(self) -> None:
        return None

    def take_flooders(self) -> list[str]:
        return []

    def take_disconnected(self) -> bool:
        return False

    def send(self, identity: bytes, frames: Sequence[Buffer]) -> bool:
        message = decode_master_message(bytes(frames[0]))
        if not isinstance(message, Batch):
            return True
        self.batches.put((identity, message))
        return identity != self._broken

    def close(self) -> None:
        pass


def test_a_way_that_breaks_between_two_batches_costs_no_task() -> None:
    wire, clock, pending = Wire(b"first"), ManualClock(), PendingTasks()
    loop = EventLoop(
        Scheduler(PullPolicy(), clock, "1", pending.claim, None, 15.0, 60.0),
        pending,
        wire,  # type: ignore[arg-type]
        clock,
        Timing(),
    )
    futures: list[Future[object]] = [Future(), Future()]

    def begin() -> list[Action]:
        actions: list[Action] = []
        for number, future in enumerate(futures, start=1):
            loop.pending.add(number, Submission(future, "task", b"", []))
            actions += loop.scheduler.submit(Task(number, "task", 0))
        return actions + loop.scheduler.register(b"first", introduce("first"), "key 1")

    try:
        loop.post(begin)  # two batches are decided on; the first finds the way broken
        assert wire.batches.get(timeout=30)[0] == b"first"
        loop.post(lambda: loop.scheduler.register(b"second", introduce("second"), "key 2"))
        sent = [wire.batches.get(timeout=30) for _ in range(2)]
        assert {identity for identity, _ in sent} == {b"second"}
        assert sum(len(batch.calls) for _, batch in sent) == 2
    finally:
        loop.close(abandon=True)
        loop.join()


def introduce(name: str) -> Register:
    return Register(PROTOCOL_VERSION, "1", name, "1", "portable", "n", 1, 1, LARGEST_FRAME)
