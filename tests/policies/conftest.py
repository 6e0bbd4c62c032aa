"""Small real worlds and files of weights for the tests of the policies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.interfaces.task import Task
from icub_policies.gpayn import Gpayn
from icub_testing.tiny.task import TinyTask


@pytest.fixture(scope="session")
def make_env() -> Iterator[Callable[..., Task]]:
    """Build a task of one meat can a world, with short episodes."""
    plugins = Assembly(compose(["task=grasp"]))
    made = []

    def make(num_envs: int = 1, max_steps: int = 12, starts: int = 1, **options) -> Task:
        words = {"num_envs": num_envs, "max_steps": max_steps, "starts": starts, **options}
        made.append(plugins.fresh("task", targets=["010_potted_meat_can"], **words))
        return made[-1]

    yield make
    for task in made:
        task.close()


@pytest.fixture(scope="session")
def like_the_icub() -> Task:
    """A task without physics whose hand has as many actuators and fingertips as the iCub's."""
    return TinyTask(fingers=9, fingertips=5)


@pytest.fixture
def base_file(tmp_path: Path, like_the_icub) -> Path:
    """Weights of an untrained, small base policy."""
    path = tmp_path / "base.safetensors"
    policy = Gpayn(hidden=16, seed=3)
    policy.bind(like_the_icub)
    policy.save(path)
    return path
