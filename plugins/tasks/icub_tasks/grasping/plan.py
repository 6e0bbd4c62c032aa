"""From what the camera sees to a hand pose in front of the object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Grasp, RgbdFrame
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.robot_description import HandDescription
from icub_core.scene import Table

FloatArray = NDArray[np.float64]
MaskProvider = Callable[[RgbdFrame, str], "NDArray[np.bool_] | None"]
"""Finds the named object in an image: (H, W) bool, or None when it is not seen."""

FAR = 0.10
NEAR = 0.05
"""Meters before the grasp pose, on the line from object center to hand (thesis 12.3.1)."""
LIFT = 0.11
"""Meters above the grasp that the hand must also reach, or the task could not be completed."""


class PlanFailure(Enum):
    """Why an object pose has no plan; the object is then placed anew, as in the thesis."""

    NOT_SEEN = "the camera does not see the object"
    NO_GRASP = "the grasp generator proposes nothing"
    UNREACHABLE = "inverse kinematics reaches no proposed grasp both 10 cm before it and lifted"


@dataclass(frozen=True, eq=False)
class GraspPlan:
    """A grasp and the way to it.

    Attributes:
        object_name: What is grasped.
        grasp: The generator's choice.
        T_far, T_near: (4, 4) hand poses 10 cm and 5 cm before the grasp.
        q_far: (n,) joints that put the hand at `T_far`.
    """

    object_name: str
    grasp: Grasp
    T_far: FloatArray
    T_near: FloatArray
    q_far: FloatArray


def plan_grasp(
    frame: RgbdFrame,
    mask: NDArray[np.bool_] | None,
    object_name: str,
    generator: GraspGenerator,
    robot: Robot,
    q_start: FloatArray,
    *,
    table: Table | None,
    hand: HandDescription,
) -> GraspPlan | PlanFailure:
    """Plan from one image: masked cloud, proposals, the first that inverse kinematics reaches.

    Generators promise the grasp and its pre-grasp poses; the lifted pose is the task's affair and is tested here.
    """
    if mask is None or not mask.any():
        return PlanFailure.NOT_SEEN
    proposals = generator.propose(frame.to_cloud(mask), robot, table, hand.name)
    if not proposals:
        return PlanFailure.NO_GRASP
    for grasp in proposals.grasps:
        T_far, T_near = grasp.backed_off(FAR), grasp.backed_off(NEAR)
        solution = robot.inverse_kinematics(T_far, q_start, hand.frame, group=hand.reach)
        if not solution.reached:
            continue
        T_lifted = grasp.T_world_hand.copy()
        T_lifted[2, 3] += LIFT
        if robot.inverse_kinematics(T_lifted, solution.q, hand.frame, group=hand.reach).reached:
            return GraspPlan(object_name, grasp, T_far, T_near, solution.q)
    return PlanFailure.UNREACHABLE
