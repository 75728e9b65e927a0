"""How much memory this process takes for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_MOST = 200 << 20  # that peers which lie or flood may cost the master


def _read(what: str) -> int:
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields[what].split()[0]) * 1024


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Assert that this process never takes much more memory than before, until the block ends."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # its peak counts from now on
    before = _read("VmRSS")
    yield
    assert _read("VmHWM") - before < _MOST
