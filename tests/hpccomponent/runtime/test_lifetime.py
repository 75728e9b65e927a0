from __future__ import annotations

import os
import subprocess
import sys

import pytest


def test_the_end_of_a_pipe_ends_a_process_that_computes() -> None:
    reading, writing = os.pipe()
    code = (
        "from hpccomponent.runtime.lifetime import exit_at_end_of_pipe\n"
        f"exit_at_end_of_pipe({reading}, 7)\n"
        "while True: pass"
    )
    process = subprocess.Popen([sys.executable, "-P", "-c", code], pass_fds=(reading,))
    os.close(reading)
    os.close(writing)
    assert process.wait() == 7


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's signal is Linux's")
def test_a_parent_that_is_gone_already_ends_the_process() -> None:
    code = (
        "import os, signal\n"
        "from hpccomponent.runtime.lifetime import die_with_parent\n"
        "die_with_parent(os.getppid() + 1, signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-P", "-c", code], check=False).returncode == -9
