"""``hpcapp`` and ``python -m hpcapp``: the command, safe to interrupt from its first moment.

Importing the command takes a while; Ctrl-C in that time must not show a traceback.
"""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn

# No step calls BLAS to any extent; its threads would wake with numpy and spin for nothing. Here,
# not in `main`: MPI's workers import this module and do no more.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _leave(signum: int, frame: FrameType | None) -> NoReturn:
    """End at once: nothing has been started yet."""
    del signum, frame
    os.write(2, b"hpcapp: interrupted\n")
    os._exit(130)


def main() -> NoReturn:
    """Import the command and run it."""
    signal.signal(signal.SIGINT, _leave)
    from hpcapp.cli import main as run

    run()


if __name__ == "__main__":
    main()
