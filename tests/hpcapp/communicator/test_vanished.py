"""A worker's machine that vanishes from the network, in namespaces of the test's own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

MASTER = """
import subprocess, sys, threading
from hpcapp.communicator.listener import Listener
from hpcapp.communicator.loop import Timing
from hpcapp.communicator.executor import CommunicatorExecutor
from hpccomponent.protocol.connection import write_connection

def ip(*words):
    subprocess.run(["ip", *words], check=True)

there = subprocess.Popen(["unshare", "--net", "sh", "-c", "echo up && exec cat"],
                         stdin=subprocess.PIPE, stdout=subprocess.PIPE)
there.stdout.readline()
inside = ["nsenter", "--net", "--target", str(there.pid)]
ip("link", "add", "here", "type", "veth", "peer", "name", "there", "netns", str(there.pid))
ip("addr", "add", "192.0.2.1/24", "dev", "here")
ip("link", "set", "here", "up")
subprocess.run([*inside, "ip", "addr", "add", "192.0.2.2/24", "dev", "there"], check=True)
subprocess.run([*inside, "ip", "link", "set", "there", "up"], check=True)
listener = Listener("tcp://192.0.2.1:0")
with CommunicatorExecutor(listener, timing=Timing(liveness_s=600.0)) as executor:
    write_connection(sys.argv[1], executor.invite("far"))
    component = [sys.executable, "-P", "-m", "hpccomponent", "--connection", sys.argv[1]]
    process = subprocess.Popen([*inside, *component], stderr=subprocess.DEVNULL)
    executor.wait_for_workers(1, 30.0)
    subprocess.run([*inside, "ip", "link", "set", "there", "down"], check=True)
    never = threading.Event()
    while executor.workers:
        never.wait(0.05)
    print("lost", flush=True)
    process.kill()
    process.wait()
there.communicate()
"""


def missing() -> str:
    """Say why no network can be had here; nothing where one can."""
    absent = [name for name in ("ip", "unshare", "nsenter") if not shutil.which(name)]
    if absent or not sys.platform.startswith("linux"):
        return f"no {', '.join(absent)}"
    tried = subprocess.run(
        ["unshare", "--net", "ip", "link", "add", "one", "type", "veth", "peer", "name", "two"],
        capture_output=True,
        text=True,
    )
    return tried.stderr.strip()


@pytest.mark.slow
def test_a_machine_that_vanishes_is_noticed_long_before_its_heartbeats_are_missed(
    tmp_path: Path,
) -> None:
    reason = missing() if os.geteuid() == 0 else "needs root"
    if reason:
        pytest.skip(f"no network namespaces here: {reason}")
    done = subprocess.run(
        ["unshare", "--net", sys.executable, "-P", "-c", MASTER, str(tmp_path / "far.json")],
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert (done.stdout, done.returncode) == ("lost\n", 0), done.stderr
