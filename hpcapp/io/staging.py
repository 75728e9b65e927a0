"""Write beside and rename: a reader of the output sees the old file or the whole new one.

Until it has its name nobody but its owner can read it; then it has the rights that any new file has
there. Used by every writer of this package.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from hpccomponent.files.outputs import (
    check_folder,
    name_beside,
    staged,
    translated,
    usual_folder_mode,
    usual_mode,
)
from hpccomponent.files.private_files import create_private, make_private_folder


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that takes its place when the block ends well.

    Whatever ends the block otherwise, an interrupt included, removes it and leaves what was at
    `path`: of a symbolic link, the file it points to. Raise OutputError where the folder or the
    file cannot be written.
    """
    with staged(path) as (target, beside):
        mode = usual_mode(beside)
        with create_private(beside) as file:
            yield file
        beside.chmod(mode)
        os.replace(beside, target)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Make a temporary folder beside `path` that gets its name when the block ends well.

    Of a symbolic link, what it points to. Raise OutputError where there is something at `path`, or
    the folder cannot be written.
    """
    check_folder(path)
    target = Path(os.path.realpath(path))
    beside = name_beside(target)
    try:
        with translated(path, target):
            mode = usual_folder_mode(beside)
            make_private_folder(beside)
            yield beside
            beside.chmod(mode)
            os.replace(beside, target)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
