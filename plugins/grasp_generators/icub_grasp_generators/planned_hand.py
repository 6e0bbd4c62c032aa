"""A hand as planners see it: in the axes of its grip; the left one of a pair is the right one of a mirrored world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from icub_core.data import PointCloud
from icub_core.errors import ConfigError
from icub_core.geometry import FloatArray, make_transform
from icub_core.robot_description import Grip, HandDescription, RobotDescription
from icub_core.scene import Table

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
"""Reflection at the robot's plane of symmetry, as a transform."""
_MIRROR = MIRROR[:3, :3]


@dataclass(frozen=True, eq=False)
class PlannedHand:
    """One hand in the planning frame, whose origin is the hand frame's and whose axes are the grip's.

    A mirrored hand is planned for in the mirror image of the world, in which it is a right hand: everything here is
    of that image. `mirrored` takes the world there, `to_hand` comes back.

    Attributes:
        name: Of the hand.
        is_mirrored: Whether planning happens in the mirror image.
        palm: (3,) origin of the grip frame, meters.
        width: Widest object that fits between the fingers, meters.
        fingers: (k, 2) y and z at which the fingers close, meters.
        sweep: (3, 2) lowest and highest x, y, z that the closing fingers pass through, meters.
        half_axes: (3,) of the ellipsoid inside the closing hand, meters.
        yaws: Lowest and highest angle of the x axis about the vertical, rad.
        T_jaw: (4, 4) pose of the parallel jaw that the hand can stand in for.
        R_hand: (3, 3) from the planning frame to the hand frame's axes.
    """

    name: str
    is_mirrored: bool
    palm: FloatArray
    width: float
    fingers: FloatArray
    sweep: FloatArray
    half_axes: FloatArray
    yaws: tuple[float, float]
    T_jaw: FloatArray
    R_hand: FloatArray

    def to_hand(self, T: FloatArray) -> FloatArray:
        """Return the hand frame's poses (C, 4, 4), world, of poses of the planning frame (C, 4, 4)."""
        if not self.is_mirrored:
            return T @ make_transform(self.R_hand)
        return make_image(T) @ make_transform(self.R_hand)

    def from_hand(self, points: FloatArray) -> FloatArray:
        """Return points (N, 3) of the hand frame in the planning frame."""
        local = points @ self.R_hand.T
        return local @ _MIRROR if self.is_mirrored else local

    def cloud(self, cloud: PointCloud) -> PointCloud:
        """Return a cloud as the planning world has it."""
        if not self.is_mirrored:
            return cloud
        viewpoint = None if cloud.viewpoint is None else _MIRROR @ cloud.viewpoint
        return PointCloud(cloud.points @ _MIRROR, viewpoint=viewpoint)

    def table(self, table: Table | None) -> Table | None:
        """Return a table as the planning world has it."""
        if table is None or not self.is_mirrored:
            return table
        return Table((table.center[0], -table.center[1], table.center[2]), table.half_size, table.material)


def make_image(T: FloatArray) -> FloatArray:
    """Mirror rigid poses (..., 4, 4) at the robot's plane of symmetry; x and z axes become their images."""
    return MIRROR @ T @ MIRROR


def planned_hand(description: RobotDescription, name: str | None = None) -> PlannedHand:
    """Look up a hand, the robot's first by default.

    Raises:
        ConfigError: The robot has no such hand, or its description does not say where the hand holds.
    """
    hand: HandDescription = description.hand(name)
    grip: Grip | None = hand.grip
    if grip is None:
        raise ConfigError(
            f"the hand '{hand.name}' of robot '{description.name}' has no grip; planners need to know where it holds"
        )
    R_hand = grip.T_hand_grip[:3, :3].T
    side = np.array([1.0, -1.0 if grip.mirrored else 1.0, 1.0])
    palm = side * (R_hand @ grip.T_hand_grip[:3, 3])
    jaw = make_transform(R_hand) @ (grip.T_hand_grip if grip.T_hand_jaw is None else grip.T_hand_jaw)
    y = side[1] * np.asarray(grip.fingers_y)
    sweep = np.sort(side[:, None] * np.asarray(grip.sweep), axis=1)
    return PlannedHand(
        name=hand.name,
        is_mirrored=grip.mirrored,
        palm=palm,
        width=grip.width,
        fingers=_decimals(np.stack([y + palm[1], np.full(len(y), grip.depth + palm[2])], axis=1)),
        sweep=_decimals(sweep + palm[:, None]),
        half_axes=np.array(grip.half_axes),
        yaws=grip.yaws,
        T_jaw=make_image(jaw) if grip.mirrored else jaw,
        R_hand=R_hand,
    )


def _decimals(values: FloatArray) -> FloatArray:
    """Round to a nanometer, which makes the sum of two decimals the decimal that it is on paper."""
    return np.round(values, 9)
