"""Fewer triangles for a mesh that may be larger than memory.

::

    blocks ──> runs of a million faces, each simplified with its rim fixed ──> the whole, again
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import ceil

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import IntArray
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream, make_array
from hpcapp.simplification.mesh import simplify_mesh
from hpcapp.simplification.parts import collapse, join_parts
from hpcapp.simplification.target import Target

RUN_FACES = 1 << 20
"""Faces of a run, which takes some 500 MB."""
_RUNS_KEEP = 3
"""As many times the faces that are asked for stay after the runs."""


def simplify_stream(mesh: Mesh | MeshStream, target: Target, run_faces: int = RUN_FACES) -> Mesh:
    """Simplify a mesh that may be larger than memory, as `simplify_mesh` does.

    What its vertices carry is left out. Three times as many faces as the result has must fit in
    memory. It depends on the order of vertices and faces, and on nothing else: not on blocks, tiles
    or memory.

    Runs of a million faces come first, each within half of the tolerance. The vertices on the rim
    of a run stay as they are, so that runs fit together; the pass over the whole simplifies these,
    too.
    """
    target.check()
    stream = as_stream(mesh)
    goal = 0 if target.faces is None else _RUNS_KEEP * target.faces
    if stream.face_count <= max(run_faces, goal):
        vertices = np.concatenate([np.empty((0, 3)), *(b.positions for b in stream.vertices())])
        faces = np.concatenate([np.empty((0, 3), np.int64), *stream.faces()])
        return simplify_mesh(Mesh(vertices, faces, stream.origin), target)
    if target.tolerance is not None:
        target = replace(target, tolerance=target.tolerance / 2)
    joined = _simplify_runs(stream, target, goal / stream.face_count, run_faces)
    return simplify_mesh(joined, target)


def _simplify_runs(stream: MeshStream, target: Target, share: float, run_faces: int) -> Mesh:
    """Simplify run after run, and join them at the vertices that stayed."""
    places = make_array((stream.vertex_count, 3))
    start = 0
    for block in stream.vertices():
        places[start : start + len(block)] = block.positions
        start += len(block)
    parts: list[Mesh] = []
    names: list[IntArray] = []
    for run in _cut_runs(stream.faces(), run_faces):
        used, rows = np.unique(run, return_inverse=True)
        run_target = target
        if target.faces is not None:
            run_target = replace(target, faces=max(4, ceil(share * len(run))))
        part = Mesh(np.asarray(places[used]), rows.reshape(-1, 3), stream.origin)
        light, kept = collapse(part, run_target, keeps_border=True)
        parts.append(light)
        names.append(np.where(kept >= 0, used[kept], -1))
    return join_parts(parts, names)[0]


def _cut_runs(blocks: Iterator[IntArray], run_faces: int) -> Iterator[IntArray]:
    """Cut faces that come in blocks of any size into runs of one size; the last may be shorter."""
    waiting: list[IntArray] = []
    count = 0
    for block in blocks:
        while count + len(block) >= run_faces:
            head, block = block[: run_faces - count], block[run_faces - count :]
            yield np.concatenate([*waiting, head])
            waiting, count = [], 0
        waiting.append(block)
        count += len(block)
    if count:
        yield np.concatenate(waiting)
