"""Collisions of a configuration: against MuJoCo's for the hand and the table, and known postures for the rest."""

import mujoco
import numpy as np
import pytest

from icub_core.scene import Table
from icub_robots.icub import ICub

ROBOT = ICub()
D = ROBOT.description
TABLE = Table()


def with_joints(**joints):
    q = D.home_q
    for name, value in joints.items():
        q[D.joint_names.index(name)] = value
    return q


def test_home_touches_nothing():
    for hands in [("right",), ("right", "left"), ("left",)]:
        robot = ICub(hands)
        assert robot.collisions(robot.description.home_q, TABLE) == ()


def _mujoco_world():
    spec = mujoco.MjSpec.from_file(str(D.urdf))
    spec.compiler.fusestatic = False
    for body in spec.bodies:
        for geom in body.geoms:
            if body.name in D.capsule_links and geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
                geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    center = np.array(TABLE.center) - D.T_world_root[:3, 3]
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, pos=center, size=TABLE.half_size)
    model = spec.compile()
    return model, mujoco.MjData(model)


def test_hand_and_forearm_against_the_table_agree_with_mujoco():
    model, data = _mujoco_world()
    rng = np.random.default_rng(0)
    reach = D.indices("right_reach")
    table = model.geom("table").id
    tested, touching = 0, 0
    for _ in range(150):
        q = D.home_q
        q[reach] = rng.uniform(D.lower[reach], D.upper[reach])
        for name, value in zip(D.joint_names, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        expected, unsure = set(), set()
        for g in range(model.ngeom):
            if g == table:
                continue
            name = model.body(model.geom_bodyid[g]).name
            distance = mujoco.mj_geomDistance(model, data, g, table, 0.1, None)
            if abs(distance) < 1e-4:
                unsure.add(name)
            elif distance < 0:
                expected.add(name)
        found = {a for a, b in ROBOT.collisions(q, TABLE) if b == "table"}
        hand = {name for name in found if name.startswith("r_hand") or name == "r_forearm"}
        assert hand - unsure == expected - unsure
        tested += 1
        touching += bool(expected)
    assert 10 < touching < tested - 10


@pytest.mark.parametrize(
    ("arm", "pair"),
    [
        ((-0.44, 0.08, 1.6, 1.74, -0.54, 0.05, -0.07), ("r_forearm", "chest")),  # forearm across the breast
        ((-0.77, 2.67, -0.3, 1.76, -0.33, -0.58, 0.29), ("r_hand", "head")),  # hand at the ear
        ((0.06, 0.01, 0.23, 0.2, 0.24, -1.07, -0.38), ("r_hand", "r_upper_leg")),  # arm hanging, hand inwards
    ],
)
def test_arm_in_the_body_is_seen(arm, pair):
    q = with_joints(**dict(zip(D.groups["right_arm"], arm, strict=True)))
    assert pair in ROBOT.collisions(q)


def test_arms_meet_in_front_of_the_chest():
    robot = ICub(("right", "left"))
    d = robot.description
    q = d.home_q
    q[d.indices("right_arm")] = q[d.indices("left_arm")] = [-0.78, 0.05, 0.53, 1.8, -0.37, -0.16, -0.05]
    assert ("r_forearm", "l_forearm") in robot.collisions(q)
    q[d.indices("left_arm")] = d.home_q[d.indices("left_arm")]
    assert robot.collisions(q) == ()


def test_table_counts_only_when_given():
    q = with_joints(torso_pitch=1.2)
    assert any("table" in pair for pair in ROBOT.collisions(q, TABLE))
    assert not any("table" in pair for pair in ROBOT.collisions(q))
    far = Table(center=(-5.0, 0.0, 0.9), half_size=(0.4, 0.4, 0.02))
    assert not any("table" in pair for pair in ROBOT.collisions(q, far))
    assert any("table" in pair for pair in ROBOT.collisions(q, TABLE))  # a pure function of its arguments


def test_margin_widens_the_shapes():
    """The lowest point of the home posture is a known distance above a table put there."""
    q = D.home_q
    table = Table(center=(-0.4, 0.2, 1.0), half_size=(0.3, 0.2, 0.02))
    low, high = 0.0, 0.5
    for _ in range(30):  # distance of the nearest link, by bisection on the margin
        middle = 0.5 * (low + high)
        low, high = (low, middle) if ROBOT.collisions(q, table, margin=middle) else (middle, high)
    assert high > 0.005
    raised = Table(center=(-0.4, 0.2, 1.0 + 0.5 * high), half_size=(0.3, 0.2, 0.02))
    assert ROBOT.collisions(q, raised) == ()
    assert ROBOT.collisions(q, raised, margin=high)
