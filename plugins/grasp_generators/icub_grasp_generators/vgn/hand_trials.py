"""Grasp trials with the iCub's own hand: the robot, the object on its table, and the scripted grasp of the task.

Poses are drawn around the surface that the head sees, half of them moved so that what is seen lies between thumb and
fingers and before the palm. They must keep the open hand out of the table and of what is seen, and must be reached on
the whole way; the arm is put 3 cm before the pose and the demonstrations' script does the rest, step for step as in the
task. What the head does not see may be in the way: that is one of the things to learn.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from icub_core import registry
from icub_core.data import Grasp, PointCloud
from icub_core.geometry import FloatArray, look_at
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.scene import CameraView, Scene
from icub_grasp_generators.clouds import CLOUD_POINTS, MAX_TOUCHED, center_of, thin
from icub_grasp_generators.hand_geometry import read_hand_geometry
from icub_grasp_generators.reach import Reach, clears_table
from icub_grasp_generators.vgn.exploration import MIN_GRIPPED, draw_poses, fitted, gripped_share
from icub_grasp_generators.vgn.palm import at_palm
from icub_grasp_generators.vgn.trial_objects import TrialObjects
from icub_grasp_generators.vgn.trials import TriedScene
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.evaluation import run_episodes
from icub_tasks.grasping.plan import FAR, GraspPlan
from icub_tasks.grasping.spaces import pose_vector
from icub_tasks.grasping.task import GraspTask, StartState, TaskSettings

log = logging.getLogger(__name__)

WORLDS = 6
PLACEMENTS = 2
"""Places that each object is tried at."""
TRIALS = 12
"""Grasps tried at each place."""
MIN_SEEN = 100
"""Points of a view below which the object is taken to be out of sight."""
DRAWN = 1500
"""Poses drawn for a place, before any test."""
TESTED = 200
"""Of those that keep clear, at most so many go to inverse kinematics."""

BEFORE = 0.03
CLOSING_STEPS = 60
LIFT = 0.08
MAX_STEPS = 130
"""A little shorter than the task's 5 cm, 100 steps, 10 cm and 250 steps, to try twice as many."""
WIDTH, HEIGHT = 240, 180
FURTHER_VIEWS = 2

_SIDES = 0.5 * np.array([[1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5], [0, -1, 0.5]])
"""Meters; where cameras stand that see the whole surface."""
_JITTER = 0.15
"""Meters; half range of the places of further views around the head camera."""


@dataclass(frozen=True, eq=False)
class _Place:
    """One object where it stood: the table's height, its views, and starts of the trials."""

    table_top: float
    views: tuple[PointCloud, ...]
    starts: list[StartState]


class HandTrials:
    """Tries grasps of random objects, batch by batch.

    Args:
        seed: With the number of a batch, decides it.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._robot: Robot = registry.build("robot", "icub")
        self._objects = TrialObjects()
        self._generator: GraspGenerator = registry.build("grasp_generator", "superquadrics")
        self._policy = registry.build("policy", {"plugin": "demonstrations", "closing_steps": CLOSING_STEPS})
        self._geometry = read_hand_geometry(self._robot, "right")

    def batch(self, number: int) -> list[TriedScene]:
        """Try `TRIALS` grasps at each of `PLACEMENTS` places of `WORLDS` objects drawn for this batch."""
        rng = np.random.default_rng([self._seed, number])
        worlds: list[tuple[int, GraspTask, list[_Place]]] = []
        for index in self._objects.draw(rng, WORLDS):
            task = self._task(index)
            places = [place for place in (self._place(task, rng) for _ in range(PLACEMENTS)) if place.starts]
            if places:
                worlds.append((index, task, places))
            else:
                log.info("no pose around %s is reached where it stood", task.objects[0])
                task.simulator.close()
        return self._run(worlds) if worlds else []

    def _run(self, worlds: list[tuple[int, GraspTask, list[_Place]]]) -> list[TriedScene]:
        starts = [[start for place in places for start in place.starts] for _, _, places in worlds]
        most = max(map(len, starts))
        env = GraspEnv([task for _, task, _ in worlds])
        try:  # a world with fewer starts repeats them, and only the first time counts
            results = run_episodes(
                self._policy, env, most * len(worlds), lambda w, e: starts[w][e // len(worlds) % len(starts[w])]
            )
        finally:
            env.close()
        success = results.success.reshape(most, len(worlds))
        scenes = []
        for w, (index, _, places) in enumerate(worlds):
            first = 0
            for place in places:
                count = len(place.starts)
                T = np.stack([start.plan.grasp.T_world_hand for start in place.starts])
                held = success[first : first + count, w]
                scenes.append(TriedScene(index, place.table_top, place.views, at_palm(T), np.zeros(count), held))
                first += count
        return scenes

    def _task(self, index: int) -> GraspTask:
        spec = self._objects.get(index)
        simulator = registry.build("simulator", "mujoco")
        simulator.load(self._robot.description, Scene(objects=(spec,)))
        settings = replace(TaskSettings(), max_steps=MAX_STEPS, lift=LIFT, width=WIDTH, height=HEIGHT)
        return GraspTask(simulator, self._robot, self._generator, [spec.name], settings=settings)

    def _place(self, task: GraspTask, rng: np.random.Generator) -> _Place:
        name, simulator = task.objects[0], task.simulator
        rest = task.place(name, rng)
        assert simulator.scene.table is not None
        table_top, center = simulator.scene.table.top, simulator.object_pose(name)[:3, 3].copy()
        settled = simulator.save_state()
        head = task.look(name)
        assert head.segmentation is not None
        eye = head.frame.T_world_camera[:3, 3]
        views = [head.frame.to_cloud(head.segmentation == 0)]
        views += [seen_from(simulator, eye + rng.uniform(-_JITTER, _JITTER, 3), center) for _ in range(FURTHER_VIEWS)]
        surface = np.concatenate([seen_from(simulator, center + side, center).points for side in _SIDES])
        if min(len(surface), *(len(view) for view in views)) < MIN_SEEN:
            log.info("%s is hardly seen where it stands", name)
            return _Place(0.0, (), [])
        starts = []
        for grasp in self._reached(views[0].points, surface, simulator, rng):
            start = self._start(task, grasp, rest, settled)
            if start is not None:
                starts.append(start)
        return _Place(table_top, tuple(views), starts)

    def _reached(
        self, seen: FloatArray, surface: FloatArray, simulator: Simulator, rng: np.random.Generator
    ) -> tuple[Grasp, ...]:
        table = simulator.scene.table
        assert table is not None
        center, cloud = center_of(seen, table.top), thin(seen, CLOUD_POINTS)
        drawn = draw_poses(cloud, rng, DRAWN)
        drawn[::2] = fitted(drawn[::2], cloud, rng)
        drawn = drawn[gripped_share(drawn, cloud) >= MIN_GRIPPED]
        drawn = drawn[clears_table(self._geometry.hand.at(drawn), self._geometry.hand.radii, table)]
        drawn = drawn[self._geometry.occupancy.count(drawn, cloud) <= MAX_TOUCHED][:TESTED]
        tries = [Grasp(T, center, float(-i), "trial") for i, T in enumerate(drawn)]
        before = np.array([grasp.backed_off(BEFORE) for grasp in tries]).reshape(-1, 4, 4)
        # the arm is put there: inside of what the head does not see would be no place to begin
        clear = self._geometry.occupancy.count(before, thin(surface, 2 * CLOUD_POINTS)) == 0
        tries = [grasp for grasp, is_clear in zip(tries, clear, strict=True) if is_clear]
        return Reach(self._robot, self._geometry, table, 0.0).choose(tries, TRIALS)

    def _start(self, task: GraspTask, grasp: Grasp, rest: FloatArray, settled: FloatArray) -> StartState | None:
        """Put the arm 3 cm before the grasp, by way of the 10 cm pose, with the object as it had settled."""
        robot, layout, simulator = self._robot, task.layout, task.simulator
        q = robot.description.home_q
        T_far, T_near = grasp.backed_off(FAR), grasp.backed_off(BEFORE)
        for T in (T_far, T_near):
            solution = robot.inverse_kinematics(T, q, layout.frame, group="right_reach")
            if not solution.reached:
                return None
            q = solution.q
        matrix, offset = robot.description.actuator_matrix()
        command = matrix @ q + offset
        command[layout.fingers] = layout.opened
        simulator.restore_state(settled)
        simulator.set_joint_positions(q)
        simulator.set_targets(command)
        plan = GraspPlan(task.objects[0], grasp, T_far, T_near, q)
        return StartState(plan, simulator.save_state(), q, pose_vector(T_near), command, rest)


def seen_from(simulator: Simulator, eye: FloatArray, center: FloatArray) -> PointCloud:
    """Return the cloud (world) of the scene's first object from a free camera at `eye` (3,) that looks at `center`."""
    picture = simulator.render(CameraView(look_at(eye, center)), WIDTH, HEIGHT, segmentation=True)
    assert picture.segmentation is not None
    return picture.frame.to_cloud(picture.segmentation == 0)
