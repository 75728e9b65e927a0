"""Getting machines: types and markets in their order, again after a while, several at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import datetime, timedelta

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import CapacityError, CloudError
from hpcdeploy.ownership.journal import Journal
from hpcdeploy.provider import Launch, LaunchChoice, MachineSeen, Provider, State
from hpcdeploy.reconcile.drift import made_as
from hpcdeploy.reconcile.plan import LaunchNode
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import HEAD, NodeName, Owner
from hpcdeploy.spec.polling import Polling

AT_ONCE = 8
"""More launches at a time only meet the cloud's own rate limit."""
REMEMBERED = 20
"""So many generations may have come and gone that the cloud does not list any more."""


@dataclass(frozen=True, slots=True)
class Launcher:
    """Starts the machines of one life of a cluster, which are `owner`'s."""

    spec: ClusterSpec
    provider: Provider
    journal: Journal
    report: Callable[[str], None]
    polling: Polling
    incarnation: str
    owner: Owner

    def launch_all(
        self, actions: Sequence[LaunchNode]
    ) -> tuple[list[MachineSeen], dict[str, CloudError]]:
        """Start the machines of some nodes; without a head, no worker is started.

        Tell of which nodes no machine is to be had, and why.
        """
        head = [action for action in actions if action.name.node == HEAD]
        workers = [action for action in actions if action.name.node != HEAD]
        results = [self._launch(action) for action in head]
        if workers and not any(isinstance(result, CloudError) for result in results):
            with ThreadPoolExecutor(min(AT_ONCE, len(workers)), "launch") as pool:
                results += pool.map(self._launch, workers)
        outcomes = list(zip((*head, *workers), results, strict=False))
        return (
            [result for result in results if not isinstance(result, CloudError)],
            {a.name.node: result for a, result in outcomes if isinstance(result, CloudError)},
        )

    def _launch(self, action: LaunchNode) -> MachineSeen | CloudError:
        """Try the choices in their order, and the whole order again after a while."""
        error = CloudError(f"{action.name.node}: nothing to try")
        for wait_s in (0.0, *self.polling.backoff_s):
            if wait_s:
                self.report(f"{error.problem}; trying again in {wait_s:.0f} s")
                self.polling.sleep(wait_s)
            # First the choice whose answer an earlier command did not live to see.
            attempt = self.journal.attempt(self.incarnation, action.name)
            for choice in dict.fromkeys((*([attempt.choice] if attempt else []), *action.choices)):
                try:
                    return self._ask(action, choice)
                except CapacityError as refusal:
                    error = refusal
                except CloudError as failure:
                    return failure
        return error

    def _ask(self, action: LaunchNode, choice: LaunchChoice) -> MachineSeen:
        """Launch; where the cloud remembers a machine that is gone, its successor."""
        name, told = action.name, f" as {choice}" if choice.instance_type else ""
        for generation in range(name.generation, name.generation + REMEMBERED):
            asked = NodeName(name.node, generation)
            until = self._lease_until(asked, choice)
            launch = self._order(action, asked, choice, until)
            with self.journal.step(
                f"launch {name.node}{told}",
                incarnation=self.incarnation,
                node=name.node,
                generation=generation,
                instance_type=choice.instance_type,
                market=choice.market,
                zone=choice.place,
                lease_until=until.isoformat(),
                key=self.owner.key,
            ):
                seen = self.provider.launch(launch)
            if seen.state not in (State.ENDING, State.GONE):
                self.report(f"launched {name.node} {seen.id}{told}")
                return seen
        raise CloudError(f"{name.node}: its last {REMEMBERED} machines are gone at once")

    def _order(
        self, action: LaunchNode, name: NodeName, choice: LaunchChoice, until: datetime
    ) -> Launch:
        launch = Launch(
            cluster=self.spec.cluster,
            incarnation=self.incarnation,
            name=name,
            profile=action.profile,
            instance_type=choice.instance_type,
            market=choice.market,
            place=choice.place,
            lease_until=until,
            tags=dict(self.spec.tags),
            owner=self.owner,
            desired=action.desired,
            made_as=made_as(self.spec, name.node),
        )
        if not action.profile:
            return launch
        from hpcdeploy.install.user_data import user_data

        return replace(launch, user_data=user_data(self.spec, choice.market, until))

    def _lease_until(self, name: NodeName, choice: LaunchChoice) -> datetime:
        """Return the end of the lease: a request that is repeated must be the same in all parts."""
        attempt = self.journal.attempt(self.incarnation, name)
        lease = timedelta(seconds=self.spec.limits.lease)
        now = self.polling.now().replace(microsecond=0)
        if attempt and attempt.choice == choice and attempt.lease_until > now + lease / 2:
            return attempt.lease_until
        return now + lease
