"""Small real worlds and files of weights for the tests of the policies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from icub_tasks.grasping.env import GraspEnv

from icub_core.construct import build
from icub_core.scene import Scene
from icub_policies.gpayn import Gpayn
from icub_tasks.grasping.task import GraspTask, TaskSettings


@pytest.fixture(scope="session")
def make_env() -> Iterator[Callable[..., GraspEnv]]:
    """Build an environment of one meat can a world, with short episodes."""
    simulators = []
    robot = build("robot", "icub")
    generator = build("grasp_generator", "superquadrics")
    can = build("objects", "ycb_primitives").get("010_potted_meat_can")

    def make(worlds: int = 1, max_steps: int = 12, pool_size: int = 1) -> GraspEnv:
        tasks = []
        for world in range(worlds):
            simulator = build("simulator", "mujoco")
            simulator.load(robot.description, Scene(objects=(can,)))
            simulators.append(simulator)
            settings = TaskSettings(max_steps=max_steps)
            tasks.append(GraspTask(simulator, robot, generator, [can.name], settings=settings, seed=world))
        return GraspEnv(tasks, pool_size=pool_size)

    yield make
    for simulator in simulators:
        simulator.close()


@pytest.fixture
def base_file(tmp_path: Path) -> Path:
    """Weights of an untrained, small base policy."""
    path = tmp_path / "base.safetensors"
    Gpayn(hidden=16, seed=3).save(path)
    return path
