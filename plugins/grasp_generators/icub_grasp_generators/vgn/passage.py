"""Whether the open hand gets to a grasp without meeting what is seen: from home, and straight on from 10 cm before."""

from __future__ import annotations

import functools

import numpy as np

from icub_core.data import Grasp
from icub_core.geometry import FloatArray
from icub_core.interfaces.robot import Robot
from icub_grasp_generators.clouds import MAX_TOUCHED, thin
from icub_grasp_generators.hand_geometry import HandGeometry, Occupancy, Spheres

_FAR, _NEAR, _AT_LAST = (0.10,), (0.085, 0.07, 0.055, 0.04), (0.025, 0.01)
"""Meters before the grasp; at last the fingers are beside the object, and need no margin."""
_SHARES = np.linspace(0.1, 1.0, 20)
"""Of the way of the joints from home to the first of the poses before the grasp."""
_MARGIN = 0.005
"""Meters that the hand keeps from the object until then."""
_POINTS = 1500
"""Fingers are thin: many points are needed not to miss one."""


def passes(grasp: Grasp, points: FloatArray, robot: Robot, geometry: HandGeometry) -> bool:
    """Return True if the hand keeps out of points (N, 3), on the way that the task takes."""
    home = robot.description.home_q
    solution = robot.inverse_kinematics(grasp.backed_off(*_FAR), home, geometry.frame, group=geometry.reach)
    way = [robot.forward_kinematics(home + share * (solution.q - home), geometry.frame) for share in _SHARES]
    way += [grasp.backed_off(distance) for distance in _NEAR]
    last = [grasp.backed_off(distance) for distance in _AT_LAST]
    points = thin(points, _POINTS)
    touched = _padded(geometry).count(np.stack(way), points).max()
    touched = max(touched, geometry.occupancy.count(np.stack(last), points).max())
    return bool(touched <= MAX_TOUCHED)


@functools.lru_cache(maxsize=4)
def _padded(geometry: HandGeometry) -> Occupancy:
    return Occupancy(Spheres(geometry.hand.centers, geometry.hand.radii + _MARGIN))
