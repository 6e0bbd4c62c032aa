"""Trials of grasps: a good one holds in both engines, bad ones fail for the right reason."""

import dataclasses

import numpy as np
import pytest

import icub_core as icub
from icub_benchmarks.grasps.engines import Executor, Pose
from icub_benchmarks.grasps.validate import Outcome, plan_trial, run_trial
from icub_core.data import Grasp
from icub_core.errors import ConfigError
from icub_core.geometry import make_transform, quat_wxyz_to_matrix
from icub_core.scene import Scene

NAME = "010_potted_meat_can"
ENGINES = ["mujoco", "pybullet"]
EACH_ENGINE = ["mujoco", pytest.param("pybullet", marks=pytest.mark.pybullet)]


@pytest.fixture(scope="module")
def robot():
    return icub.load("robot", "icub")


@pytest.fixture(scope="module")
def can():
    return icub.load("objects", "ycb_primitives").get(NAME)


@pytest.fixture(scope="module")
def standing(can):
    return make_transform(quat_wxyz_to_matrix(can.rest_quat_wxyz), [-0.35, 0.0, 0.95 + can.rest_height])


@pytest.fixture(scope="module")
def grasp(can, standing):
    """From above, fingers forward, palm 6 mm over the can, thumb on its near side."""
    R = np.diag([-1.0, 1.0, -1.0])
    top = standing[:3, 3] + [0, 0, can.half_extents[2]]
    return Grasp(make_transform(R, top - R @ np.array([0.032, -0.002, 0.006])), standing[:3, 3], 0.0, "by hand")


def outcome_in(engine, robot, spec, standing, grasp):
    trial = plan_trial(robot, grasp, robot.description.home_q)
    simulator = icub.load("simulator", engine)
    try:
        simulator.load(robot.description, Scene(objects=(spec,)))
        return run_trial(simulator, robot.description, trial, NAME, standing)
    finally:
        simulator.close()


def moved(grasp, **by):
    T = grasp.T_world_hand.copy()
    T[:3, 3] += by["by"]
    return dataclasses.replace(grasp, T_world_hand=T)


@pytest.mark.parametrize("engine", EACH_ENGINE)
def test_a_good_grasp_is_held(engine, robot, can, standing, grasp):
    assert outcome_in(engine, robot, can, standing, grasp) is Outcome.HELD


def test_a_grasp_of_air_lifts_nothing(robot, can, standing, grasp):
    assert outcome_in("mujoco", robot, can, standing, moved(grasp, by=[0.0, 0.16, 0.02])) is Outcome.NOT_LIFTED


@pytest.mark.parametrize("engine", EACH_ENGINE)
def test_a_grasp_inside_the_table_has_an_outcome(engine, robot, can, standing, grasp):
    """The arm presses on the table; nothing breaks and nothing is held."""
    low = moved(grasp, by=[0.0, 0.3, -0.12])
    assert outcome_in(engine, robot, can, standing, low) in (Outcome.NOT_LIFTED, Outcome.FAULT)


def test_a_can_without_friction_slips_out(robot, can, standing, grasp):
    description = robot.description
    slippery = {link: dataclasses.replace(m, friction=(0.01, 0.0, 0.0)) for link, m in description.contacts.items()}
    soap = dataclasses.replace(can, friction=(0.01, 0.0, 0.0), mass=2.0)
    simulator = icub.load("simulator", "mujoco")
    simulator.load(dataclasses.replace(description, contacts=slippery), Scene(objects=(soap,)))
    trial = plan_trial(robot, grasp, description.home_q)
    assert run_trial(simulator, description, trial, NAME, standing) in (Outcome.NOT_LIFTED, Outcome.SHAKEN_OFF)
    simulator.close()


def test_a_grasp_out_of_reach_has_no_trial(robot, grasp):
    assert plan_trial(robot, moved(grasp, by=[-0.8, 0.0, 0.0]), robot.description.home_q) is None


def test_a_hand_that_the_robot_lacks_is_named(robot, grasp):
    with pytest.raises(ConfigError, match="left"):
        plan_trial(robot, dataclasses.replace(grasp, hand="left"), robot.description.home_q)


def test_the_left_hand_is_planned_like_the_right_one(can, standing, grasp):
    """Mirrored at the robot's plane of symmetry."""
    left = icub.load("robot", "icub", hands=["left"])
    frame, home = left.description.hand("left").frame, left.description.home_q
    T = make_transform(np.diag([-1.0, 1.0, -1.0]), grasp.T_world_hand[:3, 3] * [1, -1, 1])
    mirrored = dataclasses.replace(grasp, T_world_hand=T, hand="left")
    trial = plan_trial(left, mirrored, home)
    assert trial is not None
    np.testing.assert_allclose(left.forward_kinematics(trial.q_start, frame)[:3, :3], T[:3, :3], atol=0.02)
    assert trial.lift.shape == (55, len(left.description.actuators))


@pytest.mark.pybullet
@pytest.mark.slow
def test_a_generator_s_grasp_is_executed_in_both_engines():
    result = Executor([], ENGINES)(Pose(NAME, 0))
    assert list(result.outcomes) == ENGINES
    assert result.outcomes["mujoco"] is Outcome.HELD
