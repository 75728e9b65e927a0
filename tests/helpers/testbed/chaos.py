"""What goes wrong in the test bed beside machines that are cut off, frozen or without power."""

from __future__ import annotations

import json
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cloud import Instance

from testbed.cloud import TestBed

NOTICE = timedelta(minutes=2)


def announce_interruption(bed: TestBed, node: str) -> Instance:
    """Tell a spot machine, by its metadata, that it will be taken away."""
    at = (datetime.now(UTC) + NOTICE).strftime("%Y-%m-%dT%H:%M:%SZ")
    notice = {"action": "terminate", "time": at}
    bed.machine(node).metadata["spot/instance-action"] = json.dumps(notice)
    return bed.instance(node)


def interrupt(bed: TestBed, instance: Instance) -> None:
    """Take a spot machine away."""
    machine = next(m for m in bed.machines() if m.name == instance.id)
    machine.power_off()
    instance.die("Server.SpotInstanceTermination")


def fill_disk(bed: TestBed, node: str) -> None:
    """Leave no byte free on a machine's disk."""
    bed.machine(node).run("cat /dev/zero > /home/admin/full 2>/dev/null || true")


class ProcessList:
    """What `ps` would have shown to anybody: every command line, looked at again and again."""

    def __init__(self) -> None:
        self.seen: set[str] = set()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, name="ps")

    def __enter__(self) -> set[str]:
        self._thread.start()
        return self.seen

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._ended.wait(0.02):
            for path in Path("/proc").glob("[0-9]*/cmdline"):
                try:
                    self.seen.add(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
                except OSError:
                    continue
