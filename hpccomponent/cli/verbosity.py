"""How much the command says: errors alone, news too, or all of its log.

Set once by the command, again where ``-v``, ``-q`` or ``--debug`` is read. Whoever shows progress
or a summary asks `is_quiet`, or logs at the level INFO, which is the same.
"""

from __future__ import annotations

import enum
import logging
import sys

from hpccomponent.cli.terminal import VisibleFormatter, visible_line, visible_text

OURS = ("hpcapp", "hpccomponent", "hpcloader", "hpcdeploy")
# What these log is raised too, and said in our words: a user sees it with --debug only.
FOREIGN = ("boto3", "botocore", "paramiko", "s3transfer", "urllib3")


class Verbosity(enum.Enum):
    """How much is said."""

    QUIET = enum.auto()
    """Errors, beside what the standard output gets."""
    NORMAL = enum.auto()
    """Warnings, progress and the summary, too."""
    VERBOSE = enum.auto()
    """All that our own code logs, with the seconds since the start."""
    DEBUG = enum.auto()
    """All logs, those of libraries too, with the loggers' names, and the traceback of an error."""


class _LineFormatter(logging.Formatter):
    """Writes a record without the traceback that it may carry."""

    def __init__(self, *, has_times: bool) -> None:
        super().__init__()
        self._has_times = has_times

    def format(self, record: logging.LogRecord) -> str:
        """Return its message; what was put into it, which may be others' words, breaks no line."""
        text = record.getMessage()
        if isinstance(record.args, tuple) and record.args:
            words = (a if isinstance(a, int | float) else visible_line(str(a)) for a in record.args)
            text = str(record.msg) % tuple(words)
        if self._has_times:
            text = f"{record.relativeCreated / 1000.0:8.3f} s  {text}"
        return visible_text(text)


class _LogLines(logging.Handler):
    """Writes to whatever stderr is at the time: bars put a stream there that spares them."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one record."""
        try:
            sys.stderr.write(self.format(record) + "\n")
            sys.stderr.flush()
        except OSError:
            self.handleError(record)


def set_verbosity(verbosity: Verbosity) -> None:
    """Have the logs of this process written to stderr, as far as they are asked for."""
    is_debug = verbosity is Verbosity.DEBUG
    lines = _LogLines()
    lines.setFormatter(
        VisibleFormatter("%(name)s: %(message)s")
        if is_debug
        else _LineFormatter(has_times=verbosity is Verbosity.VERBOSE)
    )
    ours, others = {
        Verbosity.QUIET: (logging.ERROR, logging.ERROR),
        Verbosity.NORMAL: (logging.INFO, logging.WARNING),
        Verbosity.VERBOSE: (logging.DEBUG, logging.WARNING),
        Verbosity.DEBUG: (logging.DEBUG, logging.INFO),
    }[verbosity]
    logging.basicConfig(level=others, handlers=[lines], force=True)
    for name in OURS:
        logging.getLogger(name).setLevel(ours)
    for name in FOREIGN:
        logging.getLogger(name).setLevel(logging.INFO if is_debug else logging.CRITICAL)
    logging.raiseExceptions = is_debug  # a log that cannot be written must not end the job
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").setLevel(logging.WARNING if is_debug else logging.ERROR)


def is_quiet() -> bool:
    """Tell whether nothing is to be said but errors."""
    return logging.getLogger("hpcapp").level > logging.INFO
