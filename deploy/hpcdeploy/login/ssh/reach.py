"""Why a machine cannot be logged in to: the causes, told apart.

None of them says that a machine is broken: whoever meets one knows nothing of the machine's
health, and changes nothing for it.
"""

from __future__ import annotations

from enum import StrEnum

from hpccomponent.errors import CloudError


class LoginFault(StrEnum):
    """The cause, as it is told in one phrase."""

    UNREACHABLE = "unreachable"
    SILENT = "does not answer"
    NOT_SSH = "does not speak SSH"
    HOST_KEY_UNKNOWN = "host key unknown"
    HOST_KEY_CHANGED = "host key changed"
    KEY_REFUSED = "refuses our key"
    NO_KEY = "no key to log in with"  # the machine was not asked
    PASSPHRASE_NEEDED = "passphrase needed"  # noqa: S105 - a cause


class ReachError(CloudError):
    """A machine that cannot be logged in to, with the cause and the command that mends it."""

    def __init__(
        self,
        problem: str,
        advice: str = "",
        reach: LoginFault = LoginFault.UNREACHABLE,
        excerpt: str = "",
    ) -> None:
        super().__init__(problem, advice, excerpt)
        self.args = (problem, advice, reach, excerpt)  # what pickling makes it again from
        self.reach = reach
