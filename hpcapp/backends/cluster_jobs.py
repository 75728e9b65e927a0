"""Whole jobs on a cluster from anywhere: what another package knows about cluster files."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

from hpccomponent.errors import UsageError

__all__ = ["load_cluster_function"]


def load_cluster_function(name: str) -> Callable[..., Any]:
    """Return the function that is registered under `name` as an entry point ``hpc.clusters``.

    Parameters
    ----------
    name : str
        ``open`` or ``run``.

    Raises
    ------
    UsageError
        No installed package knows cluster files.
    """
    found = entry_points(group="hpc.clusters", name=name)
    if not found:
        raise UsageError("no installed package knows cluster files", "install hpcapp anew")
    function: Callable[..., Any] = next(iter(found)).load()
    return function
