"""What the process does with memory that it has freed."""

from __future__ import annotations

from hpccomponent.surface.kernels.native.arrays import native

__all__ = ["bound_free_memory", "keep_memory"]


def keep_memory() -> None:
    """Have this process use memory that it has freed again, instead of giving it back."""
    native.keep_memory()


def bound_free_memory(most_bytes: int) -> None:
    """Give the system back what memory is free, if it is more than this."""
    native.bound_free_memory(most_bytes)
