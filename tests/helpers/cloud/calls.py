"""Requests as they were sent, and what a test lets go wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, field

FOREVER = -1


class CutError(ConnectionError):
    """Raised by a hook: the connection ends without an answer."""


@dataclass(frozen=True)
class Call:
    """A request, as it was sent."""

    action: str
    parameters: dict[str, str] = field(repr=False)

    @property
    def changes(self) -> bool:
        """Whether it is one that could change anything; a dry run is none."""
        reads = self.action.startswith(("Describe", "Get"))
        return not reads and self.parameters.get("DryRun") != "true"


@dataclass
class Fault:
    """An error that is injected, or an answer that is lost."""

    action: str
    code: str
    status: int
    message: str
    match: dict[str, str]
    times: int
    loses_answer: bool = False

    def fits(self, call: Call) -> bool:
        return (
            self.times != 0
            and self.action in ("*", call.action)
            and all(call.parameters.get(name) == value for name, value in self.match.items())
        )
