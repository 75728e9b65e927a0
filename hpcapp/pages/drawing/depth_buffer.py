"""What is nearest at each sample of a band of rows: faces and discs, drawn in any order."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray
from hpcapp.pages.drawing.camera import Screen

SAMPLES_PER_BAND = 1_000_000  # bounds the memory: about 100 bytes a sample
_FACES = 100_000  # that are prepared at once
_CANDIDATES = 250_000  # samples that are tested at once
_LEVELS = 2.0**31  # of depth
# Boxes of faces are drawn in classes of these widths and heights, each class as one block.
_SIDES = np.array([1, 2, 3, 4, 6, 8, *(2**k * 3 // 2**odd for k in range(3, 14) for odd in (1, 0))])

IntArray = NDArray[np.int64]


def list_bands(height: int, width: int, step: int) -> Iterator[tuple[int, int]]:
    """Yield first and last row, exclusively, of bands; their rows are multiples of `step`."""
    rows = max(step, SAMPLES_PER_BAND // width // step * step)
    return ((begin, min(height, begin + rows)) for begin in range(0, height, rows))


def find_rows(screen: Screen, faces: IntArray) -> NDArray[np.int16]:
    """Return the first and the last row, exclusively, that a face can cover, shape (f, 2)."""
    rows = np.empty((len(faces), 2), np.int16)
    for begin in range(0, len(faces), _FACES):
        part = slice(begin, begin + _FACES)
        along = screen[:, 1][faces[part]]
        ends = np.stack([along.min(axis=1), along.max(axis=1)], axis=1)
        rows[part] = np.ceil(np.clip(ends - 0.5, -1, 32766))
    return rows


class DepthBuffer:
    """The nearest item of each sample in a band of rows, from the first to before the last one.

    The width is samples of a row; nearness is that of the farthest and of the nearest thing to be
    drawn, in samples.
    """

    def __init__(self, rows: tuple[int, int], width: int, nearness: tuple[float, float]) -> None:
        self.rows = rows
        self.width = width
        self._far = nearness[0]
        self._step = max(nearness[1] - nearness[0], 1e-30) / (_LEVELS - 1.0)
        # The depth in the upper half, the item from 1 in the lower one: the greater is nearer.
        self._keys = np.zeros((rows[1] - rows[0]) * width, np.uint64)

    def draw_faces(self, screen: Screen | FloatArray, faces: IntArray, numbers: IntArray) -> None:
        """Draw the faces (f, 3) of these numbers (n,)."""
        limits = np.array([[0, self.rows[0]], [self.width, self.rows[1]]])
        for begin in range(0, len(numbers), _FACES):
            part = numbers[begin : begin + _FACES]
            # (n, 3, 3): corners; (n, 2): the first column and row of a box, and its sides
            corners = screen[faces[part]].astype(np.float64)
            low = np.clip(np.ceil(corners[:, :, :2].min(axis=1) - 0.5), *limits).astype(np.int64)
            high = np.clip(np.ceil(corners[:, :, :2].max(axis=1) - 0.5), *limits).astype(np.int64)
            is_seen = (high > low).all(axis=1)
            corners, low, part = corners[is_seen], low[is_seen], part[is_seen]
            sides = np.searchsorted(_SIDES, high[is_seen] - low)
            classes = sides[:, 0] * len(_SIDES) + sides[:, 1]
            order = np.argsort(classes, kind="stable")
            cuts = np.flatnonzero(np.diff(classes[order])) + 1
            for group in np.split(order, cuts) if len(order) else ():
                width, height = _SIDES[sides[group[0]]].tolist()
                step = max(1, _CANDIDATES // (width * height))
                for some in (group[at : at + step] for at in range(0, len(group), step)):
                    self._draw_boxes(corners[some], low[some], (width, height), part[some])

    def _draw_boxes(
        self, corners: FloatArray, low: IntArray, sides: tuple[int, int], numbers: IntArray
    ) -> None:
        """Draw faces whose boxes have sides of so many samples at most."""
        x, y = (np.arange(side, dtype=np.float64) for side in sides)
        # (n, 3, 2): corners about the first sample of the box
        arms = corners[:, :, :2] - (low[:, None] + 0.5)
        following = np.roll(arms, -1, axis=1)
        # (n, 3): twice the areas that the sample spans with the edges, and their slopes
        areas = arms[..., 0] * following[..., 1] - arms[..., 1] * following[..., 0]
        slopes = np.stack([arms - following, following - arms], axis=-1)[..., [1, 0], [0, 1]]
        total = areas.sum(axis=1)
        numbers, low = numbers[total != 0.0], low[total != 0.0]
        areas, slopes, z = (values[total != 0.0] for values in (areas, slopes, corners[:, :, 2]))
        total = total[total != 0.0]
        # (n, 3): barycentric weights of the sample, of the corners opposite to the edges
        weights = areas / total[:, None]
        slopes = slopes / total[:, None, None]
        is_inside = np.ones((len(numbers), sides[1], sides[0]), bool)
        for k in range(3):
            along = weights[:, k, None] + slopes[:, k, 0, None] * x
            is_inside &= along[:, None, :] >= -1e-9 - slopes[:, k, 1, None, None] * y[:, None]
        opposite = np.roll(z, 1, axis=1)
        start = (weights * opposite).sum(axis=1)
        rise = (slopes * opposite[..., None]).sum(axis=1)
        item, row, column = np.nonzero(is_inside)
        depth = start[item] + rise[item, 0] * column + rise[item, 1] * row
        self._enter(low[item, 0] + column, low[item, 1] + row, depth, numbers[item])

    def draw_discs(self, screen: Screen, numbers: IntArray, radius: float) -> None:
        """Draw items as discs whose middle is nearest, so that they part half-way.

        Numbers are rows of `screen`; a radius is in samples, below 0.75 one sample is drawn.
        """
        reach = int(radius) if radius >= 0.75 else 0
        around = np.arange(-reach, reach + 1)
        down, across = (axis.ravel() for axis in np.meshgrid(around, around, indexing="ij"))
        is_disc = down**2 + across**2 <= max(radius, 0.75) ** 2
        down, across = down[is_disc], across[is_disc]
        bulge = 0.4 * (down**2 + across**2) / max(radius, 1.0)
        step = max(1, _CANDIDATES // len(down))
        for begin in range(0, len(numbers), step):
            part = numbers[begin : begin + step]
            column, row = (np.floor(screen[part, k]).astype(np.int64) for k in range(2))
            depth = screen[part, 2, None] - bulge
            shape = depth.shape
            self._enter(
                (column[:, None] + across).ravel(),
                (row[:, None] + down).ravel(),
                depth.ravel(),
                np.broadcast_to(part[:, None], shape).ravel(),
            )

    def _enter(self, column: IntArray, row: IntArray, depth: FloatArray, item: IntArray) -> None:
        """Enter those samples that lie in the band and before what was there."""
        is_in = (column >= 0) & (column < self.width) & (row >= self.rows[0]) & (row < self.rows[1])
        if not is_in.all():
            column, row, depth, item = column[is_in], row[is_in], depth[is_in], item[is_in]
        level = np.clip((depth - self._far) / self._step, 0.0, _LEVELS - 1.0).astype(np.uint64)
        place = (row - self.rows[0]) * self.width + column
        np.maximum.at(self._keys, place, (level << np.uint64(32)) | (item + 1).astype(np.uint64))

    def find_items(self) -> tuple[IntArray, IntArray]:
        """Return the samples that are covered, row by row, and the items that cover them."""
        places = np.flatnonzero(self._keys)
        return places, (self._keys[places] & np.uint64(0xFFFFFFFF)).astype(np.int64) - 1

    def nearness(self, step: int) -> NDArray[np.float32]:
        """Return how near the nearest of each `step` x `step` samples is; -inf where nothing is."""
        shape = (self.rows[1] - self.rows[0]) // step, step, self.width // step, step
        nearest = self._keys.reshape(shape).max(axis=(1, 3))
        levels = (nearest >> np.uint64(32)).astype(np.float32)
        values: NDArray[np.float32] = np.where(
            nearest > 0, self._far + levels * self._step, -np.inf
        ).astype(np.float32)
        return values
