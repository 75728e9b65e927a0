"""The worker process: runs the tasks that its component hands over, one after the other.

Started by the component as ``python -P -m hpccomponent.runtime.worker``, with numpy's threads
set to one; it ends when the channel does, and the kernel ends it when the component dies while a
task computes.
"""

from __future__ import annotations

import argparse
import signal
import socket
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from time import perf_counter

from hpccomponent import errors
from hpccomponent.files.checksum import take_written
from hpccomponent.limits import is_shortage
from hpccomponent.protocol.codec import NO_BLOBS, decode_values, encode_values
from hpccomponent.protocol.declared import check_result
from hpccomponent.protocol.frames import Buffer, cut_payload
from hpccomponent.protocol.messages import (
    MAX_TRACEBACK,
    Batch,
    Call,
    Failure,
    Forget,
    Lost,
    Result,
    Results,
    Share,
    decode_master_message,
    encode_message,
)
from hpccomponent.runtime.background import worker_background
from hpccomponent.runtime.channel import Channel, ChannelClosedError
from hpccomponent.runtime.garbage_collection import rare_collections
from hpccomponent.runtime.lifetime import die_with_parent, exit_at_end_of_pipe
from hpccomponent.runtime.tasks import TaskRegistry, Traits, traits_of

FLUSH_S = 0.005  # results wait this long for company, so that cheap tasks share a message
FLUSH_BYTES = 256 * 1024
IDLE_S = 0.1  # after a start or results: the next batch comes sooner, if there is one
LINE_LENGTH = 1000
EXIT_SHORTAGE = 1


class ShortageError(Exception):
    """The machine lacks what a task needs: no fault of the task, and another one may have it.

    Its text is for the master, in one line.
    """


def run_call(
    call: Call,
    buffers: list[memoryview],
    tasks: TaskRegistry,
    blobs: Mapping[bytes, object] = NO_BLOBS,
) -> tuple[Result, list[Buffer]]:
    """Run one task; return its encoded value, or what it raised, and the buffers of the value.

    Raise ShortageError where this machine has run out of memory, disk or open files over it.
    """
    start = perf_counter()
    take_written()
    try:
        task = tasks.resolve(call.name)
        arguments = decode_values(call.header, buffers, blobs)
        start = perf_counter()  # not the import: the master learns from it what a task takes
        value = task(*arguments)
        seconds = perf_counter() - start
        header, output = encode_values((value,))
        _check(call, value, len(header) + sum(map(len, output)), traits_of(task), arguments)
    except BaseException as error:
        failure = _describe(error)
        if is_shortage(error):
            reason = f"it lacks what {call.name!r} needs ({failure.problem})"
            raise ShortageError(reason) from error
        return Result(call.task, perf_counter() - start, b"", [], failure), []
    sizes = [len(buffer) for buffer in output]
    return Result(call.task, seconds, header, sizes, written=take_written()), output


def _check(
    call: Call, value: object, size_bytes: int, traits: Traits, arguments: tuple[object, ...]
) -> None:
    """Raise TaskError for a result that the master would refuse: here it is the task's mistake.

    It is not what the task declares, or larger.
    """
    if size_bytes > call.limit_bytes:
        raise errors.TaskError(
            f"task {call.name!r} returned {size_bytes} bytes, more than the {call.limit_bytes} "
            "that its result may have",
            "return less, or declare a higher limit with the task",
        )
    try:
        check_result(traits.result_of(arguments), value)
    except errors.ProtocolError as error:
        raise errors.TaskError(
            f"task {call.name!r} returned something else than it declares: {error.problem}",
            "correct the task, or what is declared of its result",
        ) from error


def run_batch(
    batch: Batch,
    payload: memoryview,
    tasks: TaskRegistry,
    channel: Channel,
    blobs: Mapping[bytes, object] = NO_BLOBS,
) -> None:
    """Run the tasks of a batch and send results as they become ready, cheap ones together.

    The payload came with it, by `Channel.receive`; raise ProtocolError where it is too short. Raise
    ChannelClosedError where the other end is gone, and ShortageError where this machine lacks what
    a task needs; the results before it have been sent.
    """
    buffers = iter(cut_payload(payload, [size for call in batch.calls for size in call.sizes]))
    ready = _Ready(batch, channel)
    for call in batch.calls:
        if ready.is_due():
            ready.send_waiting()
        try:
            result, values = run_call(call, [next(buffers) for _ in call.sizes], tasks, blobs)
        except ShortageError:
            ready.send(is_finished=False)
            raise
        if sum(result.sizes) >= FLUSH_BYTES:  # travels alone: a small one would keep it in memory
            ready.send_waiting()
        ready.add(result, values)
    ready.send(is_finished=True)


class _Ready:
    """Results of a batch that wait for company."""

    def __init__(self, batch: Batch, channel: Channel) -> None:
        self._batch, self._channel = batch, channel
        self._clear()

    def _clear(self) -> None:
        self._results: list[Result] = []
        self._output: list[Buffer] = []
        self._size = 0
        self._flushed = perf_counter()

    def add(self, result: Result, values: list[Buffer]) -> None:
        self._results.append(result)
        self._output += values
        self._size += len(result.header) + sum(result.sizes)

    def is_due(self) -> bool:
        return self._size >= FLUSH_BYTES or perf_counter() - self._flushed >= FLUSH_S

    def send_waiting(self) -> None:
        if self._results:
            self.send(is_finished=False)

    def send(self, is_finished: bool) -> None:
        message = Results(self._batch.session, self._batch.batch, self._results, is_finished)
        self._channel.send(encode_message(message), [[value] for value in self._output])
        self._clear()


class _Blobs(Mapping[bytes, object]):
    """The values of blobs, by their keys.

    Each is decoded for the first task that asks for it: then what its records mean is known, by
    the module of that task. Its arrays are views of the memory file that it came in.
    """

    def __init__(self) -> None:
        self._given: dict[bytes, tuple[Share, memoryview]] = {}
        self._values: dict[bytes, object] = {}

    def add(self, blob: Share, payload: memoryview) -> None:
        self._given[blob.key] = blob, payload

    def forget(self, keys: Iterable[bytes]) -> None:
        for key in keys:
            self._given.pop(key, None)
            self._values.pop(key, None)

    def __getitem__(self, key: bytes) -> object:
        if key not in self._values:
            blob, payload = self._given[key]
            (self._values[key],) = decode_values(blob.header, cut_payload(payload, blob.sizes))
        return self._values[key]

    def __iter__(self) -> Iterator[bytes]:
        return iter(self._given)

    def __len__(self) -> int:
        return len(self._given)


def _describe(error: BaseException) -> Failure:
    problem = str(error)
    advice = ""
    kind = type(error).__name__
    if isinstance(error, errors.HpcError):
        problem, advice = error.problem, error.advice
    else:
        problem = f"{kind}: {problem}" if problem else kind
    line = " ".join(problem.split())[:LINE_LENGTH]
    trace = "".join(traceback.format_exception(error))
    return Failure(kind[:LINE_LENGTH], line, advice[:LINE_LENGTH], trace[-MAX_TRACEBACK:])


def main(arguments: list[str] | None = None) -> int:
    """Serve the channel until the component closes it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is for the master only
    parser = argparse.ArgumentParser(prog="hpccomponent.runtime.worker", allow_abbrev=False)
    parser.add_argument("--channel-fd", type=int, required=True)
    parser.add_argument("--lifeline-fd", type=int, required=True)
    parser.add_argument("--parent", type=int, required=True)
    parser.add_argument("--task", action="append", default=[])
    options = parser.parse_args(arguments)
    if not die_with_parent(options.parent, signal.SIGKILL):
        exit_at_end_of_pipe(options.lifeline_fd, 0)
    tasks = TaskRegistry(options.task)
    worker_background.enable()
    ahead = tasks.import_ahead()
    worker_background.add(lambda: next(ahead, None) is not None)
    channel = Channel(socket.socket(fileno=options.channel_fd))
    blobs = _Blobs()
    try:
        while True:
            wait_s = IDLE_S
            while worker_background and not channel.has_message(wait_s):
                worker_background.run_one()
                wait_s = 0.0
            control, payload = channel.receive()
            match decode_master_message(control):
                case Batch() as batch:
                    run_batch(batch, payload, tasks, channel, blobs)
                case Share() as blob:
                    blobs.add(blob, payload)
                case Forget() as forget:
                    blobs.forget(forget.keys)
            del control, payload  # or the last batch would stay mapped while this one waits
    except ChannelClosedError:
        return 0
    except ShortageError as error:
        with suppress(ChannelClosedError):
            lost = Lost(batch.session, batch.batch, str(error)[:LINE_LENGTH], is_blamed=True)
            channel.send(encode_message(lost), [])
        return EXIT_SHORTAGE


if __name__ == "__main__":
    with rare_collections():
        code = main()
    sys.exit(code)
