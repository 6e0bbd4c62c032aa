"""What the policies achieve on real physics and camera-planned poses; minutes, so only in the slow run."""

from __future__ import annotations

import pytest
from icub_tasks.grasping.env import GraspEnv

from icub_core.construct import build
from icub_core.rollouts import evaluate
from icub_core.scene import Scene
from icub_policies.demonstrations import Demonstrations
from icub_policies.gpayn import Gpayn
from icub_tasks.grasping.task import GraspTask

pytestmark = pytest.mark.slow


def worlds(name: str, count: int = 8) -> GraspEnv:
    robot, generator = build("robot", "icub"), build("grasp_generator", "superquadrics")
    spec = build("objects", "ycb_primitives").get(name)
    tasks = []
    for world in range(count):
        simulator = build("simulator", "mujoco")
        simulator.load(robot.description, Scene(objects=(spec,)))
        tasks.append(GraspTask(simulator, robot, generator, [name], seed=world))
    return GraspEnv(tasks, pool_size=12, threads=2)


@pytest.mark.parametrize("name", ["004_sugar_box", "006_mustard_bottle", "010_potted_meat_can"])
def test_demonstrations_and_base_policy_grasp_what_they_should(name):
    env = worlds(name)
    assert evaluate(Demonstrations(), env, 16, seed=11).success_rate >= 0.8
    assert evaluate(Gpayn(weights="base_gpayn"), env, 16, seed=11).success_rate >= 0.6
