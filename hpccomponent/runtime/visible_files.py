"""Whether a worker sees files of the master (a task)."""

from __future__ import annotations

import os

from hpccomponent.protocol.declared import Flag
from hpccomponent.runtime.tasks import declare


@declare(result=Flag(), limit=4096, is_verified=False)
def sees_files(*files: tuple[str, int]) -> bool:
    """Tell whether some files, of these paths and lengths in bytes, are there (a task).

    A name with a random part in it is found nowhere by chance; a name that a user gave is, so let a
    random one be among them.

    Examples
    --------
    >>> sees_files((__file__, os.path.getsize(__file__))), sees_files((__file__, -1))
    (True, False)
    """
    try:
        return all(os.stat(path).st_size == length for path, length in files)
    except OSError:
        return False
