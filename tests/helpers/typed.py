"""Commands as they are typed, in this process."""

from __future__ import annotations

import pytest

from hpcapp.cli import main


def run(*words: object) -> int:
    """Run a command; return its exit code."""
    with pytest.raises(SystemExit) as left:
        main([str(word) for word in words])
    assert isinstance(left.value.code, int)
    return left.value.code
