"""Whose answers are believed: a share of them is asked for again, on another machine.

::

    answer ── drawn? ── no ──────────────────────────────────> believed
                 │ yes
                 └─> another machine: the same bytes? ── yes ─> believed
                                          │ no
                                          └─> others decide: who agrees with none is a liar

Tasks are deterministic within one numerics id, so that honest machines give the same bytes. What is
drawn is chosen after the answer has come: no machine can know which of its answers matter. Until
two machines agree the task is not done, so that what it reads is still there. A job that has used
answers of a machine that is then found to lie is begun anew.
"""

from __future__ import annotations

import hashlib
import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field
from enum import Enum
from random import SystemRandom
from typing import TYPE_CHECKING, TypeVar

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import (
    CloudError,
    DistrustError,
    JobCancelledError,
    JobError,
    NoWorkersError,
    UsageError,
    WorkerLostError,
)

if TYPE_CHECKING:  # a job in one process does not wait for what speaks to others
    from hpcapp.communicator.scheduling.state import Task
    from hpccomponent.protocol.frames import Buffer
    from hpccomponent.protocol.messages import Result


_log = logging.getLogger(__name__)

Outcome = TypeVar("Outcome")

CLUSTER_SHARE = 0.02
"""Of the answers of a cluster's workers, where nothing else is asked for."""
LEAST_MACHINES = 3
"""With fewer nobody could decide between two answers; with more so many must agree on a disputed
one, so that two that conspire throw nobody out."""
_NO_LIES = (UsageError, CloudError, JobCancelledError, NoWorkersError, WorkerLostError, OSError)


class AnswerVerdict(Enum):
    """What becomes of an answer."""

    BELIEVED = "believed"
    ASK_ANOTHER = "ask another"
    UNDECIDED = "undecided"


@dataclass(slots=True, eq=False)
class Verification:
    """What one job knows of the honesty of machines, over all its attempts.

    Parameters
    ----------
    share : float or None
        Of the answers, that are asked for again: from 0 to 1. None where nothing was asked for:
        then a cluster's workers are held to `CLUSTER_SHARE`, and others to nothing.
    draw : callable
        Returns a random number from 0 to 1 that nobody can foresee.

    Attributes
    ----------
    liars : dict of str to str
        Names of machines that have lied, and what they did. A key has one name, see `Admission`.
    answers : Counter of frozenset of str
        How many answers have been used in this attempt on the word of these machines alone.
    everything : bool
        Whether every answer is asked for again, whatever the share.
    machines : int
        How many could answer at once, at most.
    distrust : str
        Why nothing of this attempt can be used; empty while all can.
    verified, unverified, disagreements : int
        Tasks that two machines agreed on; that nobody else was there for; that they disagreed on.
    seconds : float
        What the further runs took on workers.
    repeats : list of str
        Why the job was begun anew, each time.
    """

    share: float | None = None
    draw: Callable[[], float] = SystemRandom().random
    liars: dict[str, str] = field(default_factory=dict)
    answers: Counter[frozenset[str]] = field(default_factory=Counter)
    everything: bool = False
    machines: int = 0
    distrust: str = ""
    verified: int = 0
    unverified: int = 0
    disagreements: int = 0
    seconds: float = 0.0
    repeats: list[str] = field(default_factory=list)

    def begin_job(self) -> None:
        """Begin a job: all that is known of earlier ones is who has lied."""
        self.machines = self.verified = self.unverified = self.disagreements = 0
        self.seconds, self.repeats, self.everything = 0.0, [], False
        self.begin()

    def begin(self) -> None:
        """Begin an attempt: no answer has been used yet."""
        self.answers.clear()
        self.distrust = ""

    def judge(
        self, task: Task, machine: str, others: Collection[str], digest: Callable[[], bytes]
    ) -> tuple[AnswerVerdict, list[str]]:
        """Judge an answer, and name the machines that have lied.

        These have given another answer than two others, or three where four machines can answer, or
        than themselves before. `others` have not answered the task and could; `digest` returns what
        `digest_answer` makes of the answer.
        """
        is_first = not task.answers
        # Whoever failed at it is none of the others, and has an opinion.
        machines = len(others) + is_first + (task.failed_on is not None)
        self.machines = max(self.machines, machines)
        if is_first and not (task.is_verified and self._is_drawn(machines)):
            self.answers[frozenset({machine})] += 1
            return AnswerVerdict.BELIEVED, []
        answer, earlier = digest(), task.answers.get(machine)
        if earlier is not None and earlier != answer:
            return AnswerVerdict.ASK_ANOTHER, [machine]
        task.answers[machine] = answer
        counts = Counter(task.answers.values())
        [(accepted, agreeing)] = counts.most_common(1)
        is_small = len(task.answers) + len(others) <= LEAST_MACHINES
        if agreeing >= (2 if len(counts) == 1 or is_small else LEAST_MACHINES):
            lying = [name for name, given in task.answers.items() if given != accepted]
            if answer != accepted:
                return AnswerVerdict.ASK_ANOTHER, lying
            self.verified += 1
            self.answers[frozenset(task.answers.keys() - lying)] += 1
            return AnswerVerdict.BELIEVED, lying
        if others:
            self.disagreements += len(counts) == len(task.answers) == 2
            return AnswerVerdict.ASK_ANOTHER, []
        if len(counts) > 1:
            return AnswerVerdict.UNDECIDED, []
        self.unverified += 1
        self.answers[frozenset({machine})] += 1
        return AnswerVerdict.BELIEVED, []

    def _is_drawn(self, machines: int) -> bool:
        share = 1.0 if self.everything else self.share or 0.0
        return machines >= LEAST_MACHINES and self.draw() < share

    def accuse(self, machine: str, reason: str, tasks: Iterable[Task] = ()) -> None:
        """Note that a machine has lied; its answers to `tasks`, all open ones, count no more."""
        for task in tasks:
            if task.answers.pop(machine, None) is not None:
                self.note_written([machine] * task.has_written)
        self.liars[machine] = reason
        known = self.liars.keys()
        if count := sum(n for vouching, n in self.answers.items() if vouching <= known):
            self.distrust = f"{reason}; {count} of its answers had been used before"

    def note_written(self, machines: Iterable[str]) -> None:
        """Note that a machine has left in a folder, for others to read, what nobody vouches for."""
        self.answers.update(frozenset({machine}) for machine in machines)

    def suspect(self, error: Exception) -> str:
        """Return why an attempt that ends with an error is to be made again; empty where not.

        What a task or this process found impossible may come of a lie that looked right: once,
        everything is verified.
        """
        if self.distrust or isinstance(error, DistrustError):
            return self.distrust or str(error)
        can_tell = self.machines >= LEAST_MACHINES and bool(self.share) and not self.everything
        has_trusted = any(len(vouching) == 1 for vouching in self.answers)
        if isinstance(error, _NO_LIES) or not (can_tell and has_trusted):
            return ""
        self.everything = True
        return f"every answer is verified, because this may come of a wrong one: {error}"

    def describe(self) -> str:
        """Say in one line what was found."""
        summary = f"{self.verified} answers were verified on other machines, {self.seconds:.1f} s"
        liars = sorted(set(self.liars.values()))
        return "; ".join([summary, *liars] if liars else [summary, "all agreed"])

    def to_json(self) -> dict[str, object]:
        """Return what the report says of it."""
        return {
            "share": self.share,
            "verified": self.verified,
            "unverified": self.unverified,
            "disagreements": self.disagreements,
            "seconds": round(self.seconds, 6),
            "liars": sorted(set(self.liars.values())),
            "repeats": self.repeats,
        }


def explain_dispute(task: Task) -> JobError:
    """Return the error of a task to which machines gave different answers, and no other is left."""
    names = " and ".join(sorted(task.answers))
    problem = f"{names} gave different answers to {task.name!r}, and no machine can decide"
    return JobError(problem, "give the job another machine")


def digest_answer(result: Result, buffers: Sequence[Buffer]) -> bytes:
    """Return what tells one answer to a task from another one.

    It is BLAKE2b of all that was sent, and of the checksum of what the task has written.
    """
    digest = hashlib.blake2b(result.header, digest_size=16)
    for buffer in buffers:
        digest.update(buffer)
    digest.update(result.written.to_bytes(8, "little"))
    return digest.digest()


@contextmanager
def attempt(
    verification: Verification, is_callers: Callable[[Exception], bool] = lambda _: False
) -> Iterator[None]:
    """Raise a `DistrustError` in place of what may come of a lie, and of a result that does.

    `is_callers` tells of an error whether the caller has raised it, so that it is no lie.
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

    Each repetition has a liar less, or is the one in which every answer is verified. `run` is told
    whether it is the first time, and does its work within `attempt`.
    """
    verification.begin_job()
    while True:
        try:
            return run(not verification.repeats)
        except DistrustError as error:
            _log.warning("the work begins anew: %s", error.problem)
            verification.repeats.append(error.problem)
            verification.begin()
