"""Parts of which household things are built: each has convex pieces that collide and a closed surface that is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from icub_simulators.objects.solids import oriented_hull, rotation_taking

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Profile = Sequence[tuple[float, float]]
"""(radius, height) from the bottom upwards."""
Outline = Sequence[tuple[float, float]] | FloatArray
"""(x, y) corners of a convex polygon."""

SIDES = 24
"""Corners of a circle."""
SECTORS = 8
"""Convex pieces around a hollow wall."""
FLAT = 1e-9


@dataclass(frozen=True, eq=False)
class Part:
    """A solid.

    Attributes:
        pieces: (N_i, 3) points whose hulls collide.
        vertices: (V, 3) of the surface.
        faces: (F, 3) triangles of the surface, counterclockwise from outside.
    """

    pieces: tuple[FloatArray, ...]
    vertices: FloatArray
    faces: IntArray

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Part:
        """Return the part at another place."""
        return self._mapped(np.eye(3), np.array([x, y, z]))

    def turned(self, R: FloatArray) -> Part:
        """Return the part turned about the origin by the rotation R (3, 3)."""
        return self._mapped(R, np.zeros(3))

    def stretched(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Part:
        """Return the part stretched along the axes."""
        return self._mapped(np.diag([x, y, z]), np.zeros(3))

    def _mapped(self, A: FloatArray, offset: FloatArray) -> Part:
        return Part(tuple(p @ A.T + offset for p in self.pieces), self.vertices @ A.T + offset, self.faces)


def joined(parts: Sequence[Part]) -> Part:
    """Return several parts as one; their surfaces may enter one another."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return Part(
        tuple(piece for part in parts for piece in part.pieces),
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]),
    )


def hull(points: FloatArray) -> Part:
    """Return the convex hull of (N, 3) points."""
    vertices, faces = oriented_hull(points)
    return Part((vertices,), vertices, faces)


def revolved(profile: Profile, sides: int = SIDES) -> Part:
    """Turn a profile about the z axis into a solid, cut at its waists into convex pieces.

    Args:
        profile: The outline, closed on the axis at both ends.
        sides: Corners around; few give a prism.
    """
    chains: list[list[tuple[float, float]]] = [[profile[0]]]
    for point in profile[1:]:
        if _bends_inwards([*chains[-1], point]):
            chains.append([chains[-1][-1]])
        chains[-1].append(point)
    pieces = tuple(_rings(chain, sides).reshape(-1, 3) for chain in chains)
    return Part(pieces, *_lathe([(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])], sides))


def hollow(profile: Profile, thickness: float, sides: int = SIDES) -> Part:
    """Turn a profile about the z axis into a vessel that is open above.

    Args:
        profile: The outer outline, from the rim of the bottom to the edge.
        thickness: Of wall and bottom, meters.
        sides: Corners around, a multiple of `SECTORS`.
    """
    (radius, low), high = profile[0], profile[-1][1]
    floor = low + thickness
    inside = [(max(_radius_at(profile, floor) - thickness, thickness), floor)]
    inside += [(r - thickness, z) for r, z in profile[1:-1] if z > floor + thickness]
    inside += [(profile[-1][0] - thickness, high)]
    pieces = [_rings([(radius, low), (_radius_at(profile, floor), floor)], sides).reshape(-1, 3)]
    across = sides // SECTORS
    heights = [z for _, z in inside]
    for bottom, top in pairwise(heights):
        outer = [(_radius_at(profile, z), z) for z in (bottom, top)]
        inner = [(_radius_at(inside, z), z) for z in (bottom, top)]
        wall = np.concatenate([_rings(outer, sides), _rings(inner, sides)])  # (4, sides, 3)
        for k in range(SECTORS):
            pieces.append(wall[:, np.arange(k * across, (k + 1) * across + 1) % sides].reshape(-1, 3))
    return Part(tuple(pieces), *_lathe([(0.0, low), *profile, *reversed(inside), (0.0, floor)], sides))


def prism(outline: Outline, height: float, top: float = 1.0) -> Part:
    """Raise a convex outline from z = 0 to `height`, where it is `top` times as large."""
    flat = np.asarray(outline, dtype=np.float64)
    low = np.column_stack([flat, np.zeros(len(flat))])
    return hull(np.concatenate([low, np.column_stack([top * flat, np.full(len(flat), height)])]))


def block(x: float, y: float, z: float) -> Part:
    """Return a box that stands on z = 0, its sides in meters."""
    return prism([(x / 2, y / 2), (-x / 2, y / 2), (-x / 2, -y / 2), (x / 2, -y / 2)], z)


def rod(start: Sequence[float], end: Sequence[float], radius: float, end_radius: float | None = None) -> Part:
    """Return a round rod between two points, tapered where its end has another radius."""
    begin, finish = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(finish - begin))
    upright = revolved([(radius, 0.0), (radius if end_radius is None else end_radius, length)], SIDES // 2)
    return upright.turned(rotation_taking(np.array([0.0, 0.0, 1.0]), (finish - begin) / length)).moved(*begin)


def bent(points: Sequence[Sequence[float]], radius: float) -> Part:
    """Return a rod that runs through points."""
    return joined([rod(a, b, radius) for a, b in pairwise(points)])


def _bends_inwards(chain: list[tuple[float, float]]) -> bool:
    """Return True if the last point of a profile makes the solid of revolution concave."""
    if len(chain) < 3:
        return False
    (r0, z0), (r1, z1), (r2, z2) = chain[-3:]
    return (r1 - r0) * (z2 - z1) - (r2 - r1) * (z1 - z0) < -FLAT


def _radius_at(profile: Profile, height: float) -> float:
    radii, heights = zip(*profile, strict=True)
    return float(np.interp(height, heights, radii))


def _rings(profile: Profile, sides: int) -> FloatArray:
    """Return circles of points, (len(profile), sides, 3)."""
    angles = 2 * np.pi * np.arange(sides) / sides
    radii, heights = np.asarray(profile, dtype=np.float64).T
    rings = np.empty((len(profile), sides, 3))
    rings[..., 0] = radii[:, None] * np.cos(angles)
    rings[..., 1] = radii[:, None] * np.sin(angles)
    rings[..., 2] = heights[:, None]
    return rings


def _lathe(profile: Profile, sides: int) -> tuple[FloatArray, IntArray]:
    """Return the surface of a profile that begins and ends on the axis; it runs up outside and down inside."""
    rings = _rings(profile[1:-1], sides)
    poles = np.array([[0.0, 0.0, profile[0][1]], [0.0, 0.0, profile[-1][1]]])
    n = len(rings)
    here = np.arange(sides)
    after = (here + 1) % sides
    bottom, top = n * sides, n * sides + 1
    faces = [np.column_stack([np.full(sides, bottom), after, here])]
    for k in range(n - 1):
        a, b, c, d = (k * sides + here, k * sides + after, (k + 1) * sides + after, (k + 1) * sides + here)
        faces += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    last = (n - 1) * sides
    faces.append(np.column_stack([np.full(sides, top), last + here, last + after]))
    return np.concatenate([rings.reshape(-1, 3), poles]), np.concatenate(faces)
