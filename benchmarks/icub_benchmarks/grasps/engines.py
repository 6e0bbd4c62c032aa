"""Grasps of any generator, executed in several physics engines (see `validate`), by several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from icub_benchmarks.grasps.validate import Outcome, plan_trial, run_trial
from icub_benchmarks.workers import Workers
from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.construct import factory
from icub_tasks.grasping.plan import GraspPlan
from icub_tasks.grasping.task import GraspingTask

MAX_RESAMPLES = 20
"""Places without a plan after which a pose is given up."""
PATIENCE = 900.0
"""Seconds a process may take for one pose; it takes a few."""


@dataclass(frozen=True)
class Pose:
    """One place of one object; what is random follows from the numbers."""

    object_name: str
    number: int
    seed: int = 0


@dataclass(frozen=True)
class PoseResult:
    """Outcomes by engine, none where no plan was found, and the number of places that had none."""

    outcomes: dict[str, Outcome]
    resamples: int


class Executor:
    """Plans a grasp for a pose and executes it in every engine. Lives in a worker process."""

    def __init__(self, overrides: Sequence[str], engines: Sequence[str]) -> None:
        self._plugins = Assembly(compose(overrides))
        self._robot = self._plugins.get("robot")
        self._engines = list(engines)
        self._worlds: dict[str, GraspingTask] = {}
        self._loaded = ""

    def __call__(self, pose: Pose) -> PoseResult:
        """Execute the first grasp that the arm can carry out."""
        self._load(pose.object_name)
        world = self._worlds[self._engines[0]].worlds[0]
        rng = np.random.default_rng([pose.seed, pose.number])
        for resamples in range(MAX_RESAMPLES):
            world.place(pose.object_name, rng)
            T_world_object, plan = world.simulator.object_pose(pose.object_name), world.plan(pose.object_name)
            if isinstance(plan, GraspPlan):
                return PoseResult(self._execute(plan, T_world_object), resamples)
        return PoseResult({}, MAX_RESAMPLES)

    def _load(self, name: str) -> None:
        """Build a world with one object in each engine."""
        if self._loaded == name:
            return
        for task in self._worlds.values():
            task.close()
        for engine in self._engines:
            made = self._plugins.fresh("task", simulator=factory("simulator", engine), targets=[name])
            assert isinstance(made, GraspingTask)
            self._worlds[engine] = made
        self._loaded = name

    def _execute(self, plan: GraspPlan, T_world_object: NDArray[np.float64]) -> dict[str, Outcome]:
        trial = plan_trial(self._robot, plan.grasp, plan.q_far)
        if trial is None:
            return dict.fromkeys(self._engines, Outcome.UNREACHABLE)
        description, name = self._robot.description, plan.object_name
        return {
            engine: run_trial(task.simulator(0), description, trial, name, T_world_object)
            for engine, task in self._worlds.items()
        }


def execute_poses(
    poses: Sequence[Pose],
    *,
    overrides: Sequence[str] = (),
    engines: Sequence[str] = ("mujoco", "pybullet"),
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[PoseResult | None]:
    """Execute the first grasp that the arm can carry out, for each pose, in each engine.

    Args:
        poses: Of objects of the object set.
        overrides: Words as after ``icub run``: they decide robot, grasp generator, object set and task.
        engines: Simulator plugins; the first one also takes the images.
        workers: Processes; results do not depend on their number.
        progress: Told how many poses are over.

    Returns:
        Results in the order of the poses, None for one whose process was lost.
    """
    make = partial(Executor, tuple(overrides), tuple(engines))
    with Workers(make, max(1, min(workers, len(poses))), PATIENCE) as pool:
        return pool.map(poses, progress)
