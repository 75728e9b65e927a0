"""What a cluster costs, as an estimate from above, and whether the file allows it."""

from __future__ import annotations

from collections.abc import Iterable

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpcdeploy.provider import MachineSeen
from hpcdeploy.spec.cluster import ClusterSpec
from hpcdeploy.spec.names import HEAD
from hpcdeploy.spec.prices import read_prices
from hpcdeploy.spec.provider import CloudSpec, Profile


@dataclass(frozen=True, slots=True)
class CostLine:
    """Machines of one kind, ``head`` or ``workers``, of the dearest type of their profile.

    `hourly` is of one machine on demand, in dollars; None where no price is known, and `priced_by`,
    where it comes from, is empty then. Spot machines cost at most as much.
    """

    who: str
    count: int
    profile: str
    instance_type: str
    hourly: float | None
    priced_by: str = ""


@dataclass(frozen=True, slots=True)
class Cost:
    """What a cluster costs at most, in dollars.

    There are no `lines` where machines are there anyway. `lease_s` is how long they live at most,
    in seconds; `priced_as_of` year and month of the table that ships.
    """

    lines: tuple[CostLine, ...]
    lease_s: float
    priced_as_of: str

    @property
    def hourly(self) -> float:
        """All machines whose price is known, an hour."""
        return sum((line.count * line.hourly for line in self.lines if line.hourly), 0.0)

    @property
    def total_at_most(self) -> float:
        """The same until the end of the lease."""
        return self.hourly * self.lease_s / 3600

    @property
    def unknown(self) -> tuple[CostLine, ...]:
        """The machines that no price is known of."""
        return tuple(line for line in self.lines if line.hourly is None)


def estimate_cost(spec: ClusterSpec, workers: int | None = None) -> Cost:
    """Estimate what a cluster costs, by default with as many workers as the file says.

    It goes by a profile's ``hourly_cost``, or by the table that ships where the cloud is Amazon's.
    A Eucalyptus bills nobody by itself: what no ``hourly_cost`` is given for counts as nothing
    there. Traffic and S3 are not counted.
    """
    count = spec.worker_count if workers is None else workers
    cloud = spec.provider.cloud
    lines = []
    for who, node, number in ((HEAD, HEAD, 1), ("workers", "worker-1", count)):
        profile = spec.profile(node)
        if cloud is not None and profile is not None and number:
            instance_type, hourly = _dearest(cloud, profile)
            by = "" if hourly is None else cloud.priced_by(profile)
            lines.append(CostLine(who, number, spec.profile_name(node), instance_type, hourly, by))
    return Cost(tuple(lines), spec.limits.lease, read_prices().as_of)


def _dearest(cloud: CloudSpec, profile: Profile) -> tuple[str, float | None]:
    """Return the dearest type of a profile and its price; one without a price comes first."""
    priced = [(name, cloud.hourly(profile, name)) for name in profile.instance_types]
    return max(priced, key=lambda pair: float("inf") if pair[1] is None else pair[1])


def hourly_cost(spec: ClusterSpec) -> float | None:
    """Return what a cluster costs an hour at most, in dollars; None where it has no price."""
    cost = estimate_cost(spec)
    return None if cost.unknown or not cost.hourly else cost.hourly


def price_machines(cloud: CloudSpec | None, machines: Iterable[MachineSeen]) -> float | None:
    """Return what machines cost an hour at most, in dollars; None where a price is not known.

    `cloud` is of their cluster's file, or of another one; None where machines are there anyway.
    Spot machines cost at most as much as those on demand.
    """
    if cloud is None:
        return None
    prices = [cloud.dearest(machine.instance_type) for machine in machines]
    known = [price for price in prices if price is not None]
    return sum(known) if len(known) == len(prices) else None


def check_limits(spec: ClusterSpec, cost: Cost) -> None:
    """Hold a cluster to the limits of its file.

    Raises UsageError where it costs more than `max_hourly_cost` or `max_total_cost`, or perhaps
    does, because no price is known.
    """
    limits = spec.limits
    if cost.unknown and (limits.max_hourly_cost is not None or limits.max_total_cost is not None):
        line = cost.unknown[0]
        raise UsageError(
            f"no price is known of {line.instance_type} here, so the limits of cost cannot be held",
            f"give provider.profiles.{line.profile}.hourly_cost (0 where nobody bills), or drop "
            "limits.max_hourly_cost and limits.max_total_cost",
        )
    for name, limit, estimate, span in _money(spec, cost):
        if limit is not None and estimate > limit + 1e-9:
            raise UsageError(
                f"the cluster costs an estimated {write_dollars(estimate)} {span}, more than "
                f"limits.{name}, {write_dollars(limit)}",
                "take fewer or smaller machines or a shorter lease, or raise the limit",
            )


def _money(spec: ClusterSpec, cost: Cost) -> list[tuple[str, float | None, float, str]]:
    """Return for each limit of money its key, its value, what it is held against, and its span."""
    limits = spec.limits
    return [
        ("max_hourly_cost", limits.max_hourly_cost, cost.hourly, "an hour"),
        ("max_total_cost", limits.max_total_cost, cost.total_at_most, "within the lease"),
    ]


def describe_cost(cost: Cost) -> list[str]:
    """Return the lines in which people read it."""
    if not cost.lines:
        return ["cost: none that is known of: the machines are there anyway"]
    sources = " and ".join(dict.fromkeys(line.priced_by for line in cost.lines if line.priced_by))
    if not cost.unknown and not cost.hourly:
        return [f"cost: none, by {sources}"]
    lines = [
        f"cost: {line.who}: {line.count} x {line.instance_type}, "
        + (
            f"no price is known: give provider.profiles.{line.profile}.hourly_cost"
            if line.hourly is None
            else f"{write_dollars(line.hourly)} an hour each"
        )
        for line in cost.lines
    ]
    if len(cost.unknown) == len(cost.lines):
        return [*lines, "cost: not known"]
    known = "not known in all; what is known " if cost.unknown else ""
    at_most = "at least" if cost.unknown else "at most"
    lines.append(
        f"cost: {known}together {write_dollars(cost.hourly)} an hour, {at_most} "
        f"{write_dollars(cost.total_at_most)} until the lease of {cost.lease_s / 3600:g} h ends"
    )
    lines.append(f"prices: {sources}")
    lines.append("prices: the dearest type of each profile is counted; traffic is not")
    return lines


def describe_limits(spec: ClusterSpec, cost: Cost) -> list[str]:
    """Return the lines in which people read what a file's limits come to; none without prices."""
    limits = spec.limits
    if cost.unknown or not cost.hourly:
        return []
    idle = cost.hourly * limits.idle / 3600
    lines = [f"limits: {limits.idle / 60:g} min idle end it before, and cost {write_dollars(idle)}"]
    for name, limit, estimate, span in _money(spec, cost):
        if limit is not None:
            verdict = "keeps" if estimate <= limit + 1e-9 else "breaks"
            amounts = write_dollars(estimate), write_dollars(limit)
            lines.append(f"limits: {amounts[0]} {span} {verdict} {name}, {amounts[1]}")
    return lines


def write_dollars(amount: float) -> str:
    """Write an amount so that a cheap machine is not free."""
    return f"${amount:.2f}" if amount >= 1 or not amount else f"${amount:.4f}"
