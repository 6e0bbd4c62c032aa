"""Real worlds for the tests of the grasping task: MuJoCo, the iCub, superquadrics, one YCB object."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from icub_core.construct import build
from icub_core.scene import Scene
from icub_tasks.grasping.task import GraspTask

MakeTasks = Callable[..., list[GraspTask]]


@pytest.fixture(scope="session")
def make_tasks() -> Iterator[MakeTasks]:
    simulators = []
    robot = build("robot", "icub")
    generator = build("grasp_generator", "superquadrics")
    objects = build("objects", "ycb_primitives")

    def make(name: str = "010_potted_meat_can", worlds: int = 1, seed: int = 0, **options) -> list[GraspTask]:
        tasks = []
        for world in range(worlds):
            simulator = build("simulator", "mujoco")
            simulator.load(robot.description, Scene(objects=(objects.get(name),)))
            simulators.append(simulator)
            tasks.append(GraspTask(simulator, robot, generator, [name], seed=seed + world, **options))
        return tasks

    yield make
    for simulator in simulators:
        simulator.close()


@pytest.fixture(scope="session")
def tasks(make_tasks) -> list[GraspTask]:
    """Two worlds with a meat can; tests that use them begin with a reset."""
    return make_tasks(worlds=2)
