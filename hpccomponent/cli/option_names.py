"""How messages name an option: as the command line has it, or as Python does.

Whoever raises an error or logs a warning asks `name_option`; the border says which way. Python is
spoken unless the process is the command's own::

    hpcapp/cli.py ── speaking_flags ──> --voxel-size 0.1
    else                            ──> voxel_size=0.1
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

_IN_PYTHON = {
    "backend": "executor",
    "print": "for_print",
    "viewpoint": "viewpoints",
    "plane": "planes",
}
_speakers = 0  # of flags; the whole process speaks one way, its threads too


def name_option(name: str, value: object = None) -> str:
    """Return an option, with a value if there is one, as its user would write it.

    The name is that of its field in the settings. A string that stands for something else, as
    ``X,Y,Z``, is shown as it is.

    Examples
    --------
    >>> name_option("voxel_size", 0.1), name_option("viewpoint")
    ('voxel_size=0.1', 'viewpoints')
    >>> with speaking_flags():
    ...     name_option("voxel_size", 0.1), name_option("viewpoint", "above")
    ('--voxel-size 0.1', '--viewpoint above')
    """
    if _speakers:
        flag = "--" + name.replace("_", "-")
        return flag if value is None else f"{flag} {value}"
    word = _IN_PYTHON.get(name, name)
    return word if value is None else f"{word}={value!r}"


@contextmanager
def speaking_flags() -> Iterator[None]:
    """Have messages of this process name flags."""
    global _speakers
    _speakers += 1
    try:
        yield
    finally:
        _speakers -= 1
