"""Photographs of painted things, of which every colour is known: a table of things one before
another, a ray-caster, cameras with distortion and exposures of their own.

Rays are cast at the formulas of the things, not at a mesh; pixels are turned into rays by a search.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from camera_files import look_at
from PIL import Image

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray

BALLS = np.array([[0.0, 0.0, 0.62, 0.5], [0.9, 0.25, 0.42, 0.3], [-0.35, -0.85, 0.45, 0.32]])
"""x, y, z and radius: each hides parts of the others, and of the ground."""
GROUND = 2.0  # half the side of the square z = 0
LIGHT = 0.55

HUES = np.array([[0.75, 0.7, 0.6], [1.0, 0.25, 0.2], [0.2, 1.0, 0.3], [0.25, 0.35, 1.0]])


def paint(places: FloatArray, things: IntArray) -> FloatArray:
    """Return the light, 0 to 1, of places on things: each has a hue, and waves of its own."""
    waves = 0.55 + 0.2 * np.sin(9.0 * places).prod(axis=1) + 0.25 * np.sin(31.0 * places[:, 0])
    light: FloatArray = LIGHT * HUES[things] * np.clip(waves, 0.15, 1.0)[:, None]
    return light


def to_srgb(light: FloatArray) -> FloatArray:
    """Return 0 to 255."""
    kept = np.clip(light, 0.0, 1.0)
    values = np.where(kept <= 0.0031308, 12.92 * kept, 1.055 * kept ** (1 / 2.4) - 0.055)
    srgb: FloatArray = 255.0 * values
    return srgb


def tell_things(colours: FloatArray) -> IntArray:
    """Return whose paint colours (n, 3), 0 to 255, are."""
    known = to_srgb(0.3 * HUES)
    shares = [c / np.maximum(c.sum(axis=1, keepdims=True), 1.0) for c in (colours, known)]
    things: IntArray = np.linalg.norm(shares[0][:, None] - shares[1], axis=2).argmin(axis=1)
    return things


def find_things(places: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the places on things nearest to places beside them, and which things these are."""
    arms = places[:, None] - BALLS[:, :3]
    lengths = np.linalg.norm(arms, axis=2)
    far = np.concatenate([np.abs(places[:, 2:]), np.abs(lengths - BALLS[:, 3])], axis=1)
    things = far.argmin(axis=1)
    on = places * (1.0, 1.0, 0.0)
    for number, ball in enumerate(BALLS, start=1):
        own = things == number
        units = arms[own, number - 1] / lengths[own, number - 1, None]
        on[own] = ball[:3] + ball[3] * units
    return on, things


def cast(origins: FloatArray, rays: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return how far rays go, and what they meet: 0 the ground, 1.. a ball, -1 nothing."""
    far, things = np.full(len(rays), np.inf), np.full(len(rays), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        down = -origins[:, 2] / rays[:, 2]
        at = origins + down[:, None] * rays
    on = (down > 1e-6) & (np.abs(at[:, :2]) <= GROUND).all(axis=1)
    far[on], things[on] = down[on], 0
    for number, (*middle, radius) in enumerate(BALLS.tolist(), start=1):
        arms = origins - middle
        along = (arms * rays).sum(axis=1)
        root = along**2 - (arms * arms).sum(axis=1) + radius**2
        near = -along - np.sqrt(np.maximum(root, 0.0))
        meets = (root > 0.0) & (near > 1e-6) & (near < far)
        far[meets], things[meets] = near[meets], number
    return far, things


class Shot:
    """A camera with Brown's distortion, and an exposure."""

    radial = (-0.12, 0.05, -0.01)
    tangential = (0.001, -0.0015)

    def __init__(self, place: FloatArray, size: tuple[int, int], exposure: float) -> None:
        self.place, self.rotation = place, look_at(place[None], np.array([0.1, -0.1, 0.35]))[0]
        self.size, self.focal, self.exposure = size, 1.05 * size[0], exposure

    def _bend(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        k1, k2, k3 = self.radial
        p1, p2 = self.tangential
        r = x * x + y * y
        bend = 1.0 + r * (k1 + r * (k2 + r * k3))
        return (x * bend + 2 * p1 * x * y + p2 * (r + 2 * x * x),
                y * bend + p1 * (r + 2 * y * y) + 2 * p2 * x * y)  # fmt: skip

    def make_rays(self) -> FloatArray:
        """Return the rays of pixels, row by row."""
        width, height = self.size
        across, down = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        u, v = (across.ravel() - width / 2) / self.focal, (down.ravel() - height / 2) / self.focal
        x, y = u.copy(), v.copy()
        for _ in range(30):
            bent = self._bend(x, y)
            x, y = x + 0.8 * (u - bent[0]), y + 0.8 * (v - bent[1])
        rays = np.stack([x, y, np.ones_like(x)], axis=1) @ self.rotation
        units: FloatArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return units

    def expose(self) -> ByteArray:
        """Return the photograph; where nothing is it is black."""
        rays = self.make_rays()
        origins = np.broadcast_to(self.place, rays.shape)
        far, things = cast(origins, rays)
        light = np.zeros((len(rays), 3))
        meets = things >= 0
        light[meets] = paint((origins + np.nan_to_num(far, posinf=0)[:, None] * rays)[meets],
                             things[meets])  # fmt: skip
        colours: ByteArray = np.rint(to_srgb(self.exposure * light)).astype(np.uint8)
        return colours.reshape(self.size[1], self.size[0], 3)


def make_shots(count: int, size: tuple[int, int] = (480, 360), seed: int = 3) -> list[Shot]:
    """Return cameras around the things at two heights, whose exposures differ by up to 1.5."""
    rng = np.random.default_rng(seed)
    turns = 2 * np.pi * (np.arange(count) + 0.1) / count
    heights = np.where(np.arange(count) % 2, 1.2, 2.6)
    reach = np.sqrt(3.4**2 - heights**2)
    places = np.stack([reach * np.cos(turns), reach * np.sin(turns), heights], axis=1)
    logs = rng.uniform(-0.5, 0.5, count)
    exposures = np.exp(np.log(1.5) * (logs - logs.mean()) / np.ptp(logs))
    return [Shot(place, size, gain) for place, gain in zip(places, exposures.tolist(), strict=True)]


def write_shots(folder: Path, shots: Sequence[Shot], suffix: str = "png") -> Path:
    """Write photographs, and beside the folder the transforms.json of nerfstudio."""
    folder.mkdir()
    frames = []
    for number, shot in enumerate(shots):
        Image.fromarray(shot.expose()).save(folder / f"{number:03}.{suffix}", quality=95)
        pose = np.eye(4)
        pose[:3, :3] = shot.rotation.T @ np.diag([1.0, -1.0, -1.0])
        pose[:3, 3] = shot.place
        frames.append({"file_path": f"images/{number:03}.{suffix}",
                       "transform_matrix": pose.tolist()})  # fmt: skip
    one = shots[0]
    (width, height), (k1, k2, k3), (p1, p2) = one.size, one.radial, one.tangential
    told = {"camera_model": "OPENCV", "w": width, "h": height, "fl_x": one.focal,
            "fl_y": one.focal, "cx": width / 2, "cy": height / 2,
            "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2, "frames": frames}  # fmt: skip
    path = folder.parent / "transforms.json"
    path.write_text(json.dumps(told))
    return path


def make_mesh(fine: int = 40) -> tuple[Mesh, IntArray]:
    """Return the things as a mesh with normals, and which thing each vertex is on."""
    side = np.linspace(-GROUND, GROUND, 9)
    flat = np.stack([*np.meshgrid(side, side), np.zeros((9, 9))], axis=-1).reshape(-1, 3)
    grid = np.arange(81).reshape(9, 9)
    a, b, c, d = (g.ravel() for g in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]))
    vertices, faces = [flat], [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    normals, things = [np.tile([0.0, 0.0, 1.0], (81, 1))], [np.zeros(81, int)]
    start = 81
    for number, (*middle, radius) in enumerate(BALLS.tolist(), start=1):
        units, corners = _make_ball(fine)
        vertices.append(units * radius + middle)
        normals.append(units)
        faces.append(corners + start)
        things.append(np.full(len(units), number))
        start += len(units)
    mesh = Mesh(np.concatenate(vertices), np.concatenate(faces), normals=np.concatenate(normals))
    return mesh, np.concatenate(things)


def _make_ball(fine: int) -> tuple[FloatArray, IntArray]:
    """Return a ball of rings between two poles."""
    polar = np.linspace(0.0, np.pi, fine // 2 + 1)[1:-1]
    turn = 2 * np.pi * np.arange(fine) / fine
    p, t = (v.ravel() for v in np.meshgrid(polar, turn, indexing="ij"))
    units = np.stack([np.sin(p) * np.cos(t), np.sin(p) * np.sin(t), np.cos(p)], axis=1)
    units = np.concatenate([units, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    ring = np.arange(len(polar) * fine).reshape(len(polar), fine)
    after = np.roll(ring, -1, axis=1)
    top, bottom = np.full(fine, len(units) - 2), np.full(fine, len(units) - 1)
    faces = [np.stack([top, ring[0], after[0]], 1), np.stack([bottom, after[-1], ring[-1]], 1)]
    for k in range(len(polar) - 1):
        faces += [np.stack([ring[k], ring[k + 1], after[k + 1]], 1),
                  np.stack([ring[k], after[k + 1], after[k]], 1)]  # fmt: skip
    return units, np.concatenate(faces)
