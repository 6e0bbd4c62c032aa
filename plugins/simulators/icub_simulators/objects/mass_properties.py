"""Center of mass and inertia of an object made of pieces at one density, for engines that do not work them out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import matrix_to_quat_wxyz, quat_wxyz_to_matrix
from icub_core.scene import Geom, ObjectSpec, QuatWxyz

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Where an object's mass is.

    Attributes:
        center: (3,) center of mass in the object's frame, meters.
        quat_wxyz: Principal axes in the object's frame.
        inertia: (3,) principal moments, kg m^2.
    """

    center: FloatArray
    quat_wxyz: QuatWxyz
    inertia: FloatArray


def mass_properties(spec: ObjectSpec) -> MassProperties:
    """Add up the collision pieces; overlapping ones count twice."""
    pieces = [_piece(piece) for piece in spec.collision]
    volumes = np.array([volume for volume, _, _ in pieces])
    centers = np.array([center for _, center, _ in pieces])
    density = spec.mass / volumes.sum()
    center = volumes @ centers / volumes.sum()
    inertia = np.zeros((3, 3))
    for volume, middle, about_middle in pieces:
        offset = middle - center
        inertia += density * (about_middle + volume * (offset @ offset * np.eye(3) - np.outer(offset, offset)))
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    w, x, y, z = (float(v) for v in matrix_to_quat_wxyz(axes))
    return MassProperties(center, (w, x, y, z), moments)


def _piece(piece: Geom) -> tuple[float, FloatArray, FloatArray]:
    """Volume, center and inertia tensor per density about the center, in the object's axes."""
    R, position = quat_wxyz_to_matrix(piece.quat_wxyz), np.array(piece.position)
    if piece.mesh is not None:
        import trimesh

        mesh = trimesh.load_mesh(piece.mesh).convex_hull
        mesh.apply_scale(piece.mesh_scale)
        mesh.density = 1.0
        return float(mesh.volume), position + R @ mesh.center_mass, R @ mesh.moment_inertia @ R.T
    volume, moments = _primitive(piece)
    return volume, position, R @ np.diag(volume * moments) @ R.T


def _primitive(piece: Geom) -> tuple[float, FloatArray]:
    """Volume and principal moments per mass of a primitive."""
    if piece.shape == "box":
        square = np.square(piece.size)
        return 8 * float(np.prod(piece.size)), (square.sum() - square) / 3
    if piece.shape in ("sphere", "ellipsoid"):
        square = np.square(np.broadcast_to(piece.size, 3))
        return 4 / 3 * np.pi * float(np.sqrt(square.prod())), (square.sum() - square) / 5
    radius, half = piece.size
    cylinder = 2 * np.pi * radius**2 * half
    along, across = radius**2 / 2, radius**2 / 4 + half**2 / 3
    if piece.shape == "cylinder":
        return cylinder, np.array([across, across, along])
    ball = 4 / 3 * np.pi * radius**3  # the two half balls; their own centers lie 3/8 radius off the flat side
    ball_across = 0.4 * radius**2 + half**2 + 0.75 * half * radius
    volume = cylinder + ball
    moments = (
        np.array([across, across, along]) * cylinder + np.array([ball_across, ball_across, 0.4 * radius**2]) * ball
    )
    return volume, moments / volume
