"""Sphere tracing through a coarse grid of distance bounds: where rays change sides of a surface.

::

    shape -> values at the middles of a grid's cells ---.
                                                        v
    rays -> clipped to the bounding box -> steps: the bound where it is large, else the function
                                                        |
                                       sign changes, each between two places on its ray
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpccomponent.dataclass import dataclass

_SHORTEST_STEP = 5e-4  # of the diagonal: two crossings closer than this may be overlooked
_TOLERANCE = 1e-13  # of the diagonal
_MOST_STEPS = 100_000
_MARGIN = 1e-3  # of the diagonal: between the surface and the box that rays are clipped to
_MOST_CELLS = 1 << 18
_RAYS_PER_CELL = 4  # a grid that costs less than the rays it serves
_WORTH = 0.25  # of a cell's edge: a smaller bound is not worth a step
_AT_ONCE = 1 << 14  # rays in flight: what a step makes of them fits into a core's cache
_EAGERNESS = 0.9  # how far a step trusts that the function goes on as it came; 0 not at all
_LONGEST = 3.0  # times the safe step


@dataclass(frozen=True, slots=True, eq=False)
class _Brackets:
    """Sign changes along rays: between which distances, and the function (or a bound) there."""

    rays: IntArray
    near: FloatArray
    far: FloatArray
    at_near: FloatArray
    at_far: FloatArray


@dataclass(slots=True, eq=False)
class _Flight:
    """Rays on their way: each stands at `place`, `step` behind which its last value was `last`."""

    ray: IntArray
    place: FloatArray
    step: FloatArray
    last: FloatArray

    def keep(self, rows: BoolArray) -> None:
        for field in fields(self):
            setattr(self, field.name, getattr(self, field.name)[rows])

    def join(self, ray: IntArray, place: FloatArray) -> None:
        none = np.zeros(len(ray))
        new = _Flight(ray, place, none, none)
        for field in fields(self):
            pair = getattr(self, field.name), getattr(new, field.name)
            setattr(self, field.name, np.concatenate(pair))


class Tracer:
    """Finds where about so many rays cross a shape: a finer grid costs more and saves more.

    The function changes no faster than the distance. A cell's value, less a point's distance from
    the cell's middle, therefore bounds the function there: away from the surface rays need not ask
    for it. A step may go farther than is safe if the function is expected to grow (enhanced sphere
    tracing, Balint and Valasek 2018): it is taken back if the balls about its two ends, which hold
    no surface, leave more than the shortest step between them.
    """

    def __init__(self, shape: Solid, rays: int) -> None:
        self._shape = shape
        self._shortest = _SHORTEST_STEP * diagonal_of(shape)
        low, high = shape.bounds
        margin = _MARGIN * diagonal_of(shape)
        self._low, self._high = low - margin, high + margin
        size = self._high - self._low
        cell_count = min(max(rays // _RAYS_PER_CELL, 1), _MOST_CELLS)
        self._edge = float(np.cbrt(size.prod() / cell_count))
        self._cells = np.maximum(np.ceil(size / self._edge), 1.0).astype(np.int64)
        # (c, 3): the middle of every cell, and the function there, (c,)
        axes = [(np.arange(count) + 0.5) * self._edge for count in self._cells]
        middles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + self._low
        parts = np.array_split(middles, len(middles) // _AT_ONCE + 1)
        self._values = np.concatenate([shape.value(part) for part in parts]).astype(np.float32)

    def cross(
        self, origins: FloatArray, directions: FloatArray, reach: float, first_only: bool
    ) -> tuple[IntArray, FloatArray]:
        """Return where rays cross the surface, as `rays.cross_rays` does."""
        brackets = self._bracket(origins, directions, reach, first_only)
        order = np.lexsort((brackets.near, brackets.rays))
        rays, distances = brackets.rays[order], np.empty(len(order))
        for start in range(0, len(order), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            rows, which = order[part], rays[part]
            distances[part] = self._polish(
                origins[which],
                directions[which],
                *(getattr(brackets, f.name)[rows] for f in fields(brackets)[1:]),
            )
        return rays, distances

    def _bracket(
        self, origins: FloatArray, directions: FloatArray, reach: float, first_only: bool
    ) -> _Brackets:
        """March along the rays and note between which places they change sides."""
        begin, end = self._clip(origins, directions, reach)
        waiting = np.flatnonzero(begin < end)
        flight = _Flight(waiting[:0], begin[:0], begin[:0], begin[:0])
        brackets: list[tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]] = []
        for _ in range(_MOST_STEPS):
            if len(waiting) and len(flight.ray) < _AT_ONCE // 2:
                # rays that wait take the places of those that have ended
                new, waiting = np.split(waiting, [_AT_ONCE - len(flight.ray)])
                flight.join(new, begin[new])
            if not len(flight.ray):
                break
            # (f,) each: the rays in flight, how far along they are, the last step and its value
            ray, place, step, last = flight.ray, flight.place, flight.step, flight.last
            # (f,): the function, or a bound of it, where they are now
            value = self._evaluate(
                origins.take(ray, axis=0) + place[:, None] * directions.take(ray, axis=0)
            )
            before, now = np.abs(last), np.abs(value)
            # (f,): whether the balls about both ends leave a gap in which the surface may hide
            is_too_far = step - before - now > self._shortest
            # (f,): whether the function has changed sign within the step
            crosses = ((value < 0.0) != (last < 0.0)) & ~is_too_far
            crossing = np.flatnonzero(crosses)
            at = place[crossing]
            brackets.append(
                (ray[crossing], at - step[crossing], at, last[crossing], value[crossing])
            )
            # (f,): whether a ray has ended; not where its step is taken back
            stops = place >= end[ray]
            if first_only:
                stops |= crosses
            stops &= ~is_too_far
            # (f,): the next step: the eager one from here, or the safe one from where it came
            onward = self._choose(now, before, step, crosses)
            safe = np.maximum(before, self._shortest)
            start = np.where(is_too_far, place - step, place)
            flight.place = np.minimum(start + np.where(is_too_far, safe, onward), end[ray])
            flight.step = flight.place - start
            flight.last = np.where(is_too_far, last, value)
            flight.keep(~stops)
        nothing = (waiting[:0], *[begin[:0]] * 4)
        return _Brackets(
            *(np.concatenate(column) for column in zip(nothing, *brackets, strict=True))
        )

    def _choose(
        self, now: FloatArray, before: FloatArray, step: FloatArray, crosses: BoolArray
    ) -> FloatArray:
        """Return how far to go: to where the next ball will just touch this one, if all goes on."""
        slope = np.where(crosses, 0.0, (before - now) / np.maximum(step, self._shortest))
        slope = np.clip(slope, -0.9, 1.0)
        factor = np.minimum(1.0 + _EAGERNESS * (1.0 - slope) / (1.0 + slope), _LONGEST)
        onward: FloatArray = np.maximum(now * factor, self._shortest)
        return onward

    def _evaluate(self, points: FloatArray) -> FloatArray:
        """Return the function, or a bound of it that is far from zero."""
        # (n, 3): in cells, then about the middle of the point's own; (n,): how far from there
        local = (points - self._low) / self._edge
        cell = np.minimum(local.astype(np.int64), self._cells - 1)
        cell = np.maximum(cell, 0, out=cell)
        local -= cell
        local -= 0.5
        away = self._edge * np.sqrt(np.einsum("ij,ij->i", local, local))
        # (n,): the point's cell, and the function at its middle
        number = (cell[:, 0] * self._cells[1] + cell[:, 1]) * self._cells[2] + cell[:, 2]
        middle = self._values[number].astype(np.float64)
        # float32 rounds by less than a ten-millionth.
        bound = np.abs(middle) * (1.0 - 1e-6) - away * (1.0 + 1e-12)
        # (n,): the bound with its sign; near the surface the function itself
        close = np.flatnonzero(bound < _WORTH * self._edge)
        value: FloatArray = np.where(middle < 0.0, -bound, bound)
        value[close] = self._shape.value(points.take(close, axis=0))
        return value

    def _clip(
        self, origins: FloatArray, directions: FloatArray, reach: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return where each ray enters the box and where it leaves it: no later where it misses."""
        with np.errstate(divide="ignore"):
            inverse = 1.0 / directions
        with np.errstate(invalid="ignore"):
            first = (self._low - origins) * inverse
            second = (self._high - origins) * inverse
        # A ray along a face makes 0 * inf there, which fmin and fmax pass over.
        # (n,): behind the last plane entered, before the first one left
        begin = np.fmax(np.fmin(first, second).max(axis=1, initial=0.0), 0.0)
        end = np.fmin(np.fmax(first, second).min(axis=1, initial=np.inf), reach)
        return begin, end

    def _polish(
        self,
        origins: FloatArray,
        directions: FloatArray,
        left: FloatArray,
        right: FloatArray,
        at_left: FloatArray,
        at_right: FloatArray,
    ) -> FloatArray:
        """Close in on the sign change between `left` and `right` along each ray."""
        tolerance = _TOLERANCE * diagonal_of(self._shape)
        root = 0.5 * (left + right)
        active = np.arange(len(root))
        for turn in range(80):
            if not len(active):
                break
            # (k,) each: both ends of the brackets that are still open, and the function there
            a, b, fa, fb = left[active], right[active], at_left[active], at_right[active]
            # Every fourth step halves: a kink of the field cannot stall the search.
            t = 0.5 * (a + b) if turn % 4 == 3 else (a * fb - b * fa) / (fb - fa)
            value = self._shape.value(origins[active] + t[:, None] * directions[active])
            keeps_right = (value < 0.0) != (fb < 0.0)
            # Illinois: an end that stays for a second time counts half.
            left[active] = np.where(keeps_right, b, a)
            at_left[active] = np.where(keeps_right, fb, 0.5 * fa)
            right[active], at_right[active], root[active] = t, value, t
            done = np.abs(value) <= tolerance
            done |= np.abs(right[active] - left[active]) <= tolerance
            active = active[~done]
        return root
