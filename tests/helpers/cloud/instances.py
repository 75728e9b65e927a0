"""The life of an instance, as moto lacks it: states that take a while, an owner in the test."""

from __future__ import annotations

import base64
from typing import Any

from moto.ec2.models.instances import InstanceState

PENDING, RUNNING, ENDING, TERMINATED, STOPPED = (
    ("pending", 0),
    ("running", 16),
    ("shutting-down", 32),
    ("terminated", 48),
    ("stopped", 80),
)


class Instance:
    """An instance as a test sees it.

    Parameters
    ----------
    ends_when_shut_down : bool
        Whether the cloud heeds ``InstanceInitiatedShutdownBehavior``.
    """

    def __init__(self, model: Any, ends_when_shut_down: bool, token: str) -> None:
        self._model = model
        self._ends = ends_when_shut_down
        self.token = token
        self.console = ""
        self.unseen = 0  # so many questions by its id are answered with NotFound
        self.unlisted = 0
        self.ticks: int | None = None  # so many descriptions until the next state
        self._set(PENDING)

    @property
    def id(self) -> str:
        return str(self._model.id)

    @property
    def state(self) -> str:
        return str(self._model._state.name)

    @property
    def type(self) -> str:
        return str(self._model.instance_type)

    @property
    def market(self) -> str:
        return "spot" if self._model.lifecycle == "spot" else "on_demand"

    @property
    def private_address(self) -> str:
        return self._model.private_ip or ""

    @property
    def public_address(self) -> str:
        return self._model.public_ip or ""

    @property
    def groups(self) -> list[str]:
        return [group.name for group in self._model.security_groups]

    @property
    def tags(self) -> dict[str, str]:
        return {tag["key"]: tag["value"] for tag in self._model.get_tags()}

    @property
    def user_data(self) -> bytes:
        return base64.b64decode(str(self._model.user_data or ""))

    @property
    def public_key(self) -> str:
        """The key that its launch named, as OpenSSH writes it; empty without one."""
        pair = self._model.ec2_backend.key_pairs.get(self._model.key_name)
        return pair.material_public.decode() if pair else ""

    def place(self, private: str, public: str) -> None:
        """Give it the addresses of a machine of the test."""
        nic = self._model.nics[0]
        nic.private_ip_address, nic.public_ip = private, public

    def boot(self) -> None:
        if self.state in ("pending", "stopped"):
            self._set(RUNNING)

    def end(self, previous: str, ticks: int | None) -> None:
        """Terminate it from its previous state on, at the user's request."""
        if previous == "terminated" or ticks is None:
            self._set(TERMINATED)
        else:
            left = self.ticks if previous == "shutting-down" else ticks
            self._set(ENDING)
            self.ticks = left

    def shut_down(self) -> None:
        """Switch it off from within."""
        ends = self._ends and self._model.instance_initiated_shutdown_behavior == "terminate"
        self._set(TERMINATED if ends else STOPPED, "Client.InstanceInitiatedShutdown")

    def die(self, reason: str = "Server.SpotInstanceTermination") -> None:
        """Let the cloud end it."""
        self._set(TERMINATED, reason)

    def tick(self) -> None:
        """Count one description; states go on by them."""
        if self.ticks is None:
            return
        self.ticks -= 1
        if self.ticks < 0 and self.state in ("pending", "shutting-down"):
            self._set(RUNNING if self.state == "pending" else TERMINATED)

    def _set(self, state: tuple[str, int], reason: str = "") -> None:
        self._model._state = InstanceState(*state)
        self.ticks = None
        if reason:
            self._model.state_reason.code = reason
            self._model.state_reason.message = reason
