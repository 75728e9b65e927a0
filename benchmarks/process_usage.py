"""Run a command and report what it took, as one line of JSON: process_usage.py LOG COMMAND ...

A process of its own on purpose, and one that imports next to nothing: Linux counts the resident
set that a process had between fork and exec, so that a child of a large process never seems
smaller than its parent.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time


def run(log: str, command: list[str]) -> dict[str, float]:
    """Run `command` with its output in `log`; return exit code, seconds and megabytes."""
    # Threads that spin while they wait would be billed to a peer that did not need them.
    environment = {**os.environ, "OMP_WAIT_POLICY": "passive"}
    with open(log, "wb") as output:
        start = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=environment
        )
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "exit_code": process.returncode,
        "cpu_s": used.ru_utime + used.ru_stime,
        "wall_s": wall,
        "rss_mb": used.ru_maxrss * unit / 1e6,
    }


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], sys.argv[2:])))
