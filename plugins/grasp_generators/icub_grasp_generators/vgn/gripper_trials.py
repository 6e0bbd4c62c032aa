"""Trials of a parallel-jaw gripper on random objects, as VGN was trained with.

A surface point and its normal give the approach; the gripper's origin lies up to a finger's length outside of the
point; six turns about the approach are tried, and the middle of the longest run of turns that held is the label.

Source: Breyer et al. 2020 and the released code's data generation. DIFF: one object a scene, no clutter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.construct import build
from icub_core.data import PointCloud
from icub_core.geometry import FloatArray
from icub_core.interfaces.object_set import ObjectSet
from icub_grasp_generators.vgn.gripper_world import FINGER_DEPTH, MAX_WIDTH, GripperWorld
from icub_grasp_generators.vgn.trials import TriedScene

OBJECTS = 6
PLACEMENTS = 2
POINTS = 40
"""Objects of a batch, places of each, grasp points at each place."""
VIEWS = 3
TURNS = 6

_BEYOND = 0.1  # share of the finger's length that the origin may lie under the surface, or further out than its tips
_MIN_NORMAL = -0.1  # vertical part of normals that are grasped along
_DISTANCE = (0.48, 0.72)
_POLAR = np.pi / 4


class GripperTrials:
    """Tries grasps of random objects, batch by batch.

    Args:
        seed: With the number of a batch, decides it.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._objects: ObjectSet = build("objects", {"plugin": "random1000", "graspable": True})

    def batch(self, number: int) -> list[TriedScene]:
        """Try `POINTS` grasp points at each of `PLACEMENTS` places of `OBJECTS` objects drawn for this batch."""
        rng = np.random.default_rng([self._seed, number])
        scenes = []
        for index in rng.choice(len(self._objects.names), OBJECTS, replace=False):
            world = GripperWorld(self._objects.get(self._objects.names[int(index)]))
            for _ in range(PLACEMENTS):
                if world.place(rng.uniform(0.0, 2 * np.pi)):
                    scenes.append(self._scene(world, int(index), rng))
        return scenes

    def _scene(self, world: GripperWorld, index: int, rng: np.random.Generator) -> TriedScene:
        views, normals = zip(*(world.view(world.center + _direction(rng)) for _ in range(VIEWS)), strict=True)
        below = [world.view(world.center + [0.6 * np.cos(a), 0.6 * np.sin(a), 0.05]) for a in np.pi * np.arange(4) / 2]
        points = np.concatenate([cloud.points for cloud in views] + [cloud.points for cloud, _ in below])
        outward = np.concatenate([*normals, *(n for _, n in below)])
        poses, widths, held = [], [], []
        for i in rng.choice(np.flatnonzero(outward[:, 2] > _MIN_NORMAL), POINTS):
            depth = FINGER_DEPTH * rng.uniform(-_BEYOND, 1.0 + _BEYOND)
            turns = approaches(points[i] + depth * outward[i], -outward[i])
            outcomes = [world.grasp(T) for T in turns]
            success = np.array([outcome.held for outcome in outcomes])
            best = middle_of_longest_run(success) if success.any() else int(rng.integers(TURNS))
            poses.append(turns[best])
            widths.append(outcomes[best].width if success[best] else MAX_WIDTH)
            held.append(bool(success[best]))
        clouds = tuple(PointCloud(v.points, viewpoint=v.viewpoint) for v in views)
        return TriedScene(index, 0.0, clouds, np.stack(poses), np.array(widths), np.array(held))


def approaches(origin: FloatArray, approach: FloatArray) -> FloatArray:
    """Return gripper poses (6, 4, 4) at `origin` (3,) with z along `approach` (3,), turned through half a turn."""
    z = approach / np.linalg.norm(approach)
    x = np.array([1.0, 0.0, 0.0])
    if abs(float(z[0])) > 0.9:
        x = np.array([0.0, 1.0, 0.0])
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    x = np.cross(y, z)
    angles = np.pi * np.arange(TURNS) / TURNS
    T = np.tile(np.eye(4), (TURNS, 1, 1))
    T[:, :3, 0] = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * y
    T[:, :3, 1] = -np.sin(angles)[:, None] * x + np.cos(angles)[:, None] * y
    T[:, :3, 2], T[:, :3, 3] = z, origin
    return T


def middle_of_longest_run(success: NDArray[np.bool_]) -> int:
    """Return the middle of the longest run of successes of a circle of turns (one at least)."""
    count = len(success)
    if success.all():
        return 0
    first = int(np.flatnonzero(~success)[0])
    best, length, run = 0, 0, 0
    for step in range(1, count + 1):
        place = (first + step) % count
        run = run + 1 if success[place] else 0
        if run > length:
            best, length = (place - (run - 1) // 2) % count, run
    return best


def _direction(rng: np.random.Generator) -> FloatArray:
    """Draw a camera's place (3,) around the object, from above to 45 degrees down."""
    polar, around, distance = rng.uniform(0.0, _POLAR), rng.uniform(0.0, 2 * np.pi), rng.uniform(*_DISTANCE)
    return distance * np.array([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
