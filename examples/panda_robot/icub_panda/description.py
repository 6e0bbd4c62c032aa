"""The Panda as data: where it stands, its gains, its gripper and a camera on a mast."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from icub_core.geometry import invert, look_at, make_transform, matrix_to_quat_wxyz, rotation_about
from icub_core.robot_description import (
    Actuator,
    ContactMaterial,
    CoupledJoint,
    Grip,
    HandDescription,
    JointDynamics,
    RobotCamera,
    RobotDescription,
)
from icub_panda.urdf import PEDESTAL, panda_urdf

ARM = tuple(f"panda_joint{i}" for i in range(1, 8))
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
PADS = ("panda_leftfinger", "panda_rightfinger")
HAND = "panda_hand"

T_WORLD_ROOT = make_transform(rotation_about("z", np.pi), [0.15, 0.0, PEDESTAL])
"""Beside the standard table, where the iCub's trunk would be, looking at the table (along the world's -x)."""
HOME = dict(zip(ARM, (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), strict=True))
OPEN = 0.04
"""Meters that each finger slides; the hand is closed at 0."""

GRIP = Grip(
    # the pads close along the hand's y; the palm is taken to begin 9 mm above the hand's body, which leaves room for
    # policies that press a little further than planned
    T_hand_grip=make_transform(rotation_about("z", np.pi / 2), [0.0, 0.0, 0.075]),
    width=0.072,  # of an opening of 0.08, of which errors of vision take their part
    fingers_y=np.array([-0.006, 0.006]),
    depth=0.028,
    sweep=np.array([[-0.040, 0.040], [-0.009, 0.009], [0.0, 0.037]]),
    half_axes=(0.035, 0.02, 0.025),
)


def describe() -> RobotDescription:
    """Assemble the robot; DataError where its URDF is not installed."""
    urdf = panda_urdf()
    limits = {
        joint.attrib["name"]: {key: float(value) for key, value in joint.find("limit").attrib.items()}  # type: ignore[union-attr]
        for joint in ET.parse(urdf).getroot().findall("joint")
        if joint.attrib["type"] != "fixed"
    }
    joints = (*ARM, *FINGERS)
    arm = tuple(
        Actuator(
            joint,
            {joint: 1.0},
            kp=1500.0 if joint in ARM[:4] else 400.0,
            range=(limits[joint]["lower"], limits[joint]["upper"]),
            max_speed=limits[joint]["velocity"],
            max_acceleration=15.0,
        )
        for joint in ARM
    )
    # one motor for both fingers: its length is their mean; the demonstrations' lead of 1.6 mm makes the 20 N a finger
    # that the URDF permits
    motor = Actuator(
        "panda_gripper", dict.fromkeys(FINGERS, 0.5), kp=25_000.0, range=(0.0, OPEN), open=OPEN, close=0.0, step=0.004
    )
    gripper = HandDescription(
        name="gripper",
        frame=HAND,
        reach="arm",
        actuators=(motor.name,),
        fingertips=PADS,
        grip=GRIP,
        workspace=np.array([[-0.75, -0.45, 0.98], [0.0, 0.45, 1.70]]),
    )
    return RobotDescription(
        name="panda",
        urdf=urdf,
        T_world_root=T_WORLD_ROOT,
        joint_names=joints,
        lower=np.array([limits[joint]["lower"] for joint in joints]),
        upper=np.array([limits[joint]["upper"] for joint in joints]),
        groups={"arm": ARM, "fingers": FINGERS},
        actuators=(*arm, motor),
        home={**HOME, **dict.fromkeys(FINGERS, OPEN)},
        hands={gripper.name: gripper},
        cameras=(_mast_camera(),),
        dynamics={
            # at the efforts of the URDF the joints still reach their speeds against this damping
            **dict.fromkeys(ARM[:4], JointDynamics(damping=40.0, stiffness=0.0)),
            **dict.fromkeys(ARM[4:], JointDynamics(damping=8.0, stiffness=0.0)),
            **dict.fromkeys(FINGERS, JointDynamics(damping=1000.0, stiffness=0.0)),
        },
        # rubber: friction that also resists turning about the line between the pads, and holds whatever it touches
        contacts=dict.fromkeys(PADS, ContactMaterial(friction=(1.0, 0.02, 0.0001), condim=4, priority=1)),
        contact_excludes=(
            ("panda_link0", "panda_link1"),
            ("panda_link5", "panda_link7"),
            ("panda_link7", HAND),
            *((HAND, pad) for pad in PADS),
            PADS,
        ),
        coupled_joints=(CoupledJoint(FINGERS[1], FINGERS[0], 1.0),),
    )


def _mast_camera() -> RobotCamera:
    """Return a camera that stands behind the table and looks back at the robot."""
    T = invert(T_WORLD_ROOT) @ look_at([-0.85, 0.0, 1.5], [-0.35, 0.0, 1.0])
    w, x, y, z = (float(v) for v in matrix_to_quat_wxyz(T[:3, :3]))
    px, py, pz = (float(v) for v in T[:3, 3])
    return RobotCamera("mast", "panda_link0", (px, py, pz), (w, x, y, z), fovy=0.74)
