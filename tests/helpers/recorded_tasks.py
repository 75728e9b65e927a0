"""An Executor that does each task here, as a worker is sent it, and shows what came of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

from hpcapp.backends.calls import run_task
from hpccomponent.protocol.blobs import Blob, make_blob
from hpccomponent.protocol.codec import decode_values, encode_arguments, encode_values
from hpccomponent.protocol.declared import Declared
from hpccomponent.runtime.tasks import traits_of
from hpccomponent.runtime.visible_files import sees_files


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a worker answers, and what master and worker hold against it.

    Parameters
    ----------
    name : str
        Of the task.
    arguments : tuple
        As the master has them: shared values are blobs.
    value : object
        What the task returned, decoded.
    size_bytes, limit_bytes : int
        Of the encoded value, and how large it may be.
    declared : tuple of Declared
        What the master makes of the arguments, and what the worker does.
    """

    name: str
    arguments: tuple[object, ...]
    value: object
    size_bytes: int
    limit_bytes: int
    declared: tuple[Declared, Declared]


class RecordedTasks(Executor):
    """Runs tasks in `submit`, on what travels, and shows each answer while the job runs.

    Parameters
    ----------
    look : callable
        Given each `Answer`.
    workers : int
        As how many it appears.
    sees : bool
        Whether it says that workers see the files of this machine.
    tell : callable
        From each `Answer` to what is said instead of its value.
    """

    def __init__(
        self,
        look: Callable[[Answer], None],
        workers: int = 3,
        sees: bool = True,
        tell: Callable[[Answer], object] = lambda answer: answer.value,
    ) -> None:
        self.workers = workers
        self._look, self._sees, self._tell = look, sees, tell
        self._blobs: dict[bytes, Blob] = {}

    def share(self, value: object) -> Blob:
        blob = make_blob(*encode_values((value,)))
        return self._blobs.setdefault(blob.key, blob)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        assert fn is run_task  # what a job gives an Executor of a factory
        numerics, task, *arguments = args
        future: Future[Any] = Future()
        try:
            future.set_result(run_task(numerics, lambda *all_: self._run(task, all_), *arguments))
        except Exception as error:
            future.set_exception(error)
        return future

    def _run(self, task: Callable[..., object], arguments: tuple[object, ...]) -> object:
        if task is sees_files:
            return self._sees
        traits = traits_of(task)
        asked, limit_bytes = traits.result_of(arguments), traits.limit_of(arguments)
        header, buffers, blobs = encode_arguments(arguments)
        shared = {blob.key: decode_values(blob.header, blob.buffers)[0] for blob in blobs}
        received = decode_values(header, buffers, shared)
        header, buffers = encode_values((task(*received),))
        value = decode_values(header, [bytes(buffer) for buffer in buffers])[0]
        size_bytes = len(header) + sum(map(len, buffers))
        declared = asked, traits.result_of(received)
        answer = Answer(task.__name__, arguments, value, size_bytes, limit_bytes, declared)
        self._look(answer)
        return self._tell(answer)
