"""Grasps of any generator, judged in several engines (see `validate`), by several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from icub_benchmarks.grasps.validate import Outcome, plan_trial, run_trial
from icub_benchmarks.parallel import PluginConfig
from icub_core.construct import build
from icub_core.interfaces.simulator import Simulator
from icub_core.scene import Scene
from icub_core.workers import Workers
from icub_tasks.grasping.plan import GraspPlan
from icub_tasks.grasping.task import GraspTask

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
    hand: str = "right"


@dataclass(frozen=True)
class Outcome:
    """Verdicts by engine, none where no plan was found, and the poses that had none."""

    outcomes: dict[str, Outcome]
    resamples: int


class Judge:
    """Plans a grasp for a pose and has every engine judge it. Lives in a worker process."""

    def __init__(
        self, robot: PluginConfig, grasp_generator: PluginConfig, objects: PluginConfig, engines: Sequence[str]
    ) -> None:
        self._engines = list(engines)
        self._robot = build("robot", robot)
        self._generator = build("grasp_generator", grasp_generator)
        self._objects = build("objects", objects)
        self._worlds: dict[str, Simulator] = {}
        self._loaded = ""

    def __call__(self, pose: Pose) -> Outcome:
        """Judge one pose."""
        name, description = pose.object_name, self._robot.description
        if self._loaded != name:
            scene = Scene(objects=(self._objects.get(name),))
            for engine in self._engines:
                self._worlds.setdefault(engine, build("simulator", engine)).load(description, scene)
            self._loaded = name
        world = self._worlds[self._engines[0]]
        task = GraspTask(world, self._robot, self._generator, [name], hand=pose.hand)
        rng = np.random.default_rng([pose.seed, pose.number])
        for resamples in range(MAX_RESAMPLES):
            task.place(name, rng)
            T_world_object, plan = world.object_pose(name), task.plan(name)
            if isinstance(plan, GraspPlan):
                return Outcome(self._judge(plan, T_world_object), resamples)
        return Outcome({}, MAX_RESAMPLES)

    def _judge(self, plan: GraspPlan, T_world_object: NDArray[np.float64]) -> dict[str, Outcome]:
        trial = plan_trial(self._robot, plan.grasp, plan.q_far)
        if trial is None:
            return dict.fromkeys(self._engines, Outcome.UNREACHABLE)
        description, name = self._robot.description, plan.object_name
        return {
            engine: run_trial(self._worlds[engine], description, trial, name, T_world_object)
            for engine in self._engines
        }


def judge_poses(
    poses: Sequence[Pose],
    *,
    robot: PluginConfig = "icub",
    grasp_generator: PluginConfig = "superquadrics",
    objects: PluginConfig = "ycb_primitives",
    engines: Sequence[str] = ("mujoco", "pybullet"),
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Outcome | None]:
    """Judge the first grasp of a generator that the arm can carry out, for each pose, in each engine.

    Args:
        poses: Of objects of the set.
        robot: Plugin, as the next two: its name, or its parameters with the name under ``plugin``.
        grasp_generator: Whose grasps.
        objects: Set of the poses' objects.
        engines: Simulator plugins; the first one also takes the images.
        workers: Processes; results do not depend on their number.
        progress: Told how many poses are over.

    Returns:
        Outcomes in the order of the poses, None for one whose process was lost.
    """
    make = partial(Judge, robot, grasp_generator, objects, engines)
    with Workers(make, max(1, min(workers, len(poses))), PATIENCE) as pool:
        return pool.map(poses, progress)
