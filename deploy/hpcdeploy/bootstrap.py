"""Turn running machines into members of a cluster: package, keys, loader, inventory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hpcdeploy.access import Access
from hpcdeploy.provider import MachineSeen, Problem
from hpcdeploy.spec import ClusterSpec

__all__ = ["Failure", "check_wheels", "set_up"]


@dataclass(frozen=True, slots=True)
class Failure:
    """A machine that could not be set up.

    Parameters
    ----------
    machine : MachineSeen
    reason : str
        One line.
    """

    machine: MachineSeen
    reason: str


def set_up(
    spec: ClusterSpec,
    machines: Sequence[MachineSeen],
    access: Access,
    report: Callable[[str], None],
) -> list[Failure]:
    """Make these machines the cluster: what is in place already stays as it is.

    Returns
    -------
    list of Failure
        The machines that do not work; the inventory on the head has all others.
    """
    raise NotImplementedError


def check_wheels(spec: ClusterSpec, base: Path) -> list[Problem]:
    """Return what is missing in the wheelhouse, one problem for each wheel."""
    raise NotImplementedError
