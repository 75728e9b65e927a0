"""COPC files, which no library writes."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import lazrs
import numpy as np

from hpcapp.geometry.points import ByteArray, FloatArray

SCALE = 0.01
_HEAD, _INFO, _LONG = 375, 160, 60
_POINT = np.dtype(
    {
        "names": ["xyz", "class"],
        "formats": [("<i4", 3), "u1"],
        "offsets": [0, 16],
        "itemsize": 30,
    }
)


def write_copc(path: Path, positions: FloatArray, classes: ByteArray, depth: int = 3) -> None:
    """Write points into an octree of so many levels, of which each has four times as many points.

    Its first page has all nodes but those of the last level, of which each is in a page alone.
    """
    low, high = positions.min(axis=0), positions.max(axis=0)
    half = float((high - low).max()) / 2 + SCALE
    corner = (low + high) / 2 - half
    random = np.random.default_rng(0)
    shares = 4.0 ** np.arange(depth)
    levels = random.choice(depth, len(positions), p=shares / shares.sum())
    cells = ((positions - corner) / (2 * half) * 2.0 ** levels[:, None]).astype(np.int64)
    names = np.concatenate([levels[:, None], cells], axis=1)
    nodes, which = np.unique(names, axis=0, return_inverse=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    counts = np.bincount(which.reshape(-1))

    points = np.zeros(len(positions), _POINT)
    points["xyz"] = np.rint(positions[order] / SCALE)
    points["class"] = classes[order]
    record = lazrs.LazVlr.new_for_compression(6, 0, True)
    body = io.BytesIO()
    start = _HEAD + 54 + _INFO + 54 + len(record.record_data())
    body.write(bytes(start))
    compressor = lazrs.LasZipCompressor(body, record)
    compressor.reserve_offset_to_chunk_table()
    places: list[tuple[int, int, int]] = []
    at = 0
    for count in counts.tolist():
        before = body.tell() if places else start + 8
        compressor.compress_many(points[at : at + count].tobytes())
        compressor.finish_current_chunk()
        places.append((before, body.tell() - before, count))
        at += count
    compressor.done()
    laz = bytearray(body.getvalue())

    entry = struct.Struct("<4iQii")
    inner = [entry.pack(*node, *place) for node, place in zip(nodes.tolist(), places, strict=True)
             if node[0] + 1 < depth]  # fmt: skip
    leaves = [entry.pack(*node, *place) for node, place in zip(nodes.tolist(), places, strict=True)
              if node[0] + 1 == depth]  # fmt: skip
    first = len(laz) + _LONG
    size = (len(inner) + len(leaves)) * entry.size
    links = [
        entry.pack(*entry.unpack(leaf)[:4], first + size + i * entry.size, entry.size, -1)
        for i, leaf in enumerate(leaves)
    ]
    pages = b"".join([*inner, *links, *leaves])
    laz += struct.pack("<2x16sHQ32x", b"copc", 1000, len(pages)) + pages

    steps = np.rint(positions / SCALE) * SCALE
    ends = np.stack([steps.max(axis=0), steps.min(axis=0)], axis=1).ravel()
    head = struct.pack(
        "<4s20x2B68xHIIBHI5I12d", b"LASF", 1, 4, _HEAD, start, 2, 6 | 0x80, 30, 0, *[0] * 5,
        *[SCALE] * 3, *[0.0] * 3, *ends,
    )  # fmt: skip
    head += bytes(8) + struct.pack("<QIQ", first - _LONG, 1, len(points)) + bytes(15 * 8)
    info = struct.pack("<5dQQ", *(corner + half), half, 1.0, first, size).ljust(_INFO, b"\0")
    vlrs = struct.pack("<2x16sHH32x", b"copc", 1, _INFO) + info
    vlrs += struct.pack("<2x16sHH32x", b"laszip encoded", 22204, len(record.record_data()))
    laz[:start] = head + vlrs + record.record_data()
    path.write_bytes(laz)
