"""Real worlds for the tests of the grasping task: MuJoCo, the iCub, superquadrics, one YCB object."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_tasks.grasping.task import GraspingTask

MakeTask = Callable[..., GraspingTask]


@pytest.fixture(scope="session")
def make_task() -> Iterator[MakeTask]:
    """Build the task of one meat can a world; every word of its constructor may be given."""
    plugins = Assembly(compose(["task=grasp"]))
    made = []

    def make(name: str = "010_potted_meat_can", **options) -> GraspingTask:
        made.append(plugins.fresh("task", targets=[name], **options))
        return made[-1]

    yield make
    for task in made:
        task.close()


@pytest.fixture(scope="module")
def env(make_task) -> GraspingTask:
    """Two worlds that keep two starts each; tests that use them begin with a reset."""
    return make_task(num_envs=2, starts=2)
