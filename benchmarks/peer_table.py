"""The table that peers.py prints: a line for each contender, and ratios at the end."""

from __future__ import annotations

import math
from typing import Any

__all__ = ["geometric_mean", "print_cloud", "print_summary", "ratios"]

Outcomes = list[dict[str, Any]]  # of one cloud, ours first

_HEAD = (
    f"{'cloud':20} {'contender':12} {'L1 %':>8} {'ratio':>6} {'rms %':>8} {'Hausd %':>8} "
    f"{'normal':>7} {'closed':>6} {'comps':>5} {'genus':>5} {'CPU s':>7} {'wall s':>7} {'MB':>6}"
)


def print_cloud(outcomes: Outcomes, with_head: bool) -> None:
    """Print one cloud's contenders; `ratio` is our L1 by theirs."""
    if with_head:
        print(_HEAD)
    ours = outcomes[0]
    for outcome in outcomes:
        start = f"{outcome['cloud']:20} {outcome['contender']:12}"
        usage, measures = outcome["usage"], outcome["measures"]
        if measures is None:
            print(f"{start} no mesh, exit code {usage['exit_code']}", flush=True)
            continue
        ratio = _ratio(ours, outcome, "l1")
        shape = measures["topology"]
        print(
            f"{start} {measures['l1']:8.4f} {'' if ratio is None else f'{ratio:.3f}':>6} "
            f"{measures['rms']:8.4f} {measures['hausdorff']:8.3f} {measures['normal_deg']:7.2f} "
            f"{'yes' if shape['watertight'] else 'NO':>6} {shape['components']:5} "
            f"{'-' if shape['genus'] is None else shape['genus']:>5} {usage['cpu_s']:7.2f} "
            f"{usage['wall_s']:7.2f} {usage['rss_mb']:6.0f}",
            flush=True,
        )


def print_summary(everything: list[Outcomes]) -> None:
    """Print geometric means of ours by each peer's, and by the best peer of each cloud."""
    if not everything:
        return
    rivals = [outcome["contender"] for outcome in everything[0][1:]]
    print(f"\nours / theirs over {len(everything)} clouds, geometric mean (worst)")
    for rival in (*rivals, "best of them"):
        parts = []
        for key in ("l1", "normal_deg", "cpu_s", "wall_s", "rss_mb"):
            found = ratios(everything, rival, key)
            if found:
                parts.append(f"{key} {geometric_mean(found):.3f} ({max(found):.3f})")
        print(f"  {rival:14} " + "  ".join(parts))


def ratios(everything: list[Outcomes], rival: str, key: str) -> list[float]:
    """Return ours by theirs for every cloud on which both made a mesh.

    Parameters
    ----------
    rival : str
        A contender, or ``best of them``: whoever has the smallest value on that cloud.
    key : str
        ``l1``, ``normal_deg``, ``cpu_s``, ``wall_s`` or ``rss_mb``.
    """
    found = []
    for ours, *theirs in everything:
        named = [o for o in theirs if rival in (o["contender"], "best of them")]
        each = [r for r in (_ratio(ours, o, key) for o in named) if r is not None]
        if each:
            found.append(max(each))
    return found


def geometric_mean(values: list[float]) -> float:
    """Return the geometric mean of positive values.

    Examples
    --------
    >>> round(geometric_mean([0.5, 2.0]), 12)
    1.0
    """
    return math.exp(sum(math.log(value) for value in values) / len(values))


def _ratio(ours: dict[str, Any], theirs: dict[str, Any], key: str) -> float | None:
    """Return ours by theirs; None where either made no mesh or theirs is zero."""
    if ours is theirs or ours["measures"] is None or theirs["measures"] is None:
        return None
    ours_value, their_value = (
        float(o["measures"][key] if key in o["measures"] else o["usage"][key])
        for o in (ours, theirs)
    )
    return ours_value / their_value if ours_value > 0.0 < their_value else None
