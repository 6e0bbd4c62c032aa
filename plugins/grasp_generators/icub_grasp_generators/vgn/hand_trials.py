"""Grasp trials with the iCub's own hand: the robot, the object on its table, and the scripted grasp of the task.

Poses are drawn around the surface that the head sees, half of them moved so that what is seen lies between thumb and
fingers and before the palm. They must keep the open hand out of the table and of what is seen, and must be reached on
the whole way; the arm is put 3 cm before the pose and the demonstrations' script does the rest, step for step as in the
task. What the head does not see may be in the way: that is one of the things to learn.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from icub_core.construct import build, factory
from icub_core.data import Grasp, PointCloud
from icub_core.geometry import FloatArray, look_at
from icub_core.interfaces.abilities import TriesGrasps
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.interfaces.task import Start, Task
from icub_core.rollouts import run_episodes
from icub_core.scene import CameraView
from icub_grasp_generators.clouds import CLOUD_POINTS, MAX_TOUCHED, center_of, thin
from icub_grasp_generators.hand_geometry import read_hand_geometry
from icub_grasp_generators.reach import Reach, clears_table
from icub_grasp_generators.vgn.exploration import MIN_GRIPPED, draw_poses, fitted, gripped_share
from icub_grasp_generators.vgn.palm import at_palm
from icub_grasp_generators.vgn.trial_objects import OneObject, TrialObjects
from icub_grasp_generators.vgn.trials import TriedScene

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
    """One object where it stood: the table's height, its views, and the grasps and starts of the trials."""

    table_top: float
    views: tuple[PointCloud, ...]
    grasps: list[Grasp]
    starts: list[Start]


class HandTrials:
    """Tries grasps of random objects, batch by batch.

    Args:
        seed: With the number of a batch, decides it.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._robot: Robot = build("robot", "icub")
        self._objects = TrialObjects()
        self._generator: GraspGenerator = build("grasp_generator", "superquadrics")
        self._policy = build("policy", {"plugin": "demonstrations", "closing_steps": CLOSING_STEPS})
        self._geometry = read_hand_geometry(self._robot, "right")

    def batch(self, number: int) -> list[TriedScene]:
        """Try `TRIALS` grasps at each of `PLACEMENTS` places of `WORLDS` objects drawn for this batch."""
        rng = np.random.default_rng([self._seed, number])
        scenes: list[TriedScene] = []
        for index in self._objects.draw(rng, WORLDS):
            task = self._task(index)
            places = [place for place in (self._place(task, rng) for _ in range(PLACEMENTS)) if place.starts]
            if not places:
                log.info("no pose around %s is reached where it stood", task.objects[0])
            for place in places:
                scenes.append(self._tried(task, index, place))
            task.close()
        return scenes

    def _tried(self, task: Task, index: int, place: _Place) -> TriedScene:
        count = len(place.starts)
        held = run_episodes(self._policy, task, count, lambda _, episode: place.starts[episode]).success
        T = np.stack([grasp.T_world_hand for grasp in place.grasps])
        return TriedScene(index, place.table_top, place.views, at_palm(T), np.zeros(count), held)

    def _task(self, index: int) -> Task:
        numbers = {"max_steps": MAX_STEPS, "lift": LIFT, "width": WIDTH, "height": HEIGHT}
        task: Task = build(
            "task",
            {"plugin": "grasp", **numbers},
            simulator=factory("simulator", "mujoco"),
            robot=self._robot,
            grasp_generator=self._generator,
            objects=OneObject(self._objects.get(index)),
        )
        return task

    def _place(self, task: Task, rng: np.random.Generator) -> _Place:
        assert isinstance(task, TriesGrasps)
        name, simulator = task.objects[0], task.simulator(0)
        task.place(0, name, rng)
        assert simulator.scene.table is not None
        table_top, center = simulator.scene.table.top, simulator.object_pose(name)[:3, 3].copy()
        settled = simulator.save_state()
        camera = self._robot.description.camera().name
        head = simulator.render(camera, WIDTH, HEIGHT, look_at=center, segmentation=True)
        assert head.segmentation is not None
        eye = head.frame.T_world_camera[:3, 3]
        views = [head.frame.to_cloud(head.segmentation == 0)]
        views += [seen_from(simulator, eye + rng.uniform(-_JITTER, _JITTER, 3), center) for _ in range(FURTHER_VIEWS)]
        surface = np.concatenate([seen_from(simulator, center + side, center).points for side in _SIDES])
        if min(len(surface), *(len(view) for view in views)) < MIN_SEEN:
            log.info("%s is hardly seen where it stands", name)
            return _Place(0.0, (), [], [])
        grasps, starts = [], []
        for grasp in self._reached(views[0].points, surface, simulator, rng):
            simulator.restore_state(settled)
            start = task.start_before(0, grasp, BEFORE, center)
            if start is not None:
                grasps.append(grasp)
                starts.append(start)
        return _Place(table_top, tuple(views), grasps, starts)

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


def seen_from(simulator: Simulator, eye: FloatArray, center: FloatArray) -> PointCloud:
    """Return the cloud (world) of the scene's first object from a free camera at `eye` (3,) that looks at `center`."""
    image = simulator.render(CameraView(look_at(eye, center)), WIDTH, HEIGHT, segmentation=True)
    assert image.segmentation is not None
    return image.frame.to_cloud(image.segmentation == 0)
