"""The whole error tree; every error that a user may see is one of these.

::

    HpcError                      exit 1
    ├── UsageError                exit 2   contradictory or impossible flags
    │   ├── ConfigError                    a YAML file: file:line:column, key, what to do
    │   ├── OutputError                    the place to write to cannot be written
    │   └── MissingLibraryError            an optional package is not installed; an ImportError too
    ├── InputError                exit 3   a file or an array holds no usable points
    ├── CloudError                exit 4   a cloud, an instance, provisioning
    │   ├── CapacityError                  this type, market or zone is not to be had now
    │   ├── LeftoverError                  something could not be taken away
    │   ├── OutdatedError                  what was agreed to is not what would be done now
    │   └── ReachError                     why SSH does not let in (hpcdeploy.login.ssh.reach)
    └── JobError                  exit 1   the work could not be finished
        ├── TaskError                      the task's function raised
        ├── WorkerLostError                a batch outlived too many workers
        ├── NoWorkersError                 no worker is left, or none ever came
        ├── JobCancelledError              somebody cancelled it
        ├── DistrustError                  answers that were used came from a machine that lies
        └── ProtocolError                  a peer broke the wire protocol

Every error takes positional fields only, so that it survives pickling between processes
(CPython #80041), and says what is wrong, where, and what to do. The command line prints
``str(error)`` as one line (a file's mistakes one a line), an excerpt of somebody else's words below
it, and leaves with ``error.exit_code``.
"""

from __future__ import annotations

__all__ = [
    "CapacityError",
    "CloudError",
    "ConfigError",
    "DistrustError",
    "HpcError",
    "InputError",
    "JobCancelledError",
    "JobError",
    "LeftoverError",
    "MissingLibraryError",
    "NoWorkersError",
    "OutdatedError",
    "OutputError",
    "ProtocolError",
    "TaskError",
    "UsageError",
    "WorkerLostError",
]


class HpcError(Exception):
    """Root of the tree.

    Parameters
    ----------
    problem : str
        What is wrong, and where.
    advice : str
        What the user can do about it.
    excerpt : str
        Lines of somebody else's that tell more, such as the end of a machine's console: shown
        below, in a block of their own.
    """

    exit_code = 1

    def __init__(self, problem: str, advice: str = "", excerpt: str = "") -> None:
        super().__init__(problem, advice, excerpt)
        self.problem = problem
        self.advice = advice
        self.excerpt = excerpt

    def __str__(self) -> str:
        return f"{self.problem}; {self.advice}" if self.advice else self.problem


class UsageError(HpcError):
    """Flags that contradict each other or ask for the impossible."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration file that is not as it should be."""


class OutputError(UsageError):
    """A place to write to that cannot be written."""


class MissingLibraryError(UsageError, ImportError):
    """An optional package that is not installed."""


class InputError(HpcError):
    """A file or an array that holds no usable points."""

    exit_code = 3


class CloudError(HpcError):
    """A cloud, an instance or a provisioning step that failed."""

    exit_code = 4


class CapacityError(CloudError):
    """A machine of this type, market or zone that cannot be had now; another may be."""


class LeftoverError(CloudError):
    """Something of ours that could not be taken away."""


class OutdatedError(CloudError):
    """Something that has changed since the user agreed to what would be done with it."""


class JobError(HpcError):
    """Work that could not be finished."""


class JobCancelledError(JobError):
    """Work that somebody has cancelled."""


class TaskError(JobError):
    """A task whose function raised on a worker."""


class WorkerLostError(JobError):
    """A batch that was lost together with too many workers."""


class NoWorkersError(JobError):
    """A job without any worker, and none to be expected."""


class DistrustError(JobError):
    """A job that has used answers of a machine that lied since: it has to be begun anew."""


class ProtocolError(JobError):
    """A peer that broke the wire protocol."""
