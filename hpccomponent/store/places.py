"""Where values lie between the parts of a job: a folder that its machines share, or a bucket.

::

    open_store("/shared/job")  ──> FolderStore     a file each, mapped into memory
    open_store("s3://lab/job") ──> S3Store         an object each (see `hpccomponent.store.s3`)
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from hpccomponent.errors import CloudError, UsageError
from hpccomponent.store.base import FolderStore, Store


def open_store(place: str, *, makes_folders: bool = True) -> Store:
    """Open a store: a folder, ``folder:PATH``, or ``s3://BUCKET/PREFIX``.

    A folder is made where there is none (`makes_folders`: see `FolderStore`); a bucket is found by
    the usual variables (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, ...). Raise UsageError for a
    place of another kind, OutputError where the folder cannot be made, and CloudError where the
    bucket is not there, or there are no credentials for it.
    """
    scheme, colon, rest = place.partition(":")
    if scheme == "s3" and colon:
        try:
            from hpccomponent.store.s3 import open_s3_store  # it imports boto3
        except ImportError as error:
            raise CloudError(
                f"{place}: boto3 is not installed on this machine",
                "install it on every worker, or name a folder that all of them share",
            ) from error
        return open_s3_store(place)
    if scheme == "folder" and rest:
        return FolderStore(Path(rest), makes_folders=makes_folders)
    if "://" in place or not place:
        raise UsageError(f"no store is known at {place!r}", "name a folder, or s3://BUCKET/PREFIX")
    return FolderStore(Path(place), makes_folders=makes_folders)


@cache
def hold_store(place: str) -> Store:
    """Open a store that this process keeps open: for tasks, which come one after the other.

    A client of a bucket takes longer to make than a tile takes to be put there. Of a folder none is
    made: a task that is late must not bring back what its job has taken away.
    """
    return open_store(place, makes_folders=False)
