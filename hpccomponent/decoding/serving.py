"""The other side of `process`: what runs in the process that decodes.

It starts each time a file is read: what only types need, half of its start, is not imported.
"""

from __future__ import annotations

import mmap
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    Answer = Callable[[list[str]], int]
    """Does what a request asks for, given its words; returns what is to be said of it."""


_LONGEST = 500  # characters of a message


def serve(open_file: Callable[[str, memoryview, list[str]], Answer]) -> None:
    """Answer requests until there are no more, or until one fails.

    The command line is: path, descriptor of the shared memory, its size in bytes, limits of memory
    in bytes and of computing time in seconds; then arguments of `open_file`, which opens the file
    when the first request is there.
    """
    import resource  # whoever imports this module for its words may have none

    path, shared, size, most_bytes, most_s, *arguments = sys.argv[1:]
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what libraries print
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_DATA, int(most_bytes))
    _limit(resource.RLIMIT_CPU, int(most_s))
    memory = memoryview(mmap.mmap(int(shared), int(size)))
    answer: Answer | None = None
    while request := sys.stdin.buffer.readline().decode():
        try:
            answer = answer or open_file(path, memory, arguments)
            reply = f"ok {answer(request.split())}"
        except ImportError as error:
            reply = f"missing {error}"
        except MemoryError:
            reply = f"failed its decoder asks for more than {int(most_bytes) >> 20} MiB"
        except BaseException as error:  # a panic of Rust is no Exception
            reply = f"failed {str(error).partition(chr(10))[0] or type(error).__name__}"
        os.write(answers, reply[:_LONGEST].encode(errors="replace") + b"\n")
        if not reply.startswith("ok"):
            break
    os._exit(0)  # without the destructors of libraries


def _limit(what: int, most: int) -> None:
    """Set a soft limit, within the hard one."""
    import resource

    _, hard = resource.getrlimit(what)
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
