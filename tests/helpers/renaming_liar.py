"""A machine that leaves after every batch, and comes again under another name, with its one key.

``python -m renaming_liar CONNECTION_FILE TASKS``: these, as ``NAME=module:function`` with commas
between them, are what it runs. Every third time it comes under the name that its key was given.
"""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from itertools import count
from unittest.mock import patch

from hpccomponent.protocol.connection import Connection, read_connection
from hpccomponent.protocol.frames import Buffer
from hpccomponent.protocol.messages import Results
from hpccomponent.protocol.session import Action, ExitCode, WorkerSession
from hpccomponent.runtime import component
from hpccomponent.runtime.lifetime import die_with_parent
from hpccomponent.runtime.numerics import numerics_id


class LeavingSession(WorkerSession):
    """Says goodbye as soon as a batch is answered."""

    def worker_results(
        self, results: Results, head: Buffer, payload: memoryview, now: float
    ) -> list[Action]:
        actions = super().worker_results(results, head, payload, now)
        return [*actions, *self.terminate("for a while")] if results.is_finished else actions


def come(connection: Connection, tasks: list[str]) -> int:
    """Be a component once, in a process of its own, and return its exit code."""
    child = os.fork()
    if child == 0:
        die_with_parent(os.getppid(), signal.SIGTERM)
        options = component.ComponentOptions(numerics_id().partition("-")[0], tasks)
        with patch.object(component, "WorkerSession", LeavingSession):
            os._exit(component.run_component(connection, options))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> None:
    given, tasks = read_connection(sys.argv[1]), sys.argv[2].split(",")
    for number in count():
        name = f"{given.worker}-{number}" if number % 3 else given.worker
        if come(replace(given, worker=name), tasks) == ExitCode.REFUSED and number % 3 == 0:
            return


if __name__ == "__main__":
    main()
