"""How many workers this machine can carry: open files, processes and memory, before any is started.

What is counted is what workers take by being there. What tasks need beside that is the
application's to know.
"""

from __future__ import annotations

from pathlib import Path

from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.limits import (
    address_space_limit,
    available_descriptors,
    available_memory,
    available_tasks,
    raise_descriptor_limit,
)

OWN_DESCRIPTORS = 40
"""What a master opens beside its workers' ends: sockets, the log, the points, files of tiles."""

LEAST_ADDRESS_SPACE = 512 << 20
"""For what a process loads and reserves to compute at all: libraries, their buffers, stacks."""

_ROOT = Path("/")


@dataclass(frozen=True, slots=True)
class WorkerNeeds:
    """What one worker takes by being there.

    Descriptors of the master; processes and their threads; those of the master itself and of its
    helpers, for all workers together; bytes of memory, with the modules of all tasks imported and
    no task run.
    """

    descriptors: int
    tasks: int
    own_tasks: int
    memory: int


NEEDS = {
    # a lifeline, a log, the process itself, a connection; a loader, a component of three threads
    # and a worker of one, which has a second one where no kernel ends it with its parent
    "zmq": WorkerNeeds(descriptors=4, tasks=6, own_tasks=8, memory=64 << 20),
    "processes": WorkerNeeds(descriptors=2, tasks=2, own_tasks=8, memory=48 << 20),
    "threads": WorkerNeeds(descriptors=0, tasks=1, own_tasks=2, memory=1 << 20),
}
"""By the name of a backend."""


def check_address_space() -> None:
    """Find out whether the libraries that compute can be loaded, which end badly if not.

    Raise UsageError where the address space is limited to less.
    """
    limit = address_space_limit()
    if limit is not None and limit < LEAST_ADDRESS_SPACE:
        raise UsageError(
            f"the address space of a process is limited to {limit >> 20} MiB ('ulimit -v'), and "
            f"{LEAST_ADDRESS_SPACE >> 20} MiB are the least",
            "raise it, or limit memory by a control group",
        )


def count_carried(backend: str, root: Path = _ROOT) -> tuple[int, str]:
    """Return how many workers of a backend this machine carries, 0 where none, and why no more.

    The reason is the scarcest thing, with its numbers, for messages.
    """
    needs = NEEDS[backend]
    bounds: list[tuple[int, str]] = []
    if needs.descriptors:
        files = available_descriptors()
        bounds.append(
            (
                (files - OWN_DESCRIPTORS) // needs.descriptors,
                f"open files: {files} more by 'ulimit -Hn', {needs.descriptors} for each worker "
                f"and {OWN_DESCRIPTORS} for the job",
            )
        )
    tasks = available_tasks(root)
    if tasks is not None:
        bounds.append(
            (
                (tasks[0] - needs.own_tasks) // needs.tasks,
                f"processes and threads: {tasks[0]} more by {tasks[1]}, {needs.tasks} for each "
                f"worker and {needs.own_tasks} for the job",
            )
        )
    memory = available_memory(root)
    if memory is not None:
        bounds.append(
            (
                int(memory) // needs.memory,
                f"memory: {memory / 2**30:.1f} GiB free, {needs.memory >> 20} MiB for each worker",
            )
        )
    most, reason = min(bounds)
    return max(0, most), reason


def check_workers(backend: str, count: int | None, default: int, root: Path = _ROOT) -> int:
    """Return how many workers to start, by default as many of `default` as this machine carries.

    The soft limit of open files is raised to what they need. Raise UsageError, which says how many
    it carries, where it does not carry as many as were asked for.
    """
    if backend not in NEEDS:
        return default if count is None else count
    most, reason = count_carried(backend, root)
    workers = min(default, max(1, most)) if count is None else count
    if workers > most:
        if most == 0:
            raise UsageError(
                f"{name_option('workers', workers)}: this machine carries none ({reason})",
                f"raise this limit, or use {name_option('backend', 'serial')}",
            )
        raise UsageError(
            f"{name_option('workers', workers)}: this machine carries {most} ({reason})",
            f"use {name_option('workers', most)}",
        )
    raise_descriptor_limit(OWN_DESCRIPTORS + workers * NEEDS[backend].descriptors)
    return workers


def reserve_connections(peers: int) -> None:
    """See that a master can hold a connection to each of so many workers elsewhere.

    Raise UsageError where the hard limit of open files is too low for one of each.
    """
    files, needed = available_descriptors(), OWN_DESCRIPTORS + peers
    if files < needed:
        raise UsageError(
            f"a master of {peers} workers needs {needed} more open files, and 'ulimit -Hn' leaves "
            f"{files}",
            "raise it, or use fewer workers",
        )
    raise_descriptor_limit(needed + peers)  # one that comes again has two connections for a while
