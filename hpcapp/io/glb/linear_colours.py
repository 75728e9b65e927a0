"""Colours of vertices in glTF: shares of light, where points and pictures have sRGB.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#meshes-overview, IEC 61966-2-1
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import ByteArray, FloatArray

_LINEAR, _SLOPE = 0.04045, 12.92  # of sRGB: below, it is proportional to light
_OFFSET, _POWER = 0.055, 2.4

_SHARES = np.arange(256) / 255.0
_LIGHT = np.where(
    _SHARES <= _LINEAR, _SHARES / _SLOPE, ((_SHARES + _OFFSET) / (1.0 + _OFFSET)) ** _POWER
)
_CODES = np.rint(65535.0 * _LIGHT).astype(np.uint16)


def to_light(colours: ByteArray) -> NDArray[np.uint16]:
    """Return sRGB bytes as light, 0 to 65535.

    Examples
    --------
    >>> to_light(np.array([0, 1, 128, 255], np.uint8)).tolist()
    [0, 20, 14146, 65535]
    """
    light: NDArray[np.uint16] = _CODES[colours]
    return light


def to_bytes(light: FloatArray) -> ByteArray:
    """Return light, 0 to 1, as sRGB bytes: the nearest ones.

    Examples
    --------
    >>> to_bytes(np.array([0, 20, 14146, 65535]) / 65535).tolist()
    [0, 1, 128, 255]
    """
    within = np.clip(light, 0.0, 1.0)
    shares = np.where(
        within <= _LINEAR / _SLOPE,
        _SLOPE * within,
        (1.0 + _OFFSET) * within ** (1.0 / _POWER) - _OFFSET,
    )
    return np.rint(255.0 * shares).astype(np.uint8)
