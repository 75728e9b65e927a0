"""The workers of a cluster, as its inventory lists them, behind the communicator's Executor.

::

    inventory.json ── bind, keys, workers ──> CommunicatorExecutor <── CURVE ── components
          │                                          ^  allow, revoke
          └── written anew when machines come and go ┘

The loaders of a cluster run always, and their components look for a master again and again: this
master only has to listen, and to let in whom the inventory names.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcapp.communicator.scheduling.policy import DEFAULT_POLICY, POLICIES
from hpcapp.communicator.scheduling.verification import CLUSTER_SHARE, Verification
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ConfigError, NoWorkersError, UsageError
from hpccomponent.inventory import Inventory, hold_cluster, read_inventory
from hpccomponent.limits import raise_descriptor_limit
from hpccomponent.protocol.keys import KeyPair

if TYPE_CHECKING:
    from hpcapp.communicator.executor import CommunicatorExecutor
    from hpcapp.communicator.listener import Listener


log = logging.getLogger("hpcapp")

FIRST_WAIT_S = 60.0  # a loader that was told farewell starts its component within 2 s
OTHERS_WAIT_S = 5.0  # then a machine that has died must not hold the job up
WATCH_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ClusterMaster:
    """A master that the workers of a cluster may come to."""

    executor: CommunicatorExecutor
    inventory: Inventory

    @property
    def most(self) -> int:
        """How many workers may come."""
        return len(self.inventory.workers)

    def gather(self, first_s: float | None = None, others_s: float | None = None) -> int:
        """Wait for workers, and return how many came; NoWorkersError where none came.

        The first one is waited for for `first_s` seconds, and then the others for `others_s`.
        """
        executor, name = self.executor, self.inventory.cluster
        executor.wait_for_workers(1, FIRST_WAIT_S if first_s is None else first_s)
        with suppress(NoWorkersError):
            executor.wait_for_workers(self.most, OTHERS_WAIT_S if others_s is None else others_s)
        workers = executor.workers
        say = log.info if workers == self.most else log.warning
        say("cluster %s: %d of %d workers", name, workers, self.most)
        return max(1, workers)


@contextmanager
def listen_inventory(
    path: Path,
    *,
    policy: str = DEFAULT_POLICY,
    verification: Verification | None = None,
    extra_tasks: Sequence[str] = (),
    lead: Callable[[str], AbstractContextManager[None]] | None = None,
) -> Iterator[ClusterMaster]:
    """Be the master of a cluster, once its other masters have ended; its workers come meanwhile.

    By default `verification` asks for `CLUSTER_SHARE` of the answers again on another machine.
    Where this is not the head, listen on loopback, and enter what `lead` makes of the endpoint
    there; it leads the cluster's workers to it. Raise UsageError where the inventory lists no
    worker, or nothing can listen where it says, ConfigError where it is not as it should be.
    """
    if not read_inventory(path).workers:
        raise UsageError(f"{path} lists no worker", "give the cluster one with 'hpcapp scale'")
    from hpcapp.communicator.executor import CommunicatorExecutor
    from hpccomponent.runtime.numerics import numerics_id

    verification = verification or Verification()
    if verification.share is None:
        verification.share = CLUSTER_SHARE
    with hold_cluster(path, lambda: log.info("waiting for the cluster's present job to end")):
        inventory = read_inventory(path)  # machines may have changed while this waited
        with (
            _open_listener(inventory, is_led=lead is not None) as listener,
            CommunicatorExecutor(
                listener,
                policy=POLICIES[policy](),
                verification=verification,
                extra_tasks=extra_tasks,
                numerics=numerics_id(),  # the master computes too
            ) as executor,
            lead(executor.endpoint) if lead else nullcontext(),
            _follow_inventory(path, inventory, executor),
        ):
            yield ClusterMaster(executor, inventory)


def _open_listener(inventory: Inventory, *, is_led: bool) -> Listener:
    """Listen where the inventory says, or on loopback where something leads there."""
    from hpcapp.communicator.listener import Listener

    return Listener(
        "tcp://127.0.0.1:0" if is_led else inventory.bind,
        workers={worker.public_key: worker.name for worker in inventory.workers},
        keys=KeyPair(inventory.server_public_key, inventory.server_secret_key),
    )


def _tell_size(cluster: str, before: set[str], after: set[str]) -> None:
    """Say that a cluster has grown or shrunk; a machine that is replaced keeps its name."""
    if len(before) != len(after):
        log.info("cluster %s %s from %d to %d workers (%s)", cluster,
                 "grew" if len(after) > len(before) else "shrank", len(before), len(after),
                 ", ".join(sorted(before ^ after)))  # fmt: skip


@contextmanager
def _follow_inventory(
    path: Path, inventory: Inventory, executor: CommunicatorExecutor
) -> Iterator[None]:
    """Admit machines that join the inventory while the job runs, and expel those that leave it."""
    is_over = threading.Event()

    def watch() -> None:
        known = {worker.public_key: worker.name for worker in inventory.workers}
        while not is_over.wait(WATCH_S):
            with suppress(ConfigError):  # it is gone with its cluster; the job ends by itself
                listed = {w.public_key: w.name for w in read_inventory(path).workers}
                raise_descriptor_limit(len(listed.keys() - known.keys()))
                for key in listed.keys() - known.keys():
                    executor.allow(key, listed[key])
                for key in known.keys() - listed.keys():
                    executor.revoke(key)
                _tell_size(inventory.cluster, set(known.values()), set(listed.values()))
                known = listed

    watcher = threading.Thread(target=watch, name="inventory watcher", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        is_over.set()
        watcher.join(WATCH_S)  # a folder of a machine that hangs may hold it up


def load_cluster_function(name: str) -> Callable[..., Any]:
    """Return the function of an entry point ``hpc.clusters``, ``open`` or ``run``.

    Raise UsageError where no installed package knows cluster files.
    """
    registered = entry_points(group="hpc.clusters", name=name)
    if not registered:
        raise UsageError("no installed package knows cluster files", "install hpcapp anew")
    function: Callable[..., Any] = next(iter(registered)).load()
    return function
