"""Grasp trials with the iCub's own hand: the robot, the object on its table, and the scripted grasp of the task.

A pose is drawn around the object's surface, must keep the open hand out of table and object, and must be reached on the
whole way; the arm is put 3 cm before it and the demonstrations' script does the rest. Every step is the task's own, so
a trial succeeds exactly when the episode would.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from icub_core import registry
from icub_core.data import Grasp, PointCloud
from icub_core.geometry import FloatArray, look_at
from icub_core.grasping.env import GraspEnv
from icub_core.grasping.evaluation import run_episodes
from icub_core.grasping.plan import FAR, GraspPlan
from icub_core.grasping.spaces import pose_vector
from icub_core.grasping.task import GraspTask, StartState, TaskSettings
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.scene import CameraView, Scene
from icub_grasp_generators.clouds import CLOUD_POINTS, MAX_TOUCHED, thin
from icub_grasp_generators.hand_geometry import read_hand_geometry
from icub_grasp_generators.reach import Reach, clears_table
from icub_grasp_generators.vgn.palm import PALM_POINT, YAW, at_palm
from icub_grasp_generators.vgn.trials import TriedScene

log = logging.getLogger(__name__)

WORLDS = 6
PLACEMENTS = 2
"""Places that each object is tried at."""
TRIALS = 12
"""Grasps tried at each place."""
LEAST_SEEN = 100
"""Points of a view below which the object is taken to be out of sight."""
DRAWN = 1500
"""Poses drawn for a place, before any test."""
TESTED = 200
"""Of those that keep clear, at most so many go to inverse kinematics."""

BEFORE = 0.03
CLOSING_STEPS = 60
LIFT = 0.03
MAX_STEPS = 105
"""Shorter than the task's 5 cm, 100 steps, 10 cm and 250 steps, to try twice as many."""
WIDTH, HEIGHT = 240, 180

_ROLL = (np.radians(-45.0), np.radians(95.0))
_DIP = (np.radians(-45.0), 0.0)
_OFFSET_LOW, _OFFSET_HIGH = np.array([-0.018, -0.035, 0.0]), np.array([0.012, 0.035, 0.012])
"""Metres from the palm point to the drawn surface point, in the hand frame."""
_GRIP_LOW, _GRIP_HIGH = np.array([-0.02, -0.045, 0.004]), np.array([0.065, 0.05, 0.06])
"""Box in the hand frame that the closing fingers sweep."""
_LEAST_GRIPPED = 0.08
"""Share of the object's surface points in that box below which nothing would be held."""
_SIDES = 0.5 * np.array([[1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5], [0, -1, 0.5]])
"""Metres; where cameras stand that see the whole surface."""
_JITTER = 0.15
"""Metres; half range of the places of further views around the head camera."""


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
        self._objects: ObjectSet = registry.build("objects", {"plugin": "random1000", "graspable": True})
        self._generator: GraspGenerator = registry.build("grasp_generator", "superquadrics")
        self._policy = registry.build("policy", {"plugin": "demonstrations", "closing_steps": CLOSING_STEPS})
        self._geometry = read_hand_geometry(self._robot, "right")

    def batch(self, number: int) -> list[TriedScene]:
        """Try `TRIALS` grasps at each of `PLACEMENTS` places of `WORLDS` objects drawn for this batch."""
        rng = np.random.default_rng([self._seed, number])
        worlds: list[tuple[int, GraspTask, list[_Place]]] = []
        for index in rng.choice(len(self._objects.names), WORLDS, replace=False):
            task = self._task(int(index))
            places = [place for place in (self._place(task, rng) for _ in range(PLACEMENTS)) if place.starts]
            if places:
                worlds.append((int(index), task, places))
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
        name = self._objects.names[index]
        simulator = registry.build("simulator", "mujoco")
        simulator.load(self._robot.description, Scene(objects=(self._objects.get(name),)))
        settings = replace(TaskSettings(), max_steps=MAX_STEPS, lift=LIFT, width=WIDTH, height=HEIGHT)
        return GraspTask(simulator, self._robot, self._generator, [name], settings=settings)

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
        views += [seen_from(simulator, eye + rng.uniform(-_JITTER, _JITTER, 3), center)]
        surface = np.concatenate([seen_from(simulator, center + side, center).points for side in _SIDES])
        if min(len(surface), *(len(view) for view in views)) < LEAST_SEEN:
            log.info("%s is hardly seen where it stands", name)
            return _Place(0.0, (), [])
        starts = []
        for grasp in self._reached(surface, center, simulator, rng):
            start = self._start(task, grasp, rest, settled)
            if start is not None:
                starts.append(start)
        return _Place(table_top, tuple(views), starts)

    def _reached(
        self, surface: FloatArray, center: FloatArray, simulator: Simulator, rng: np.random.Generator
    ) -> tuple[Grasp, ...]:
        table = simulator.scene.table
        T = draw_poses(surface, rng, DRAWN)
        T = T[gripped_share(T, thin(surface, CLOUD_POINTS)) >= _LEAST_GRIPPED]
        T = T[clears_table(self._geometry.hand.at(T), self._geometry.hand.radii, table)]
        T = T[self._geometry.occupancy.count(T, thin(surface, 2 * CLOUD_POINTS)) <= MAX_TOUCHED][:TESTED]
        tries = [Grasp(pose, center, float(-i), "trial") for i, pose in enumerate(T)]
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


def draw_poses(surface: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Draw hand poses (count, 4, 4) whose palm points are near points of the surface (N, 3).

    x stays horizontal at an angle that the right arm reaches, a roll about it takes the palm from looking down to
    looking sideways, and the fingers dip by up to 45 degrees.
    """
    poses = np.tile(np.eye(4), (count, 1, 1))
    yaw, roll, dip = rng.uniform(*YAW, count), rng.uniform(*_ROLL, count), rng.uniform(*_DIP, count)
    flat = _about(2, yaw) @ np.diag([1.0, -1.0, -1.0])
    poses[:, :3, :3] = flat @ _about(0, roll) @ _about(1, dip)
    touched = PALM_POINT + rng.uniform(_OFFSET_LOW, _OFFSET_HIGH, (count, 3))
    points = surface[rng.integers(len(surface), size=count)]
    poses[:, :3, 3] = points - np.einsum("nij,nj->ni", poses[:, :3, :3], touched)
    return poses


def _about(axis: int, angles: FloatArray) -> FloatArray:
    """Return rotations (N, 3, 3) about a coordinate axis by `angles` (N,), rad."""
    R = np.zeros((len(angles), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[:, axis, axis] = 1.0
    R[:, i, i] = R[:, j, j] = np.cos(angles)
    R[:, j, i] = np.sin(angles)
    R[:, i, j] = -R[:, j, i]
    return R


def gripped_share(T: FloatArray, surface: FloatArray) -> FloatArray:
    """Return the share (C,) of surface points (N, 3) that the closing fingers of hands at T (C, 4, 4) sweep."""
    local = (surface - T[:, None, :3, 3]) @ T[:, :3, :3]
    return np.asarray(np.all((local > _GRIP_LOW) & (local < _GRIP_HIGH), axis=2).mean(axis=1))


def seen_from(simulator: Simulator, eye: FloatArray, center: FloatArray) -> PointCloud:
    """Return the cloud (world) of the scene's first object from a free camera at `eye` (3,) that looks at `center`."""
    picture = simulator.render(CameraView(look_at(eye, center)), WIDTH, HEIGHT, segmentation=True)
    assert picture.segmentation is not None
    return picture.frame.to_cloud(picture.segmentation == 0)
