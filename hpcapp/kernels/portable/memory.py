"""The allocator's settings, which numpy has none of."""

from __future__ import annotations

__all__ = ["bound_free_memory", "keep_memory"]


def keep_memory(is_on: bool) -> None:
    """Do nothing: memory that numpy has freed is the allocator's own affair."""
    del is_on


def bound_free_memory(most_bytes: int) -> None:
    """Do nothing; see `keep_memory`. So many bytes may stay free in this process."""
    del most_bytes
