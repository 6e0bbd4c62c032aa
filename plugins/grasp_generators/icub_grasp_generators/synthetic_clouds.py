"""Clouds of solids whose true size and pose are known, as one camera sees them: for tests and benchmarks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray, rotation_about

KINDS = ("box", "cylinder", "ellipsoid")
TABLE_TOP = 0.95


@dataclass(frozen=True, eq=False)
class View:
    """One solid on a table, seen once.

    Attributes:
        points: (N, 3) cloud, world, meters.
        half: (3,) true half sizes.
        R: (3, 3) true rotation.
        center: (3,) true center.
        visible: (3,) bool: the clean points span nine tenths of this axis or more.
    """

    points: FloatArray
    half: FloatArray
    R: FloatArray
    center: FloatArray
    visible: NDArray[np.bool_]


def surface(kind: str, half: FloatArray, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Spread points (N, 3) over a box, a cylinder (axis z) or an ellipsoid; also return their outward normals."""
    if kind == "box":
        area = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
        face, side = rng.choice(3, count, p=area / area.sum()), rng.choice([-1.0, 1.0], count)
        points, normals = rng.uniform(-1, 1, (count, 3)), np.zeros((count, 3))
        points[np.arange(count), face] = side
        normals[np.arange(count), face] = side
        return points * half, normals
    if kind == "cylinder":
        radius, length = half[0], half[2]
        shares = np.array([4 * length, radius, radius])
        part, angle = rng.choice(3, count, p=shares / shares.sum()), rng.uniform(0, 2 * np.pi, count)
        rho = np.where(part == 0, radius, radius * np.sqrt(rng.uniform(0, 1, count)))
        z = np.where(part == 0, rng.uniform(-length, length, count), np.where(part == 1, length, -length))
        side = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
        cap = np.stack([np.zeros(count), np.zeros(count), np.sign(z)], axis=1)
        points = np.stack([rho * side[:, 0], rho * side[:, 1], z], axis=1)
        return points, np.where((part == 0)[:, None], side, cap)
    unit = rng.normal(size=(6 * count, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    stretch = np.linalg.norm(unit / half, axis=1)  # area element of the ellipsoid over the sphere's
    unit = unit[rng.uniform(0, 1, len(unit)) < stretch / stretch.max()][:count]
    normals = unit / half
    return unit * half, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def single_view(
    kind: str, rng: np.random.Generator, count: int = 500, outliers: float = 0.1, noise: float = 0.001
) -> View:
    """Draw a solid of 4 to 18 cm, turned about the vertical, seen from 0.5 m away and 45 degrees above.

    Args:
        kind: One of `KINDS`.
        rng: Decides everything.
        count: Points.
        outliers: Share of the points that is spread over a box 5 cm larger than the cloud instead.
        noise: Standard deviation of the other points, meters.
    """
    half = rng.uniform(0.02, 0.09, 3)
    if kind == "cylinder":
        half[1] = half[0]
    R = rotation_about("z", rng.uniform(0, 2 * np.pi))
    center = np.array([*rng.uniform(-0.05, 0.05, 2), TABLE_TOP + half[2]])
    local, local_normals = surface(kind, half, rng, 12000)
    points, normals = local @ R.T + center, local_normals @ R.T
    to_camera = center + 0.5 * np.array([np.cos(np.pi / 4), 0.0, np.sin(np.pi / 4)]) - points
    distance = np.linalg.norm(to_camera, axis=1)
    # a pixel's share of the surface: cosine over squared distance
    weight = np.maximum((normals * to_camera).sum(axis=1), 0.0) / distance**3
    chosen = rng.choice(len(points), count, replace=False, p=weight / weight.sum())
    cloud = points[chosen] + noise * rng.normal(size=(count, 3))
    wrong = int(outliers * count)
    cloud[:wrong] = rng.uniform(cloud.min(axis=0) - 0.05, cloud.max(axis=0) + 0.05, (wrong, 3))
    seen = local[chosen[wrong:]]
    return View(cloud, half, R, center, np.ptp(seen, axis=0) > 0.9 * 2 * half)


def matched(half: FloatArray, R_fit: FloatArray, R: FloatArray) -> FloatArray:
    """Sort fitted half axes (3,) with rotation `R_fit` into the order of the true axes `R` that they are nearest to."""
    cosines = np.abs(R.T @ R_fit)
    best = max(permutations(range(3)), key=lambda order: sum(cosines[i, order[i]] for i in range(3)))
    return half[list(best)]
