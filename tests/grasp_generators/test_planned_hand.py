"""What planners know of a hand comes from its description alone: of two jaws, of a left hand, of the iCub's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from icub_core.data import PointCloud
from icub_core.errors import ConfigError
from icub_core.geometry import invert, is_rigid, make_transform, rotation_about
from icub_core.robot_description import Grip
from icub_core.scene import Table
from icub_grasp_generators.planned_hand import planned_hand
from icub_grasp_generators.superquadrics.generator import Superquadrics
from icub_grasp_generators.superquadrics.poses import family
from icub_grasp_generators.superquadrics.shape import Superquadric
from icub_grasp_generators.synthetic_clouds import surface
from icub_grasp_generators.vgn.adaptation import hand_poses
from icub_grasp_generators.vgn.palm import is_learned
from icub_grasp_generators.vgn.selection import Selected
from icub_grasp_generators.vgn.volume import Volume
from icub_testing.tiny.robot import TinyRobot

TABLE = Table()
JAW = Grip(
    T_hand_grip=make_transform(rotation_about("z", np.pi / 2), [0.0, 0.0, 0.07]),
    width=0.07,
    fingers_y=np.array([0.0]),
    depth=0.03,
    sweep=np.array([[-0.04, 0.04], [-0.01, 0.01], [0.0, 0.04]]),
)
"""Two jaws that close along the hand's y axis, 7 cm before the hand's frame."""
CARTON = Superquadric.from_parts(np.array([0.02, 0.06, 0.05]), np.array([0.1, 0.1]), np.eye(3), np.zeros(3))


def with_grip(description, grip: Grip | None):
    hand = replace(description.hand(), grip=grip)
    return replace(description, hands={hand.name: hand})


class Jaw(TinyRobot):
    """The tiny robot with the grip of two jaws."""

    def __init__(self, **changes) -> None:
        super().__init__()
        self._description = with_grip(self._description, replace(JAW, **changes))


def carton(yaw: float, half=(0.02, 0.06, 0.05)) -> PointCloud:
    rng = np.random.default_rng(0)
    local, _ = surface("box", np.array(half), rng, 1500)
    return PointCloud(local @ rotation_about("z", yaw).T + [-0.35, 0.0, TABLE.top + half[2]])


def test_the_icub_s_right_hand_has_the_numbers_that_it_was_planned_with(icub):
    hand = planned_hand(icub.description, "right")
    np.testing.assert_array_equal(hand.palm, [0.033, -0.002, 0.001])
    np.testing.assert_array_equal(hand.fingers, [[y, 0.034] for y in (-0.036, -0.008, 0.020, 0.036)])
    np.testing.assert_array_equal(hand.sweep, [[-0.020, 0.085], [-0.050, 0.050], [0.0, 0.075]])
    assert not hand.is_mirrored
    assert is_learned(hand)


def test_the_left_hand_is_the_right_one_of_the_mirrored_world(icub):
    right, left = (planned_hand(icub.description, name) for name in ("right", "left"))
    assert left.is_mirrored
    assert is_learned(left)
    for name in ("palm", "fingers", "sweep", "T_jaw"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    T = make_transform(rotation_about("z", 0.3) @ rotation_about("x", 2.0), [-0.3, 0.1, 1.0])[None]
    there, mirror = left.to_hand(T)[0], np.diag([1.0, -1.0, 1.0])
    assert is_rigid(there)
    np.testing.assert_array_equal(there[:3, 0], mirror @ T[0, :3, 0])  # the closing axis
    np.testing.assert_array_equal(-there[:3, 2], mirror @ T[0, :3, 2])  # out of the palm


def test_the_left_grip_is_a_right_handed_frame_at_the_palm(icub):
    """In the description itself nothing is mirrored: its frames are rotations, x closes and z leaves the palm."""
    grip = icub.description.hand("left").grip
    assert is_rigid(grip.T_hand_grip)
    np.testing.assert_array_equal(grip.T_hand_grip[:3, 2], [0, 0, -1])
    np.testing.assert_allclose(grip.T_hand_grip[:3, 3], [0.033, -0.002, -0.001])


def test_poses_of_jaws_put_the_solid_between_them_before_the_palm():
    hand = planned_hand(Jaw().description)
    T_grip = hand.to_hand(family(CARTON, hand)) @ JAW.T_hand_grip
    x, z, palm = T_grip[:, :3, 0], T_grip[:, :3, 2], T_grip[:, :3, 3]
    assert np.abs((palm * x).sum(axis=1)).max() < 1e-9  # the solid's middle is halfway between the jaws
    reach, _ = CARTON.support(-z)
    np.testing.assert_allclose(-(palm * z).sum(axis=1), reach + 0.004, atol=1e-9)


def test_yaws_of_the_description_bound_the_closing_axis():
    hand = planned_hand(Jaw(yaws=(np.radians(60), np.radians(120))).description)
    R = hand.to_hand(family(CARTON, hand))[:, :3, :3] @ JAW.T_hand_grip[:3, :3]
    x = R[R[:, 2, 2] < -1 + 1e-9, :, 0]  # of those that look straight down, whose x axis is not dipped
    angles = np.degrees(np.arctan2(x[:, 1], x[:, 0])) % 360
    assert 45 - 1e-6 <= angles.min()
    assert angles.max() <= 135 + 1e-6


@pytest.mark.parametrize("yaw", [0.0, 0.7, 1.5])
def test_jaws_take_a_carton_by_its_narrow_side(yaw):
    robot = Jaw()
    proposals = Superquadrics().propose(carton(yaw), robot, TABLE)
    assert proposals, proposals.reason
    grasp = proposals.grasps[0]
    assert grasp.hand == "claw"
    closing = (grasp.T_world_hand @ JAW.T_hand_grip)[:3, 0]
    assert abs(closing @ rotation_about("z", yaw)[:, 0]) > np.cos(0.2)


def test_the_width_of_the_hand_decides_what_is_too_wide():
    cloud = carton(0.0, (0.034, 0.06, 0.05))
    assert Superquadrics().propose(cloud, Jaw(), TABLE)
    refused = Superquadrics().propose(cloud, Jaw(width=0.05), TABLE)
    assert not refused
    assert "the hand takes 50 mm" in refused.reason


def test_a_voxel_s_gripper_becomes_the_jaws_themselves():
    """z is the approach of both; the opening is the gripper's y and the grip's x."""
    hand, volume = planned_hand(Jaw().description), Volume(np.array([-0.5, -0.15, 0.9]))
    index = np.array([[20, 11, 7]])
    found = Selected(index, np.array([0.9]), np.array([[0.1, 0.7, 0.2, 0.67]]), np.array([5.0]))
    poses, _ = hand_poses(found, volume, "gripper", hand)
    grips = hand.to_hand(poses) @ JAW.T_hand_grip
    np.testing.assert_allclose(grips[:, :3, 3], np.tile(volume.point_of(index[0]), (2, 1)), atol=1e-9)
    np.testing.assert_allclose(grips[0, :3, 2], grips[1, :3, 2], atol=1e-9)
    np.testing.assert_allclose(grips[0, :3, 0], -grips[1, :3, 0], atol=1e-9)
    assert not is_learned(hand)


def test_a_hand_without_a_grip_is_named():
    robot = TinyRobot()
    robot._description = with_grip(robot.description, None)
    with pytest.raises(ConfigError, match="hand 'claw' of robot 'tiny' has no grip"):
        Superquadrics().propose(carton(0.0), robot, TABLE)


def test_to_hand_and_from_hand_agree(icub):
    for description, name in ((icub.description, "right"), (icub.description, "left"), (Jaw().description, "claw")):
        hand = planned_hand(description, name)
        point = np.array([[0.01, 0.02, 0.05]])
        T = make_transform(rotation_about("y", 0.4), [0.1, 0.2, 0.3])
        planned = T[:3, :3] @ hand.from_hand(point)[0] + T[:3, 3]
        if hand.is_mirrored:
            planned = planned * [1, -1, 1]
        there = hand.to_hand(T[None])[0]
        np.testing.assert_allclose(there[:3, :3] @ point[0] + there[:3, 3], planned, atol=1e-12)
        assert is_rigid(invert(there))
