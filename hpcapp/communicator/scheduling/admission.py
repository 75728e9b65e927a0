"""Who may work for this master: versions, numerics, and one name per key."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from hpcapp.communicator.scheduling.state import Worker
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.frames import SMALLEST_FRAME
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Register


@dataclass(slots=True)
class Admission:
    """What a component must have in common with its master.

    Parameters
    ----------
    package : str
        The release; another could give other results.
    numerics : str or None
        The numerics id, so that every worker gives the same bits; None until the first has set it.
    banned : mapping of str to str
        Names of workers that have been turned away, and why.
    names : mapping of str to str or None
        The name of each key (Z85) that may work; None where they are not looked at. The master
        gives them: who could choose would have as many opinions as names, or an honest worker's.
    """

    package: str
    numerics: str | None
    banned: Mapping[str, str]
    names: Mapping[str, str] | None

    def objection(self, register: Register, key: str, workers: Collection[Worker]) -> str | None:
        """Return why a component, by its public key (Z85), cannot join; None if it can."""
        if self.names is not None and self.names.get(key) != register.worker:
            return f"its key is not that of {register.worker!r}"
        if register.worker in self.banned:
            return self.banned[register.worker]
        if register.protocol != PROTOCOL_VERSION:
            return f"it speaks protocol {register.protocol}, the master {PROTOCOL_VERSION}"
        if register.package != self.package:
            return f"it runs hpcapp {register.package}, the master {self.package}"
        if self.numerics is not None and register.numerics != self.numerics:
            return (
                f"its results would differ in their last bits: numerics {register.numerics}, "
                f"while this job uses {self.numerics}"
            )
        if register.largest_frame < SMALLEST_FRAME:
            return f"its largest frame is {register.largest_frame} bytes, below {SMALLEST_FRAME}"
        namesakes = (worker for worker in workers if worker.register.worker == register.worker)
        if any(worker.key != key for worker in namesakes):
            return f"another key is at work under the name {register.worker!r}"
        return None
