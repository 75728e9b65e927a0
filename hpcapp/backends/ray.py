"""Ray behind the Executor seam: one of this machine that ends with the job, or one that runs.

::

    thread of ours ── _call, values and shared refs ──> Ray ──> a worker process somewhere
         ^                                               │
         └───── result, or an error of ours <────────────┘

A thread stands for each task that Ray has got, and there are two for each of its cores: so the
next task waits at the worker, while those after it can still be cancelled here. Ray retries
nothing (``max_retries=0``): that is `retrying`'s.

Ray itself is imported when a backend is opened: it takes a second, and reads then whether it may
listen beyond loopback.
"""

from __future__ import annotations

import copy
import logging
import os
import re
import secrets
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from hpcapp.backends.ray_watcher import watched
from hpcapp.backends.retrying import RetryingExecutor
from hpcapp.extras import how_to_install, require_library
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import (
    HpcError,
    JobError,
    MissingLibraryError,
    NoWorkersError,
    TaskError,
    UsageError,
    WorkerLostError,
)
from hpccomponent.files.held_folders import create_held, temporary_folder
from hpccomponent.limits import available_cores
from hpccomponent.runtime.process import THREAD_VARIABLES

T = TypeVar("T")

CONNECT_S = 10.0
CONNECT_TRIES = 3
LOOK_S = 5.0  # a task that takes longer has the head looked for
TASKS_PER_CORE = 2
HTTP2_SETTINGS = b"\x04"  # the type of the frame with which either side begins
HTTP2_HEADER = 9  # bytes of a frame before its content
HTTP2_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0" + HTTP2_SETTINGS + b"\0\0\0\0\0"
LOOPBACK = "127.0.0.1"
LONGEST_PLACE = 20  # Ray's sockets lie below it; a socket's path has 107 bytes at most
SHORT_PLACE = "/tmp"  # noqa: S108 - what is made there is private
LOST_ADVICE = "look at Ray's logs and its memory; 'ray status' says which nodes it has"
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in THREAD_VARIABLES}

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # it would report to its makers
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else it warns of a change to come
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",  # workers are as they were installed
    "RAY_CLIENT_MAX_CONNECTION_TIMEOUT_S": "5",  # a try, of three
    "RAY_CLIENT_RECONNECT_GRACE_PERIOD": "10",
}


_MISSING = re.compile(r"No module named '([^']+)'")

# Where clusters are off, Ray binds to loopback, on Linux too.
LOOPBACK_ONLY = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}


class WorkerGoneError(Exception):
    """A worker or a node of Ray's that was lost with a task."""


class RayGoneError(WorkerLostError):
    """Ray itself was lost: a process cannot use another one after it."""


class RayHead:
    """Where Ray's head listens, and whether it still does."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._lock = threading.Lock()
        self._seen = -LOOK_S

    def check(self) -> None:
        """Raise ConnectionError where it does not answer; asked once for all threads."""
        with self._lock:
            if time.monotonic() - self._seen < LOOK_S / 2:
                return
            try:
                with socket.create_connection(self._address, CONNECT_S) as connection:
                    self._greet(connection)
            except OSError as error:
                host, port = self._address
                reason = error.strerror or error
                raise ConnectionError(f"no Ray answers at {host}:{port} ({reason})") from error
            self._seen = time.monotonic()

    @staticmethod
    def _greet(connection: socket.socket) -> None:
        """Begin to talk HTTP/2, as gRPC does; raise OSError where that is not answered."""
        if os.environ.get("RAY_USE_TLS", "0").lower() in ("1", "true"):
            return  # it answers to nobody without a certificate
        connection.settimeout(CONNECT_S)
        connection.sendall(HTTP2_GREETING)
        answer = b""
        while len(answer) < HTTP2_HEADER:
            part = connection.recv(HTTP2_HEADER - len(answer))
            if not part:
                break
            answer += part
        if answer[3:4] != HTTP2_SETTINGS:
            raise OSError("something else listens there")


@dataclass(frozen=True, slots=True)
class _Shared:
    """Stands for a shared value within arguments, until the task is about to start."""

    index: int


class RayExecutor(Executor):
    """Submits to the Ray of this process, whose `head` is looked for while a task takes long."""

    workers: int

    def __init__(self, ray: ModuleType, cores: int, head: RayHead) -> None:
        self.workers = cores
        self._ray = ray
        self._head = head
        self._is_gone = False
        self._refs = (ray.ObjectRef, ray.util.client.common.ClientObjectRef)
        self._remote = ray.remote(num_cpus=1, max_retries=0)(_call)
        self._threads = ThreadPoolExecutor(cores * TASKS_PER_CORE, thread_name_prefix="ray")

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Have a task run on some worker."""
        return self._threads.submit(self._run, fn, args, kwargs)

    def share(self, value: object) -> object:
        """Return a reference to `value` in Ray's object store, which nodes fetch once each."""
        return self._ray.put(value)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for what was submitted, or cancel what has not started; Ray stays connected."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)

    def _run(
        self, function: Callable[..., T], arguments: tuple[object, ...], keywords: dict[str, object]
    ) -> T:
        """Run a task, and raise nothing of Ray's."""
        shared: list[object] = []
        lifted = self._lift(arguments, shared)
        try:
            with _translated(self._ray):
                result = self._wait(self._remote.remote(function, lifted, keywords, *shared))
        except RayGoneError:
            self._is_gone = True
            raise
        # What Ray gives lies in its object store, cannot be written to, and keeps its place there.
        # Ours is ours, as from any other engine.
        owned: T = copy.deepcopy(result)
        return owned

    def _wait(self, reference: object) -> Any:
        """Wait for a result as long as there is a head: Ray itself would wait on without one."""
        while True:
            try:
                return self._ray.get(reference, timeout=LOOK_S)
            except self._ray.exceptions.GetTimeoutError:
                if self._is_gone:  # another thread has been told
                    raise ConnectionError("it no longer answers") from None
                self._head.check()

    def _lift(self, value: object, shared: list[object]) -> object:
        """Replace references within tuples: Ray fetches those only that are arguments."""
        if isinstance(value, self._refs):
            shared.append(value)
            return _Shared(len(shared) - 1)
        if type(value) is tuple:
            return tuple(self._lift(item, shared) for item in value)
        return value


def _call(
    function: Callable[..., T],
    arguments: tuple[object, ...],
    keywords: dict[str, object],
    *shared: object,
) -> T:
    """Run a task, on a worker."""

    def place(value: object) -> object:
        if isinstance(value, _Shared):
            return shared[value.index]
        return tuple(map(place, value)) if type(value) is tuple else value

    return function(*map(place, arguments), **keywords)


@contextmanager
def _translated(ray: ModuleType) -> Iterator[None]:
    """Turn Ray's errors into the task's own, a lost worker, or a lost Ray."""
    errors = ray.exceptions
    lost = (
        errors.WorkerCrashedError,
        errors.OutOfMemoryError,
        errors.NodeDiedError,
        errors.ActorDiedError,
        errors.ObjectLostError,
    )
    try:
        yield
    except errors.RayTaskError as error:
        raise _own_error(error) from None
    except lost as error:
        raise WorkerGoneError(_first_line(error)) from None
    except (errors.RuntimeEnvSetupError, errors.TaskUnschedulableError) as error:
        raise JobError(f"Ray cannot run a task: {_first_line(error)}", LOST_ADVICE) from None
    except (errors.RayError, ConnectionError) as error:
        raise RayGoneError(
            f"Ray has ended under the job ({_first_line(error)})",
            "look at its logs and its memory, and start the job again",
        ) from None


def _own_error(error: Any) -> BaseException:
    """Return what a task raised, without Ray's wrapping."""
    cause = error.cause
    missing = _MISSING.search(str(cause)) if not isinstance(cause, HpcError) else None
    if missing is not None:
        return JobError(
            f"a Ray worker has no module {missing[1]}",
            "install the same build of hpcapp on every node, in the Python that runs Ray",
        )
    if isinstance(cause, Exception):
        return cause
    return TaskError(f"a task failed on a Ray worker: {_first_line(error)}")


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def count_losses(error: BaseException) -> int:
    """Return how many workers an error of `RayExecutor` tells the loss of."""
    return int(isinstance(error, WorkerGoneError))


def check_ray() -> None:
    """Raise MissingLibraryError where Ray is not installed."""
    require_library("ray", "Ray is not installed here", "ray")


@contextmanager
def open_ray(address: str | None, workers: int | None) -> Iterator[RetryingExecutor]:
    """Start a Ray on this machine, or connect to one.

    The address is ``auto`` for one that runs on this machine, ``HOST:PORT`` of its head on a
    machine that is one of its nodes, ``ray://HOST:PORT`` of its client server from any other;
    without it, one is started with so many cores as `workers`, by default all, which ends with the
    context. Raise UsageError where Ray is not installed, or this process uses one already, and
    NoWorkersError where no Ray answers, it is of another version, or it has no cores.
    """
    if workers is not None and workers < 1:
        raise UsageError(
            f"backend 'ray' cannot have {workers} workers",
            f"leave {name_option('workers')} out, or give more",
        )

    @contextmanager
    def open_engine() -> Iterator[Executor]:
        opened = _start(workers or available_cores()) if address is None else _connect(address)
        with opened as (ray, head):
            cores = int(ray.cluster_resources().get("CPU", 0))
            if not cores:
                raise NoWorkersError(
                    f"ray={address} has no cores", f"add nodes with 'ray start --address={address}'"
                )
            engine = RayExecutor(ray, cores, head)
            try:
                yield engine
            finally:
                engine.shutdown(cancel_futures=True)

    executor = RetryingExecutor(open_engine, count_losses=count_losses, advice=LOST_ADVICE)
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _start(cores: int) -> Iterator[tuple[ModuleType, RayHead]]:
    """Start a Ray of this machine that listens on loopback only, to who knows its token."""
    variables = QUIET | ONE_THREAD | {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": _token()}
    variables |= LOOPBACK_ONLY
    with _private_place() as (place, tell), _environment(variables):
        ray = _import_ray()
        if ray.util.get_node_ip_address() != LOOPBACK:
            raise UsageError(
                "Ray was imported before hpcapp could keep it on loopback",
                "open the backend before ray is imported, or start Ray and name it: ray=auto",
            )
        with _joined(
            ray,
            address="local",
            num_cpus=cores,
            include_dashboard=False,
            _temp_dir=str(place),
            _node_ip_address=LOOPBACK,
        ):
            [raylet] = ray._private.worker._global_node.all_processes["raylet"]
            tell(raylet.process.pid)
            yield ray, _find_head(ray)


@contextmanager
def _connect(address: str) -> Iterator[tuple[ModuleType, RayHead]]:
    """Connect to a Ray that runs."""
    scheme, _, place = address.rpartition("://")
    head, variables = None, QUIET
    if place != "auto":
        host, _, port = place.rpartition(":")
        head = RayHead(host.strip("[]"), int(port))
        if host in ("localhost", LOOPBACK):  # else Ray looks for the machine's other address
            variables = QUIET | LOOPBACK_ONLY
        try:
            head.check()
        except ConnectionError as error:
            raise NoWorkersError(str(error), _start_advice(scheme)) from error
    with _environment(variables):
        ray = _import_ray()
        if scheme:
            require_library("grpc", "Ray's client is not installed here", "ray")
        with _joined(ray, address=address):
            yield ray, head or _find_head(ray)


def _start_advice(scheme: str) -> str:
    port = "--ray-client-server-port=10001" if scheme else "--port=6379"
    return f"start one with 'ray start --head {port}', or correct the address"


def _find_head(ray: ModuleType) -> RayHead:
    host, _, port = ray.get_runtime_context().gcs_address.rpartition(":")
    return RayHead(host.strip("[]"), int(port))


@contextmanager
def _joined(ray: ModuleType, address: str, **options: object) -> Iterator[None]:
    """Connect this process to a Ray; its signals and its output stay ours."""
    if ray.is_initialized():
        raise UsageError(
            "this process uses Ray already, and can use one at a time", "call ray.shutdown() first"
        )
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM)
    try:
        with _errors_of_init(), temporary_folder() as folder:
            runtime: dict[str, object] = {"env_vars": ONE_THREAD}
            if not address.startswith("ray://"):
                # Else workers import from this process's folder, where a source tree may lie whose
                # kernels are other ones.
                nothing = folder / "nothing"
                nothing.mkdir()
                runtime["working_dir"] = str(nothing)
            _init(ray, address=address, runtime_env=runtime, **options)
        if in_main:
            signal.signal(signal.SIGTERM, before)
        yield
    finally:
        ray.shutdown()


def _init(ray: ModuleType, **options: object) -> None:
    """Connect, more than once where needed: a client's server now and then dies as it is forked."""
    for tries_left in reversed(range(CONNECT_TRIES)):
        try:
            ray.init(log_to_driver=False, logging_level=logging.CRITICAL, **options)
            return
        except ConnectionAbortedError:
            if not tries_left:
                raise
            ray.shutdown()


@contextmanager
def _errors_of_init() -> Iterator[None]:
    """Say in one line why there is no Ray."""
    try:
        yield
    except HpcError:
        raise
    except Exception as error:
        raise NoWorkersError(
            f"Ray does not start or answer ({type(error).__name__}: {_first_line(error)})",
            "'ray status' says whether one runs; its version must be the same here and there",
        ) from error


def _import_ray() -> ModuleType:
    try:
        import ray
        import ray.util.client.common
    except ImportError as error:
        raise MissingLibraryError(
            f"Ray is not installed here ({error})", how_to_install("ray")
        ) from None
    logging.getLogger("ray").setLevel(
        logging.CRITICAL
    )  # a lost connection is told in one line: ours
    # Else it writes of every lost worker to the standard output, where results go.
    ray._private.worker._worker_logs_enabled = False
    return ray


@cache
def _token() -> str:
    """Return what opens the Rays of this process; Ray reads it once."""
    return secrets.token_hex(32)


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set variables for Ray's import and its processes; take them back in the end."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _private_place() -> Iterator[tuple[Path, Callable[[int], None]]]:
    """Make a folder that only this user can enter, with a short path, and remove it in the end.

    What lives in it ends with this process, even if that is killed; see `watched`.
    """
    usual = tempfile.gettempdir()
    parent = Path(usual if len(usual) <= LONGEST_PLACE else SHORT_PLACE)
    folder = create_held(parent / f"hpcapp-{secrets.token_hex(4)}")
    try:
        with watched(folder.path) as tell:
            yield folder.path / "ray", tell  # Ray opens its own folder to everybody
    finally:
        folder.remove()
