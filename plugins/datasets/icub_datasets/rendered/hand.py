"""A hand and forearm of simple solids that holds an object, so that held objects are hidden in part, as in HO-3D."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import matrix_to_quat_wxyz
from icub_core.scene import Geom, Material, ObjectSpec, QuatWxyz, Vec3

WIDEST_GRIP = 0.11
"""Between thumb and fingers, meters."""
FINGER_RADIUS, FINGER_REACH = 0.009, 0.07
FINGER_OFFSETS = (-0.030, -0.010, 0.010, 0.030)
THUMB_RADIUS, THUMB_REACH = 0.011, 0.05
PALM_HALF = (0.036, 0.014, 0.042)
"""Along the closing direction, the arm, and across the fingers."""
FOREARM_RADIUS, FOREARM_LENGTH = 0.030, 0.28


@dataclass(frozen=True)
class Grip:
    """How the object is held, in its own frame.

    Attributes:
        closing: Axis (0, 1, 2) between thumb and fingers.
        arm: Axis along which the forearm leaves; not `closing`.
        side: +1 or -1: to which end of that axis.
    """

    closing: int
    arm: int
    side: int

    @property
    def arm_direction(self) -> NDArray[np.float64]:
        """Unit vector (3,) from the object to the forearm, object frame."""
        return self.side * np.eye(3)[self.arm]


def grips_of(half_extents: Vec3) -> tuple[Grip, ...]:
    """Return every grip whose width a hand can span; those across the narrowest side when none is."""
    narrow = [axis for axis in range(3) if 2 * half_extents[axis] <= WIDEST_GRIP]
    closing = narrow or [int(np.argmin(half_extents))]
    return tuple(Grip(c, a, s) for c in closing for a in range(3) if a != c for s in (1, -1))


def hand_around(half_extents: Vec3, grip: Grip, name: str, skin: tuple[float, float, float]) -> ObjectSpec:
    """Build the hand that holds an object by `grip`; its frame is the object's."""
    half = np.asarray(half_extents)
    across = 3 - grip.closing - grip.arm
    wrist = half[grip.arm] + 0.02  # where the palm is, on the arm's axis

    def point(closing: float, arm: float, crosswise: float) -> NDArray[np.float64]:
        position = np.zeros(3)
        position[grip.closing], position[grip.arm], position[across] = closing, grip.side * arm, crosswise
        return position

    palm = np.zeros(3)
    palm[[grip.closing, grip.arm, across]] = PALM_HALF
    pieces = [Geom("box", _vec3(palm), _vec3(point(0.0, wrist, 0.0)))]
    grasp = float(half[grip.closing])
    for offset in FINGER_OFFSETS:
        knuckle = point(grasp + FINGER_RADIUS, wrist, offset)
        pieces.append(_capsule(point(0.0, wrist, offset), knuckle, FINGER_RADIUS))
        pieces.append(_capsule(knuckle, point(grasp + FINGER_RADIUS, wrist - FINGER_REACH, offset), FINGER_RADIUS))
    knuckle = point(-grasp - THUMB_RADIUS, wrist, FINGER_OFFSETS[2])
    pieces.append(_capsule(point(0.0, wrist, FINGER_OFFSETS[2]), knuckle, THUMB_RADIUS))
    tip = point(-grasp - THUMB_RADIUS, wrist - THUMB_REACH, FINGER_OFFSETS[2])
    pieces.append(_capsule(knuckle, tip, THUMB_RADIUS))
    pieces.append(_capsule(point(0.0, wrist + 0.01, 0.0), point(0.0, wrist + FOREARM_LENGTH, 0.0), FOREARM_RADIUS))
    reach = float(half.max()) + FOREARM_LENGTH
    return ObjectSpec(
        name=name,
        collision=tuple(pieces),
        mass=1.0,
        half_extents=(reach, reach, reach),
        rest_height=reach,
        material=Material(rgba=(*skin, 1.0)),
    )


def _capsule(start: NDArray[np.float64], end: NDArray[np.float64], radius: float) -> Geom:
    """Return a capsule between two points."""
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    quat = matrix_to_quat_wxyz(np.stack([np.cross(y, z), y, z], axis=1))
    w, i, j, k = (float(v) for v in quat)
    quat_wxyz: QuatWxyz = (w, i, j, k)
    return Geom("capsule", (radius, length / 2), _vec3((start + end) / 2), quat_wxyz)


def _vec3(v: NDArray[np.float64]) -> Vec3:
    return float(v[0]), float(v[1]), float(v[2])
