"""The supervisor's brain: when to start, restart, give up on, stop and kill one component.

::

               start             exited
      IDLE ──────────> RUNNING ──────────> WAITING ── the delay is over ──> RUNNING
                          │ stop              │ stop
                          v                   v
                       STOPPING ──exited──> ENDED   <── too many failures in a row, or
                          │ the grace is over             an exit that no restart can help
                          v
                       KILLING ──exited──> ENDED

Sans-I/O: events come in with the time, actions go out; `daemon` carries them out.
"""

from __future__ import annotations

from enum import Enum, auto

from hpccomponent.dataclass import dataclass

EXIT_FAILED = 1
EXIT_CONFIG = 2


class ComponentState(Enum):
    """Where the component's life stands."""

    IDLE = auto()
    RUNNING = auto()
    WAITING = auto()
    STOPPING = auto()
    KILLING = auto()
    ENDED = auto()


@dataclass(frozen=True, slots=True)
class Start:
    """Start the component."""


@dataclass(frozen=True, slots=True)
class AskToEnd:
    """Ask the component to leave."""


@dataclass(frozen=True, slots=True)
class Kill:
    """Kill the component."""


@dataclass(frozen=True, slots=True)
class End:
    """Leave, with this exit code; nothing runs any more.

    `complaint` is why the supervisor gave up; empty after a stop that was asked for.
    """

    complaint: str = ""
    exit_code: int = 0


Action = Start | AskToEnd | Kill | End


@dataclass(frozen=True, slots=True)
class RestartRule:
    """How a component that has ended is started again; times are in seconds.

    The delay is `first_s` after the first quick end, and doubles with each further one up to
    `cap_s`. A run shorter than `quick_s` was quick; a longer one clears the count. After
    `give_up_after` quick failures in a row there is no further start. `grace_s` is from the request
    to leave to the kill.
    """

    first_s: float = 0.5
    cap_s: float = 30.0
    give_up_after: int = 5
    quick_s: float = 10.0
    grace_s: float = 5.0

    def delay(self, quick_ends: int) -> float:
        """Return the delay after so many quick ends in a row: `first_s` to `cap_s` seconds."""
        doublings = min(max(quick_ends - 1, 0), 60)  # 2**60 is past every cap
        return min(self.cap_s, self.first_s * 2.0**doublings)


class Supervisor:
    """Watches over one component.

    Every method takes the present moment in seconds and returns the actions to carry out, in order.
    `deadline` says when `tick` wants to be called next.

    A clean exit (code 0: the master is done) is followed by a start as well, because the next
    master may come; it slows the starts like any quick end but never makes the supervisor give up.
    Exit code 2 (a wrong configuration, or a refusal by the master) does so at once, because no
    restart changes that.

    Examples
    --------
    >>> supervisor = Supervisor(RestartRule(first_s=1.0))
    >>> supervisor.start(0.0)
    [Start()]
    >>> supervisor.exited(3.0, code=1), supervisor.deadline
    ([], 4.0)
    >>> supervisor.tick(4.0)
    [Start()]
    """

    def __init__(self, rule: RestartRule) -> None:
        self.rule = rule
        self.state = ComponentState.IDLE
        self.deadline: float | None = None
        self._started = 0.0
        self._quick_ends = 0
        self._quick_failures = 0

    def start(self, now: float) -> list[Action]:
        """Take note that the component is wanted; only the first call counts."""
        return self._run(now) if self.state is ComponentState.IDLE else []

    def exited(self, now: float, code: int) -> list[Action]:
        """Take note that the component has ended with exit code `code` (-N: by signal N).

        Return `End`, or nothing: a further start comes by `tick`.
        """
        if self.state in (ComponentState.STOPPING, ComponentState.KILLING):
            return self._end()
        if self.state is not ComponentState.RUNNING:
            return []
        self._count(now - self._started, code)
        if code == EXIT_CONFIG:
            return self._end(
                "the component's configuration is wrong, or its master refused it (exit code 2)",
                EXIT_CONFIG,
            )
        if self._quick_failures >= self.rule.give_up_after:
            last = f"by signal {-code}" if code < 0 else f"with exit code {code}"
            return self._end(
                f"the component failed {self._quick_failures} times in a row, each time "
                f"within {self.rule.quick_s:g} s of its start, last {last}",
                EXIT_FAILED,
            )
        self.state = ComponentState.WAITING
        self.deadline = now + self.rule.delay(self._quick_ends)
        return []

    def tick(self, now: float) -> list[Action]:
        """Act on a deadline that has passed; `Start`, `Kill`, or nothing."""
        if self.deadline is None or now < self.deadline:
            return []
        if self.state is ComponentState.WAITING:
            return self._run(now)
        self.state = ComponentState.KILLING
        self.deadline = None
        return [Kill()]

    def stop(self, now: float, grace_s: float | None = None) -> list[Action]:
        """Take note that the component is no longer wanted; return `AskToEnd`, `End`, or nothing.

        `grace_s` is the time to leave by itself, in seconds, instead of the rule's; a later call
        may shorten an earlier one's.
        """
        deadline = now + (self.rule.grace_s if grace_s is None else grace_s)
        if self.state is ComponentState.RUNNING:
            self.state = ComponentState.STOPPING
            self.deadline = deadline
            return [AskToEnd()]
        if self.state is ComponentState.STOPPING and self.deadline is not None:
            self.deadline = min(self.deadline, deadline)
            return []
        return self._end() if self.state in (ComponentState.IDLE, ComponentState.WAITING) else []

    def _run(self, now: float) -> list[Action]:
        self.state = ComponentState.RUNNING
        self.deadline = None
        self._started = now
        return [Start()]

    def _count(self, lived_s: float, code: int) -> None:
        """Count quick ends and quick failures in a row."""
        if lived_s >= self.rule.quick_s:
            self._quick_ends = self._quick_failures = 0
            return
        self._quick_ends += 1
        self._quick_failures = 0 if code == 0 else self._quick_failures + 1

    def _end(self, complaint: str = "", exit_code: int = 0) -> list[Action]:
        self.state = ComponentState.ENDED
        self.deadline = None
        return [End(complaint, exit_code)]
