"""A registered component that lies, over real sockets, beside an honest one."""

from __future__ import annotations

import threading
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
import zmq
from fixture_types import StartComponent
from peak_memory import bounded_memory

from hpcapp.applications.surface.paper.patch_quadrics import fit_patches
from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.lab.quadrature.application import estimate
from hpccomponent.errors import TaskError
from hpccomponent.protocol.codec import encode_values
from hpccomponent.protocol.frames import LARGEST_FRAME, Buffer, split_buffers
from hpccomponent.protocol.messages import (
    PROTOCOL_VERSION,
    Batch,
    Failure,
    Heartbeat,
    Refused,
    Register,
    Registered,
    Result,
    Results,
    decode_master_message,
    encode_message,
)
from hpccomponent.runtime.numerics import numerics_id, package_version

WAIT = 60.0
ROWS = 200

Answer = Callable[[int], tuple[list[Result], list[Buffer]]]


def say(value: object) -> Answer:
    def answer(task: int) -> tuple[list[Result], list[Buffer]]:
        header, buffers = encode_values((value,))
        return [Result(task, 0.001, header, [len(buffer) for buffer in buffers])], list(buffers)

    return answer


def say_raw(header: bytes, sizes: list[int], frames: list[bytes]) -> Answer:
    return lambda task: ([Result(task, 0.001, header, sizes)], list(frames))


GOOD = np.zeros((ROWS, 2))
PACK = msgspec.msgpack.encode
LIES: dict[str, Answer] = {
    "none": say(None),
    "text": say("what you want"),
    "wrong shape": say(np.zeros((ROWS, 3))),
    "cut": say(GOOD[:-1]),
    "wrong dtype": say(GOOD.astype(np.float32)),
    "a tuple of them": say((GOOD, GOOD)),
    "huge integer": say_raw(PACK([[6, b"\x01" * 4_000_000]]), [], []),
    "huge extents": say_raw(PACK([[2, "<f8", [2**63] * 100_000, None]]), [8], [b"8" * 8]),
    "many lists": say_raw(b"\x91\xdd\x00\x38\x00\x00\x01" + b"\x90" * 3_670_015, [], []),
    "larger than assigned for": say(np.zeros(2_000_000)),
    "announces gigabytes": say_raw(b"\x90", [2**40], [b"x"]),
    # Less of it than may be on the way: else its connection is ended, and no reason reaches it.
    "more than it announces": say_raw(b"\x90", [1], [b"x" * 100_000] * 100),
    "less than it announces": say_raw(b"\x90", [100], [b"x"]),
    "no value": say_raw(b"\x90", [], []),
    "junk": say_raw(b"\xc1" * 100, [], []),
    "another task": lambda task: ([Result(task + 1000, 0.0, PACK([1]), [])], []),
}


class Liar(threading.Thread):
    """A component that answers the first batch it gets with a lie."""

    def __init__(
        self, executor: CommunicatorExecutor, answer: Answer, pretends: str = "liar"
    ) -> None:
        super().__init__(daemon=True)
        self._pretends = pretends
        self._connection = executor.invite("liar")
        self._answer = answer
        self.public_key = self._connection.public_key
        self.registered, self.reason = threading.Event(), ""
        self.start()

    def run(self) -> None:
        keys = self._connection
        with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:
            dealer.setsockopt(zmq.LINGER, 0)
            dealer.setsockopt(zmq.CURVE_SERVERKEY, keys.server_key.encode())
            dealer.setsockopt(zmq.CURVE_PUBLICKEY, keys.public_key.encode())
            dealer.setsockopt(zmq.CURVE_SECRETKEY, keys.secret_key.encode())
            dealer.connect(keys.endpoint)
            register = Register(
                PROTOCOL_VERSION, package_version(), self._pretends, "1", "portable",
                numerics_id("portable"), 1, 1 << 30, LARGEST_FRAME,
            )  # fmt: skip
            dealer.send(encode_message(register))
            self._serve(dealer)

    def _serve(self, dealer: zmq.Socket[bytes]) -> None:
        session = ""
        while dealer.poll(int(WAIT * 1000)):
            match decode_master_message(dealer.recv_multipart()[0]):
                case Registered() as registered:
                    session = registered.session
                    self.registered.set()
                case Batch() as batch:
                    results, frames = self._answer(batch.calls[0].task)
                    message = Results(session, batch.batch, results, True)
                    dealer.send_multipart(
                        [encode_message(message), *split_buffers(frames, LARGEST_FRAME)]
                    )
                case Refused() as refused:
                    self.reason = refused.reason
                    return
                case _:
                    dealer.send(encode_message(Heartbeat(session, 0, 0, [])))


def test_a_liar_that_sends_nan_is_turned_away(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    liar = Liar(executor, say(np.full((1, 10), np.nan)))
    assert liar.registered.wait(WAIT)
    points = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([0, 1])
    fitted = executor.submit(fit_patches, *points, np.zeros((1, 3)), np.ones(1))
    liar.join(WAIT)
    assert "NaN" in liar.reason
    start_component()
    assert fitted.result(WAIT).shape == (1, 10)


@pytest.mark.parametrize(
    "kind",
    ["CloudError", "DistrustError", "JobCancelledError", "NoWorkersError", "WorkerLostError"],
)
def test_a_liar_does_not_speak_for_the_master(executor: CommunicatorExecutor, kind: str) -> None:
    """A job would be begun anew for ever, or be believed to have no lie in it."""
    failure = Failure(kind, "begin again", "", "")
    liar = Liar(executor, lambda task: ([Result(task, 0.0, b"", [], failure)], []))
    assert liar.registered.wait(WAIT)
    with pytest.raises(TaskError, match="begin again"):
        executor.submit(estimate, "wave", GOOD[:, 0], GOOD[:, 1]).result(WAIT)
    executor.revoke(liar.public_key)
    liar.join(WAIT)


def test_a_liar_that_calls_itself_otherwise_is_turned_away(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    liar = Liar(executor, say(None), pretends="worker-0")
    liar.join(WAIT)
    assert liar.reason == "its key is not that of 'worker-0'"
    start_component("worker-0")
    executor.wait_for_workers(1, WAIT)


def test_a_liar_that_says_that_a_task_fails_is_not_believed(
    executor: CommunicatorExecutor, start_component: StartComponent
) -> None:
    failure = Failure("InputError", "your points are no good", "give others", "")
    liar = Liar(executor, lambda task: ([Result(task, 0.0, b"", [], failure)], []))
    assert liar.registered.wait(WAIT)
    left = np.linspace(0.0, 0.9, ROWS)
    start_component()
    executor.wait_for_workers(2, WAIT)
    results = [executor.submit(estimate, "wave", left, left + 0.1) for _ in range(12)]
    for result in results:
        assert np.array_equal(result.result(WAIT), estimate("wave", left, left + 0.1))
    assert executor.statistics()["doubted"] >= 1
    executor.revoke(liar.public_key)
    liar.join(WAIT)


@pytest.mark.slow
@pytest.mark.parametrize("lie", LIES)
def test_a_liar_is_turned_away_with_a_reason_and_the_work_is_done(
    executor: CommunicatorExecutor,
    start_component: StartComponent,
    caplog: pytest.LogCaptureFixture,
    lie: str,
) -> None:
    liar = Liar(executor, LIES[lie])
    assert liar.registered.wait(WAIT)
    left = np.linspace(0.0, 0.9, ROWS)
    with bounded_memory():  # that of the liar, a thread here, with it
        first = executor.submit(estimate, "wave", left, left + 0.1)
        liar.join(WAIT)
    assert "works for this job no more" in liar.reason
    assert liar.reason in caplog.text
    start_component()
    assert np.array_equal(first.result(WAIT), estimate("wave", left, left + 0.1))
    assert executor.statistics()["losses"] == 0
