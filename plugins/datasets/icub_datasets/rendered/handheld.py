"""Rendered TARGET-TASK in the manner of HO-3D: nine objects, held and turned in front of a camera one after another."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import look_at, make_transform, rotation_about
from icub_core.interfaces.simulator import Rendering, Simulator
from icub_core.scene import CameraView, Geom, ObjectSpec, Scene, Table
from icub_datasets.rendered import hand, objects, tabletop
from icub_datasets.rendered.base import RenderedDataset
from icub_datasets.rendered.hand import Grip, grips_of, hand_around
from icub_datasets.rendered.objects import CLUTTER, HANDHELD, target_object
from icub_datasets.rendered.tabletop import arrange
from icub_support import appearance
from icub_support.appearance import random_lights, random_surface

GRIP_FRAMES = 8
"""Frames until the teacher takes the object another way, so that all its sides come into view."""
GRIPS = 4
"""Ways in which one object is held in a sequence."""
DISTANCE = (0.42, 0.68)
CAMERA = (0.25, 0.0, 1.40)
LOOKS_AT = (-0.60, 0.0, 1.22)
SKIN = ((0.95, 0.78, 0.67), (0.87, 0.66, 0.52), (0.72, 0.50, 0.36), (0.52, 0.35, 0.24), (0.36, 0.24, 0.17))
TURN = 0.35
"""Rotation about the forearm between two frames, radians."""


class RenderedHandheld(RenderedDataset):
    """Nine objects, one in a frame, held by a hand that moves and turns them before a fixed camera.

    The objects come one after another, each in as many frames as the next; the hand changes its grip every 8 frames.
    ``train`` is one room with one teacher; every sequence of ``test`` and ``val`` is in a room and with a person of
    its own. Things that are never taught stand in the background. Instances are the visible pixels (ground truth of
    the simulator).

    Args:
        split: ``"train"``, ``"val"`` or ``"test"``.
        frames: Number of frames.
        seed: Decides everything random.
        width: Pixels.
        height: Pixels.
        engine: Registry name of the simulator that renders.
    """

    def __init__(
        self,
        split: str = "train",
        frames: int = 300,
        seed: int = 0,
        width: int = 320,
        height: int = 240,
        engine: str = "mujoco",
    ) -> None:
        sources = (__file__, objects.__file__, hand.__file__, tabletop.__file__, appearance.__file__)
        each = max(1, -(-frames // len(HANDHELD)))
        super().__init__(HANDHELD, split, frames, each, seed, (width, height), engine, sources)
        self._grips: list[Grip] = []

    def _objects(self) -> tuple[ObjectSpec, ...]:
        return tuple(target_object(name) for name in (*HANDHELD, *CLUTTER))

    def _load(self, simulator: Simulator, sequence: int) -> None:
        room = self._rng(1, 0 if self._split == "train" else sequence)
        target = target_object(HANDHELD[sequence])
        skin = SKIN[int(room.integers(len(SKIN)))]
        table = Table(center=(-0.9, 0.0, 0.9), half_size=(0.45, 1.2, 0.05), material=random_surface(room))
        clutter = tuple(target_object(CLUTTER[i]) for i in room.permutation(len(CLUTTER))[:3])
        wall = _wall(room)
        lights = random_lights(room)
        floor = random_surface(room)
        stands = arrange(clutter, table, room)

        # a few grips that follow one another in random order, from this sequence's own stream
        rng = self._rng(2, sequence)
        possible = grips_of(target.half_extents)
        self._grips = [possible[i] for i in rng.permutation(len(possible))[:GRIPS]]
        hands = tuple(hand_around(target.half_extents, g, _hand_name(i), skin) for i, g in enumerate(self._grips))
        scene = Scene(objects=(target, *hands, *clutter, wall), table=table, lights=lights, floor=floor)
        simulator.load(None, scene)
        simulator.reset()
        simulator.set_object_pose(wall.name, make_transform(None, [-1.7, 0.0, 1.2]))
        for name, T_world_object in stands.items():
            simulator.set_object_pose(name, T_world_object)

    def _image(self, simulator: Simulator, sequence: int, moment: int) -> Rendering:
        chosen = moment // GRIP_FRAMES % len(self._grips)
        T_world_object = self._pose(self._grips[chosen], sequence, moment)
        simulator.set_object_pose(HANDHELD[sequence], T_world_object)
        for i in range(len(self._grips)):
            if i == chosen:
                simulator.set_object_pose(_hand_name(i), T_world_object)
            else:
                simulator.park_object(_hand_name(i))
        view = CameraView(look_at(CAMERA, LOOKS_AT))
        return simulator.render(view, *self._size, segmentation=True, shadows=True)

    def _pose(self, grip: Grip, sequence: int, moment: int) -> NDArray[np.float64]:
        """Return T_world_object: a slow path before the camera, the forearm away from it or downwards."""
        rng = self._rng(3, sequence)
        speed, phase = rng.uniform(0.5, 1.5, 5), rng.uniform(0, 2 * math.pi, 5)
        sines = np.sin(speed * 0.25 * moment + phase)
        T_world_camera = look_at(CAMERA, LOOKS_AT)
        distance = DISTANCE[0] + (DISTANCE[1] - DISTANCE[0]) * 0.5 * (1 + sines[0])
        seen_at = np.array([0.20 * sines[1], 0.10 * sines[2], 1.0]) * distance
        position = T_world_camera[:3, :3] @ seen_at + T_world_camera[:3, 3]
        # camera axes: x right, y down, z away from the camera
        pitch, sideways = 0.35 + 0.9 * 0.5 * (1 + sines[3]), 0.7 * sines[4]
        arm = T_world_camera[:3, :3] @ [
            math.sin(sideways),
            math.cos(sideways) * math.sin(pitch),
            math.cos(sideways) * math.cos(pitch),
        ]
        turn = phase[0] + TURN * moment
        return make_transform(_aim(grip.arm_direction, arm) @ _about(grip.arm_direction, turn), position)


def _hand_name(grip: int) -> str:
    return f"hand_{grip}"


def _wall(rng: np.random.Generator) -> ObjectSpec:
    """Return the wall behind the teacher."""
    half = (0.02, 2.0, 1.5)
    return ObjectSpec("wall", (Geom("box", half),), 50.0, half, half[2], material=random_surface(rng))


def _about(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) by `angle` about one of the six axis directions."""
    index = int(np.argmax(np.abs(axis)))
    return rotation_about("xyz"[index], angle * float(np.sign(axis[index])))


def _aim(direction: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation (3, 3) that takes the unit vector `direction` to the unit vector `target`."""

    def frame(z: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.eye(3)[int(np.argmin(np.abs(z)))]
        y = np.cross(z, x)
        y /= np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z], axis=1)

    return frame(target) @ frame(direction).T
