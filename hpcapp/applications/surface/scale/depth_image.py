"""Pixels of a camera at (0, 0, 0), and the steps of their depth.

A camera takes points in rows and columns: from where it was, and from nowhere else, they lie on a
lattice. One that measures disparities knows each to a fraction of a pixel: depth then comes in
layers, even in its reciprocal. Far away they lie farther apart than points, and each would be a
sheet of its own.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray

_PIXELS = 4000  # points whose columns and rows are looked at
_FEWEST = 100
_COLUMNS = 48, 2048  # of an image
_BINS = 8192  # across it
_SHARP = 0.5
"""Strength of the columns of an image, as a Fourier coefficient: of depth images, rounded to whole
millimetres or not, .98 and more; of scattered points .06 at most."""
_IN_SPACE = 0.9
"""By it, that of such columns in space: of a depth image where most is one wall .78, of rasters of
heights 1 to 3.3."""
_WIDEST = 4.0  # width of an image by its distance
MOST = 1 << 20
"""Pixels of a camera whose depth has steps: finer images tell it between them."""
_SHARED = 20  # points that share a depth
_APART = 1e-5  # of the largest: reciprocals of depth that are nearer are one, but for its digits
_EVEN, _MOSTLY = 0.1, 0.9  # how far most layers are from even steps, in these
_QUANTA, _FEWEST_STEPS = 10.0, 8  # least differences of depth in a step that is far; so many tell
SHEETS = 1.5
"""Spacings from layer to layer, from which on they are smoothed. As they are, .006 of the area of a
wavy wall looks away from its camera with 1 spacing, .03 to .07 with 1.5, and .13 with 2."""
_NEIGHBOURS, _DIAGONAL = 9, 1.6  # of a pixel, with itself; how far they are, in pixels
_ROUNDS = 20  # with 60 and 200 the frame of a Kinect agrees with the truth as much: 98.6 %


def has_pixels(positions: FloatArray) -> bool:
    """Tell whether points (n, 3) are the pixels of a camera at (0, 0, 0).

    Along the axis that most points lie at, y / x and z / x lie on a lattice: on columns and rows.
    Where y and z themselves do so as much, points lie on a lattice in space.
    """
    if len(positions) < _FEWEST:
        return False
    some = positions[:: -(-len(positions) // _PIXELS)]
    across, depth = _see(some)
    if depth.min() <= 0.0 <= depth.max():
        return False
    image = across / depth
    if np.ptp(image, axis=0).max() > _WIDEST:
        return False
    return all(map(_are_columns, image.T, across.T))


def _are_columns(image: FloatArray, across: FloatArray) -> bool:
    """Tell whether coordinates are those of columns in an image, and not in space."""
    few, most = _COLUMNS
    strengths = _find_strengths(image)
    # The strongest frequency: so many columns the image has. In space, a lattice with half to twice
    # as many would explain it as well.
    columns = few + int(np.argmax(strengths[few:most]))
    in_space = _find_strengths(across)[columns // 2 : 2 * columns]
    sharp = strengths[columns]
    return bool(sharp > _SHARP and in_space.max() < _IN_SPACE * sharp)


def _find_strengths(places: FloatArray) -> FloatArray:
    """Return how far coordinates take so many even steps from end to end: 0 to 1, by number."""
    width = max(float(np.ptp(places)), np.finfo(np.float64).tiny)
    # (n,): even steps from end to end are a peak in the spectrum of the histogram.
    bins = np.minimum((places - places.min()) / width * _BINS, _BINS - 1.0).astype(np.int64)
    strengths: FloatArray = np.abs(np.fft.rfft(np.bincount(bins, minlength=_BINS))) / len(places)
    return strengths


def find_step(inverse: FloatArray) -> float:
    """Return how far the reciprocals of depths, (n,), are from layer to layer; 0 where none are.

    Where files have whole millimetres, what is near is uneven: the far layers tell, which are many
    of the least difference of depths apart.
    """
    levels, counts = np.unique(inverse, return_counts=True)
    # (l,): those that differ in their last digits are one.
    joined = np.concatenate([[0], np.cumsum(np.diff(levels) > _APART * levels[-1])])
    if joined[-1] < 1 or len(inverse) < _SHARED * (joined[-1] + 1):
        return 0.0
    levels = np.bincount(joined, levels * counts) / np.bincount(joined, counts)
    steps, depths = np.diff(levels), -np.diff(1.0 / levels)
    is_far = depths > _QUANTA * depths.min()
    for some in (steps, steps[is_far]):
        step = float(np.median(some)) if len(some) >= _FEWEST_STEPS else 0.0
        if step and np.mean(np.abs(some / step - np.rint(some / step)) < _EVEN) > _MOSTLY:
            return step
    return 0.0


def smooth_steps(positions: FloatArray) -> tuple[FloatArray, int]:
    """Smooth the depth of an image whose layers are far apart, each point by half a step at most.

    Each reciprocal becomes the mean of those of the pixels around it that are a layer or less away,
    and stays within its own layer, some rounds long. Returned are points (n, 3) on the same rays,
    and how many may have moved: the very array where there is nothing to be smoothed.
    """
    if len(positions) > MOST or not has_pixels(positions):
        return positions, 0
    across, depth = _see(positions)
    measured = 1.0 / np.abs(depth[:, 0])
    step = find_step(measured)
    if not step:
        return positions, 0
    near, pixel = _find_pixels(across / depth)
    is_moved = step > SHEETS * pixel * measured
    if not is_moved.any():
        return positions, 0
    # (n, 9): those beyond a step in the scene are not smoothed over.
    is_same = np.abs(measured[near] - measured[:, None]) < 1.5 * step
    counts = is_same.sum(axis=1)
    half = np.where(is_moved, 0.5 * step, 0.0)
    inverse = measured
    for _ in range(_ROUNDS):
        means = np.einsum("nk,nk->n", inverse[near], is_same) / counts
        inverse = np.clip(means, measured - half, measured + half)
    return positions * (measured / inverse)[:, None], int(np.count_nonzero(is_moved))


def _see(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return coordinates across and along the axis that most points lie at, (n, 2) and (n, 1)."""
    axis = int(np.argmax(np.abs(positions.mean(axis=0))))
    return np.delete(positions, axis, axis=1), positions[:, [axis]]


def _find_pixels(image: FloatArray) -> tuple[IntArray, float]:
    """Return the rows of the pixels around each, or its own, and how far apart they are."""
    from scipy.spatial import cKDTree  # takes its time, and few files are images

    tree = cKDTree(image)
    some = image[:: -(-len(image) // _PIXELS)]
    pixel = float(np.median(tree.query(some, k=2)[0][:, 1]))
    near = tree.query(image, k=_NEIGHBOURS, distance_upper_bound=_DIAGONAL * pixel)[1]
    return np.where(near < len(image), near, np.arange(len(image))[:, None]), pixel
