"""Whether the workers see files of the master, so that they may read and write them themselves."""

from __future__ import annotations

from pathlib import Path

from hpcapp.workforce import Workforce, map_batches
from hpccomponent.files.shared_files import sees_files

__all__ = ["workers_see"]

_ASKED = 2


def workers_see(workforce: Workforce, *files: Path) -> bool:
    """Ask the workers whether they see some files.

    An Executor does not say which worker a task will run on: each is asked twice on average, and
    who was not asked must still be able to tell.

    Parameters
    ----------
    workforce : Workforce
    *files : Path
        As for `hpccomponent.files.shared_files.sees_files`; they must not grow meanwhile.

    Returns
    -------
    bool
        Whether all answers were yes; true where tasks run in this process.

    Raises
    ------
    OSError
        This process does not see one of them itself.
    """
    found = tuple((str(file.resolve()), file.stat().st_size) for file in files)
    if workforce.in_process:
        return True
    return all(map_batches(workforce, sees_files, [found] * (_ASKED * workforce.workers)))
