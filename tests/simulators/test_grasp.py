"""A scripted grasp holds in every engine: servos, couplings, friction and contacts work together."""

import numpy as np
import pytest

from icub_core.geometry import make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.scene import Scene

PALM_DOWN = np.diag([-1.0, 1.0, -1.0])  # fingers forward
CASES = {"004_sugar_box": 0.0, "006_mustard_bottle": np.pi / 2}  # roll of the hand about its fingers


@pytest.mark.parametrize("name", list(CASES))
def test_an_object_is_grasped_lifted_and_held(engine, icub, ycb, name):
    spec, d, frame = ycb.get(name), icub.description, icub.description.hand("right").frame
    engine.load(d, Scene(objects=(spec,)))
    R_object, roll = quat_wxyz_to_matrix(spec.rest_quat_wxyz), CASES[name]
    center = np.array([-0.35, 0.0, 0.95 + spec.rest_height])
    half = np.abs(R_object) @ np.array(spec.half_extents)
    R = PALM_DOWN @ rotation_about("x", roll)
    face = center + (np.array([0, 0, half[2]]) if roll == 0 else -half[1] * R[:, 2])
    point = face - R @ np.array([0.032, -0.002, 0.006])
    arm = icub.inverse_kinematics(make_transform(R, point), d.home_q, frame)
    assert arm.reached
    engine.set_joint_positions(arm.q)
    engine.set_object_pose(name, make_transform(R_object, center))

    A, b = d.actuator_matrix()
    hand = d.actuator_indices(d.hand("right").actuators)
    start = np.array([d.actuators[i].open for i in hand])
    stroke = np.array([d.actuators[i].close for i in hand]) - start
    targets = engine.actuator_positions()
    for k in range(120):
        now = engine.actuator_positions()[hand]
        targets[hand] = np.where(stroke == 0, start, np.minimum(now + stroke / 25, start + stroke * (k + 1) / 100))
        engine.set_targets(targets)
        engine.step(5)
    assert engine.fingertip_contacts().sum() >= 3
    lead, q = targets[hand] - engine.actuator_positions()[hand], arm.q
    for k in range(55):
        lifted = make_transform(R, point + [0, 0, 0.002 * (k + 1)])
        q = icub.inverse_kinematics(lifted, q, frame, max_iterations=2).q
        targets = A @ q + b
        targets[hand] = engine.actuator_positions()[hand] + lead
        engine.set_targets(targets)
        engine.step(5)
    assert engine.object_pose(name)[2, 3] > center[2] + 0.08
    engine.step(100)
    assert engine.object_pose(name)[2, 3] > center[2] + 0.08, "dropped within half a second"
    assert engine.faults() == ()
