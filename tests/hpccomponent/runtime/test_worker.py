from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hpccomponent.protocol.blobs import make_blob
from hpccomponent.protocol.codec import decode_values, encode_arguments, encode_values
from hpccomponent.protocol.frames import cut_payload
from hpccomponent.protocol.messages import Batch, Call, Results, decode_component_message
from hpccomponent.runtime.channel import Channel
from hpccomponent.runtime.tasks import TaskRegistry
from hpccomponent.runtime.worker import ShortageError, run_batch, run_call

TASKS = TaskRegistry(
    [
        "root=math:sqrt",
        "list=builtins:list",
        "ones=numpy:ones",
        "leave=sys:exit",
        "compile=re:compile",
        "write=contract_tasks:write",
    ]
)
Ends = tuple[Channel, Channel]


def call(number: int, name: str, *values: object) -> Call:
    header, buffers = encode_values(values)
    return Call(number, name, header, [len(buffer) for buffer in buffers])


@pytest.fixture
def ends() -> Iterator[Ends]:
    one, two = (Channel(end) for end in socket.socketpair())
    yield one, two
    one.close()
    two.close()


def hear(channel: Channel) -> tuple[Results, list[memoryview]]:
    control, payload = channel.receive()
    results = decode_component_message(control)
    assert isinstance(results, Results)
    return results, cut_payload(payload, [n for r in results.results for n in r.sizes])


def test_what_a_task_writes_is_told_beside_its_result(tmp_path: Path) -> None:
    def written(content: bytes) -> int:
        name = str(tmp_path / "file")
        done, _ = run_call(call(1, "write", name, content), [], TASKS)
        assert done.failure is None
        return done.written

    assert written(b"abc") == written(b"abc") != written(b"abd")
    assert run_call(call(1, "root", 16.0), [], TASKS)[0].written == 0


def test_a_call_gives_its_value() -> None:
    result, buffers = run_call(call(3, "root", 16.0), [], TASKS)
    assert result.task == 3
    assert decode_values(result.header, buffers) == (4.0,)


@pytest.mark.parametrize(
    ("name", "values", "kind", "word"),
    [
        ("root", (-1.0,), "ValueError", "math domain error"),
        ("root", (1, 2), "TypeError", "exactly one argument"),
        ("leave", (3,), "SystemExit", "3"),
        ("missing", (), "UsageError", "no task is registered"),
        ("compile", ("x",), "UsageError", "cannot travel"),
    ],
)
def test_whatever_is_raised_is_the_result(
    name: str, values: tuple[object, ...], kind: str, word: str
) -> None:
    result, buffers = run_call(call(1, name, *values), [], TASKS)
    assert result.failure is not None
    assert result.failure.kind == kind
    assert word in result.failure.problem
    assert "\n" not in result.failure.problem
    assert "Traceback" in result.failure.traceback
    assert not buffers


def test_blobs_among_the_arguments_are_looked_up() -> None:
    blob = make_blob(*encode_values((16.0,)))
    header, _, _ = encode_arguments((blob,))
    result, buffers = run_call(Call(1, "root", header, [], [blob.key]), [], TASKS, {blob.key: 16.0})
    assert decode_values(result.header, buffers) == (4.0,)


def test_cheap_results_share_a_message(ends: Ends) -> None:
    batch = Batch("s", 7, [call(number, "root", 4.0) for number in range(30)])
    run_batch(batch, memoryview(b""), TASKS, ends[0])
    numbers: list[int] = []
    messages = 0
    while len(numbers) < 30:
        results, _ = hear(ends[1])
        numbers += [result.task for result in results.results]
        messages += 1
        assert results.is_finished == (len(numbers) == 30)
    assert numbers == list(range(30))
    assert messages < 15


def test_what_this_machine_lacks_is_no_result_and_what_was_done_before_is_sent(ends: Ends) -> None:
    batch = Batch("s", 7, [call(0, "root", 4.0), call(1, "ones", 1 << 45), call(2, "root", 4.0)])
    with pytest.raises(ShortageError, match=r"'ones' needs .*MemoryError"):
        run_batch(batch, memoryview(b""), TASKS, ends[0])
    results, _ = hear(ends[1])
    assert [result.task for result in results.results] == [0]
    assert not results.is_finished


def test_large_results_are_sent_as_they_come(ends: Ends) -> None:
    batch = Batch("s", 7, [call(number, "ones", 100_000) for number in range(3)])
    run_batch(batch, memoryview(b""), TASKS, ends[0])
    for number in range(3):
        results, buffers = hear(ends[1])
        (result,) = results.results
        (value,) = decode_values(result.header, buffers)
        assert result.task == number
        assert results.is_finished == (number == 2)
        np.testing.assert_array_equal(value, np.ones(100_000))
