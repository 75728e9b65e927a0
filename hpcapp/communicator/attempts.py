"""Work that is begun anew where answers that it has used turn out to come from a liar."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from hpcapp.communicator.verification import Verification
from hpccomponent.errors import DistrustError

__all__ = ["attempt", "repeat_until_trusted"]

Outcome = TypeVar("Outcome")

_log = logging.getLogger(__name__)


@contextmanager
def attempt(
    verification: Verification, is_callers: Callable[[Exception], bool] = lambda _: False
) -> Iterator[None]:
    """Raise a `DistrustError` in place of what may come of a lie, and of a result that does.

    Parameters
    ----------
    is_callers : callable, optional
        Tells of an error whether the caller has raised it, so that it is no lie.
    """
    try:
        yield
    except Exception as error:
        reason = "" if is_callers(error) else verification.suspect(error)
        if not reason:
            raise
        raise DistrustError(reason) from error
    if verification.distrust:
        raise DistrustError(verification.distrust)


def repeat_until_trusted(verification: Verification, run: Callable[[bool], Outcome]) -> Outcome:
    """Run work from its start until no machine has lied in it.

    Each repetition has a liar less, or is the one in which every answer is verified.

    Parameters
    ----------
    run : callable
        Told whether it is the first time; does its work within `attempt`.
    """
    verification.begin_job()
    while True:
        try:
            return run(not verification.repeats)
        except DistrustError as error:
            _log.warning("the work begins anew: %s", error.problem)
            verification.repeats.append(error.problem)
            verification.begin()
