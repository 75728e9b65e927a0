"""A process that decodes one file for this one, and may die, hang or be greedy over it.

::

    this process                                       hpccomponent.decoding.laz
    ┌────────────────────────────────────┐             ┌─────────────────────────────────┐
    │ Decoder ── "1048576 bytes" ────────┼── stdin ───>│ serving ──> lazrs, laszip, libE57│
    │    ^  └──── "ok 1048576" <─────────┼── stdout ───│    │     limits: memory, time   │
    │    └─────── memory ────────────────┼─────────────┼────┘     no core dump           │
    └────────────────────────────────────┘  shared     └─────────────────────────────────┘

Started by exec, and not forked: the libraries have threads. It imports neither numpy nor what
`site` would, and is up within ten milliseconds.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpccomponent.decoding.claims import Claims, most_memory
from hpccomponent.errors import InputError, JobError, UsageError
from hpccomponent.posix import resource

Refuse = Callable[[str], InputError]
"""Makes the error that refuses a file, of why."""

_LEAST_S = 5.0  # of computing, which the kernel counts: a busy machine is no fault of the file
_BYTES_PER_S = 50_000  # of the file: good ones are decoded a hundred times as fast
_PATIENCE_S = 60.0  # for one answer, beside that: only who waits for ever takes so long
_LONGEST_ANSWER = 4096  # bytes
_DIGITS = 20
_ENDS_S = 1.0  # so long after its pipe has closed


class Decoder:
    """A process that decodes a file, and the memory that it decodes into.

    The memory is shared: each answer overwrites it. It may compute for `computing_s` for all of its
    answers, and one of them may take `patience_s`.
    """

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        path: Path,
        memory: NDArray[np.uint8],
        computing_s: float,
        patience_s: float,
        refuse: Refuse,
    ) -> None:
        assert process.stdin is not None  # noqa: S101 - for mypy: both are pipes
        assert process.stdout is not None  # noqa: S101 - likewise
        self.memory = memory
        self._process, self._path = process, path
        self._requests, self._answers = process.stdin.fileno(), process.stdout.fileno()
        self._computing_s, self._patience_s = computing_s, patience_s
        self._refuse = refuse

    def ask(self, *words: str | int) -> int:
        """Have it decode something, and return a number from 0 on, whose meaning its module says.

        Raise InputError where it could not, died, or takes too long, JobError where it was killed,
        as by the kernel for memory, UsageError where its library is wrong.
        """
        with contextlib.suppress(BrokenPipeError):  # why it ended is found out below
            os.write(self._requests, (" ".join(map(str, words)) + "\n").encode())
        verdict, _, answer = self._hear().partition(" ")
        if verdict == "ok" and answer.isdecimal() and len(answer) < _DIGITS:
            return int(answer)
        if verdict == "missing":
            raise UsageError(f"{self._path}: {answer}", "install the package again")
        raise self._refuse(answer or "its decoder gave no answer")

    def _hear(self) -> str:
        """Return the next line that it says."""
        poll = select.poll()
        poll.register(self._answers, select.POLLIN)
        deadline = time.monotonic() + self._patience_s
        line = b""
        while not line.endswith(b"\n"):
            if not poll.poll(max(deadline - time.monotonic(), 0) * 1000):
                raise self._refuse(f"its decoder gave no answer for {self._patience_s:.0f} s")
            part = os.read(self._answers, _LONGEST_ANSWER)
            if not part or len(line) > _LONGEST_ANSWER:
                raise self._ended()
            line += part
        return line.decode("utf-8", "replace").strip()

    def _ended(self) -> InputError | JobError:
        """Say how it ended."""
        try:
            code = -self._process.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            return self._refuse("its decoder gave no answer")
        if code == signal.SIGKILL:
            return JobError(f"{self._path}: its decoder was killed", "is memory short?")
        if code == signal.SIGXCPU:
            return self._refuse(f"its decoder takes more than {self._computing_s:.0f} s")
        how = signal.Signals(code).name if code > 0 else f"exit code {-code}"
        return self._refuse(f"its decoder was ended by {how}")


@contextmanager
def open_decoder(
    module: str,
    path: Path,
    size: int,
    arguments: Sequence[str],
    refuse: Refuse,
    *,
    patience_s: float = _PATIENCE_S,
) -> Iterator[Decoder]:
    """Start the process that decodes a file; it ends with the block.

    It runs a module of this package, shares `size` bytes of memory, and may take `patience_s` for
    an answer beside the time that it may compute. Raise InputError where the file claims too much
    memory, UsageError where the system cannot limit processes, and OSError where the file is not
    there or the process cannot be started.
    """
    if resource is None:
        raise UsageError(
            f"{path}: is decoded by a process that must be limited, which this system cannot",
            "convert it to .las or .ply elsewhere, as in WSL",
        )
    Claims(path).add(size, "what is decoded at once")
    computing_s = _LEAST_S + path.stat().st_size / _BYTES_PER_S
    with _open_shared(max(size, 1)) as shared:
        memory = np.frombuffer(mmap.mmap(shared, max(size, 1)), np.uint8)
        limits = [most_memory(path), round(computing_s)]
        program = f"from hpccomponent.decoding.{module} import main; main()"
        command = [sys.executable, "-P", "-S", "-c", program]  # -m would import twice as much
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            [*command, str(path.absolute()), *map(str, [shared, len(memory), *limits]), *arguments],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # libraries write their last words there
            env=os.environ | {"PYTHONPATH": _search_path()},
            pass_fds=(shared,),
            process_group=0,  # Ctrl-C in a terminal is for this process
        )
    try:
        yield Decoder(process, path, memory, computing_s, computing_s + patience_s, refuse)
    finally:
        process.kill()
        with process:  # closes its pipes, and waits
            pass


@contextmanager
def _open_shared(size: int) -> Iterator[int]:
    """Open a file in memory, or what comes nearest; it goes with its last mapping."""
    if sys.platform.startswith("linux"):
        file = open(os.memfd_create("hpcapp"), "r+b", buffering=0)  # noqa: SIM115
    else:
        file = tempfile.TemporaryFile(buffering=0)  # type: ignore[assignment]  # noqa: SIM115
    with file:
        file.truncate(size)
        yield file.fileno()


def _search_path() -> str:
    """Return where this process finds modules: `site` is not asked again."""
    return os.pathsep.join(entry or os.getcwd() for entry in sys.path)
