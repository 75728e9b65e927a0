"""The communicator as the App sees it: a ``concurrent.futures.Executor``.

::

    executor = CommunicatorExecutor()
    connection = executor.invite("worker-1")        a component elsewhere reads it from a file
    executor.wait_for_workers(1, timeout_s=30.0)
    future = executor.submit("surface.fit_patches", positions, normals)

Arguments are values: large arrays are sent without a copy, possibly more than once, so that they
must not change before their future is done. Result arrays are read-only.
"""

from __future__ import annotations

import atexit
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from typing import Any, TypeVar

from hpcapp.communicator.listener import Listener
from hpcapp.communicator.loop import EventLoop, Timing
from hpcapp.communicator.pending import PendingTasks
from hpcapp.communicator.scheduling.policy import AdaptivePolicy, Policy
from hpcapp.communicator.scheduling.recording import list_workers
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.verification import Verification
from hpcapp.communicator.submission import each_traits, make_submission
from hpcapp.timeline import Timeline
from hpccomponent.clock import Clock, MonotonicClock
from hpccomponent.errors import NoWorkersError, UsageError
from hpccomponent.protocol.blobs import Blob, make_blob
from hpccomponent.protocol.codec import encode_values
from hpccomponent.protocol.connection import Connection
from hpccomponent.runtime.numerics import package_version
from hpccomponent.runtime.tasks import EACH, TaskRegistry, Traits, traits_of

ResultT = TypeVar("ResultT")
PARTS_PER_WORKER = 16  # of a `map`: enough to level workers
MAX_PART = 1000
EXIT_S = 5.0  # how long the interpreter's exit waits for the communicator's thread


class _TaskFuture(Future[Any]):
    """A future that tells the loop when it is cancelled."""

    def __init__(self, number: int, loop: EventLoop) -> None:
        super().__init__()
        self._number = number
        self._loop = weakref.ref(loop)

    def cancel(self) -> bool:
        """Cancel the task unless it has left for a worker, or is done."""
        was_cancelled = super().cancel()
        loop = self._loop()
        if was_cancelled and loop is not None:
            loop.cancel(self._number)
        return was_cancelled


class CommunicatorExecutor(Executor):
    """Runs registered tasks on the workers that connect to it.

    Parameters
    ----------
    listener : Listener, optional
        Where it listens; by default on loopback, with fresh keys, until it is shut down.
    policy : Policy, optional
        How tasks are spread; `AdaptivePolicy` by default.
    verification : Verification, optional
        Which answers are asked for again on another machine; by default none.
    extra_tasks : iterable of str
        ``NAME=module:function`` of tasks that are not installed as entry points.
    numerics : str, optional
        The numerics id that workers must have; by default that of the first one.
    timing : Timing
        How often the parties speak, and how long they listen.

    Raises
    ------
    UsageError
        If an extra task is malformed.
    """

    def __init__(
        self,
        listener: Listener | None = None,
        *,
        policy: Policy | None = None,
        verification: Verification | None = None,
        extra_tasks: Iterable[str] = (),
        numerics: str | None = None,
        timing: Timing | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._tasks = TaskRegistry(extra_tasks)
        self._lock = threading.Lock()
        self._is_shut_down = False
        self._gone: str | None = None
        self._missing = 0
        self._blobs: weakref.WeakValueDictionary[bytes, Blob] = weakref.WeakValueDictionary()
        timing = timing or Timing()
        clock = clock or MonotonicClock()
        self._listener = listener or Listener()
        self.verification = verification or Verification()
        pending = PendingTasks()
        scheduler = Scheduler(
            policy or AdaptivePolicy(),
            clock,
            package_version(),
            pending.claim,
            numerics,
            timing.liveness_s,
            timing.worker_wait_s,
            pending.split,
            self.verification,
            self._listener.names,
        )
        self._transport = self._listener.answer()
        self._loop = EventLoop(scheduler, pending, self._transport, clock, timing)
        atexit.register(self._exit)

    @property
    def endpoint(self) -> str:
        """Return where workers connect to."""
        return self._listener.endpoint

    @property
    def server_key(self) -> str:
        """Return the master's public key."""
        return self._listener.server_key

    @property
    def workers(self) -> int:
        """Return how many workers are registered now, without those that get nothing more."""
        workers = list(self._loop.scheduler.workers.values())
        return sum(not worker.is_retired for worker in workers)

    def statistics(self) -> dict[str, int]:
        """Return counts since the start.

        Bytes, tasks, batches and blobs; lost workers, liars, failures that another machine was
        asked about, batches sent again; second answers of tasks that were run twice, tasks that
        were split; messages that were dropped, peers that were refused.
        """
        scheduled, sent = self._loop.scheduler.counts, self._loop.counts
        return {
            "bytes_sent": self._transport.bytes_sent,
            "bytes_received": self._transport.bytes_received,
            "tasks": sent["tasks"],
            "batches": sent["batches"],
            "blobs": sent["blobs"],
            "losses": scheduled["losses"],
            "lies": scheduled["lies"],
            "doubted": scheduled["doubted"],
            "resent": scheduled["resent"],
            "duplicates": scheduled["duplicates"],
            "splits": scheduled["splits"],
            "dropped": sent["dropped"] + scheduled["dropped"],
            "refused": scheduled["refused"] + self._transport.problems.total(),
        }

    def record(self, timeline: Timeline) -> None:
        """Record from now on what becomes of tasks."""
        scheduler = self._loop.scheduler
        timeline.list_workers = lambda: list_workers(scheduler.workers)
        scheduler.recording.timeline = timeline

    # -- workers -------------------------------------------------------------------------------

    def allow(self, public_key: str, worker: str) -> None:
        """Let a key's owner connect, as `worker` and nobody else; UsageError where it is none."""
        self._listener.allow(public_key, worker)

    def revoke(self, public_key: str) -> None:
        """Keep the owner of `public_key` out, and turn its workers away."""
        self._listener.forbid(public_key)
        self._loop.post(lambda: self._loop.scheduler.expel(public_key))

    def invite(self, worker: str) -> Connection:
        """Make keys for one worker, allow them, and return what its component must know."""
        return self._listener.invite(worker)

    def wait_for_workers(self, count: int, timeout_s: float) -> None:
        """Wait until `count` workers are registered, less those of which `worker_gone` was told.

        Raise NoWorkersError, which names what kept peers out, where they have not come in
        `timeout_s` seconds, or the launcher says that they will not.
        """
        with self._loop.workers_changed:
            have_come = self._loop.workers_changed.wait_for(
                lambda: self._gone is not None or self.workers >= max(1, count - self._missing),
                timeout_s,
            )
        if have_come and self._gone is None:
            return
        reason = self._gone or f"waited for {timeout_s:g} s"
        hints = "".join(f"; {problem}" for problem in self._transport.problems)
        raise NoWorkersError(
            f"{self.workers} of {count} workers registered at {self.endpoint} ({reason}{hints})",
            "look at the log of the loaders and components",
        )

    def worker_gone(self) -> None:
        """Take the launcher's word that one more of those waited for will not come."""
        with self._loop.workers_changed:
            self._missing += 1
            self._loop.workers_changed.notify_all()

    def workers_gone(self, reason: str) -> None:
        """Take the launcher's word that no worker will come (any more), and why."""
        with self._loop.workers_changed:
            self._gone = reason
            self._loop.workers_changed.notify_all()
        self._loop.post(lambda: self._loop.scheduler.workers_gone(reason))

    def start_over(self) -> None:
        """Begin anew after a `DistrustError`: machines that have lied stay out."""
        self._loop.post(self._loop.scheduler.start_over)

    # -- tasks ---------------------------------------------------------------------------------

    def share(self, value: object) -> Blob:
        """Name a large value, so that it travels to each machine once and not with every task.

        It is what could be an argument of a task: most often an ndarray, or a tuple or dict of
        them, which are not copied and must not change while tasks use them. The blob stands for it
        among the arguments of `submit`, also within tuples, lists and dicts; the task gets the
        value, read-only. Equal values are one blob. Workers let it go when neither this nor an
        unfinished task refers to it. Raise UsageError where the value cannot travel.
        """
        blob = make_blob(*encode_values((value,)))
        with self._lock:
            shared = self._blobs.get(blob.key)
            if shared is not None:
                return shared
            self._blobs[blob.key] = blob
        loop, key = self._loop, blob.key
        weakref.finalize(blob, lambda: loop.post(lambda: loop.scheduler.forget(key))).atexit = False
        return blob

    def submit(
        self, fn: Callable[..., ResultT] | str, /, *args: object, **kwargs: object
    ) -> Future[ResultT]:
        """Have a registered task run on some worker.

        Its arguments are values (see ``docs/explanation/design.md``), and what `share` returned;
        arrays must not change before the future is done. Raise UsageError where `fn` is not
        registered, an argument cannot travel, or there are keyword arguments, and RuntimeError
        after `shutdown`.
        """
        if kwargs:
            raise UsageError(
                f"task arguments {sorted(kwargs)} are given by keyword",
                "pass them by position: a task is a function of values in their order",
            )
        name = self._tasks.name_of(fn)
        return self._submit(name, args, traits_of(fn))

    def _submit(self, name: str, args: tuple[object, ...], traits: Traits) -> Future[Any]:
        number = self._loop.pending.number()
        future = _TaskFuture(number, self._loop)
        submission = make_submission(future, name, args, traits)
        with self._lock:
            if self._is_shut_down:
                raise RuntimeError("cannot schedule new futures after shutdown")
            self._loop.counts["tasks"] += 1
            self._loop.submit(number, submission)
        return future

    def map(
        self,
        fn: Callable[..., ResultT] | str,
        /,
        *iterables: Iterable[object],
        timeout: float | None = None,
        chunksize: int | None = None,
    ) -> Iterator[ResultT]:
        """Run a registered task for every item, many of them in one message.

        Parameters
        ----------
        timeout : float, optional
            How long to wait for all results, in seconds.
        chunksize : int, optional
            How many items travel together; by default 16 parts for each worker, of 1000 at most.
            The last parts are split where workers are idle.

        Returns
        -------
        iterator
            The results, in the order of the items. An item whose task raises fails its part.

        Raises
        ------
        UsageError
            As `submit`, or for a `chunksize` below 1.
        TimeoutError
            From the iterator.
        """
        name, traits = EACH + self._tasks.name_of(fn), each_traits(traits_of(fn))
        items = list(zip(*iterables, strict=False))
        if chunksize is None:
            chunksize = min(MAX_PART, -(-len(items) // (max(1, self.workers) * PARTS_PER_WORKER)))
        elif chunksize < 1:
            raise UsageError(f"a chunk of {chunksize} items", "give at least 1, or leave it out")
        step = max(1, chunksize)
        parts = [items[start : start + step] for start in range(0, len(items), step)]
        columns = [tuple(map(list, zip(*part, strict=True))) for part in parts]
        return _in_order([self._submit(name, part, traits) for part in columns], timeout)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End as ``concurrent.futures`` documents: workers are told farewell after the last task.

        Wait until every future is done and the sockets are closed, or cancel what has not left.
        """
        with self._lock:
            self._is_shut_down = True
        if cancel_futures:
            self._loop.pending.cancel_all()
        self._loop.close()
        if wait:
            self._loop.join()
            atexit.unregister(self._exit)

    def __exit__(self, *error: object) -> None:
        # After an error (or Ctrl-C) nobody waits for results: running tasks are abandoned.
        if error[0] is None:
            self.shutdown(wait=True)
        else:
            self._exit()
            atexit.unregister(self._exit)

    def _exit(self) -> None:
        with self._lock:
            self._is_shut_down = True
        self._loop.close(abandon=True)
        self._loop.join(EXIT_S)


def _in_order(parts: Sequence[Future[list[ResultT]]], timeout: float | None) -> Iterator[ResultT]:
    """Yield the results of all parts; what has not left is cancelled when nobody wants more."""
    end = None if timeout is None else time.monotonic() + timeout
    try:
        for part in parts:
            yield from part.result(None if end is None else max(0.0, end - time.monotonic()))
    finally:
        for part in parts:
            part.cancel()
