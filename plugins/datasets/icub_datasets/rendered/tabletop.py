"""Rendered TARGET-TASK in the manner of YCB-Video: 21 objects on tables, hiding one another."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import look_at, make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.interfaces.simulator import Rendering, Simulator
from icub_core.scene import CameraView, ObjectSpec, Scene, Table
from icub_datasets.rendered import objects
from icub_datasets.rendered.base import RenderedDataset
from icub_datasets.rendered.objects import TABLETOP, target_object
from icub_support import appearance
from icub_support.appearance import random_lights, random_surface

SEQUENCE_FRAMES = 12
OBJECTS = (4, 8)
"""Lowest and highest number of objects on a table; YCB-Video has 3 to 9."""
SPREAD = 0.17
"""Half side of the area in which things stand, meters: tight, so that they hide one another."""
GAP = 0.006
"""Least distance between two objects' footprints, meters."""
DISTANCE = (0.48, 0.8)
ELEVATION = (0.35, 1.0)
SWEEP = 1.6
"""Turn of the camera about the table during a sequence, radians."""


class RenderedTabletop(RenderedDataset):
    """21 objects, 4 to 8 at a time on a table, seen by a camera that moves around them.

    A sequence of 12 frames keeps room, lamps and arrangement; the next has others, and those of ``test`` and ``val``
    never occur in ``train``. Objects are dealt from a shuffled deck, so that all are met about equally often.
    Instances are the visible pixels (ground truth of the simulator).

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
        sources = (__file__, objects.__file__, appearance.__file__)
        super().__init__(TABLETOP, split, frames, SEQUENCE_FRAMES, seed, (width, height), engine, sources)
        self._deals = self._deal()

    def _objects(self) -> tuple[ObjectSpec, ...]:
        return tuple(target_object(name) for name in TABLETOP)

    def _deal(self) -> list[list[str]]:
        """Deal the objects of every sequence; no object twice in one."""
        rng = self._rng(0)
        deals: list[list[str]] = []
        deck: list[str] = []
        for _ in range(-(-self._frames // SEQUENCE_FRAMES)):
            count = int(rng.integers(OBJECTS[0], OBJECTS[1] + 1))
            if len(deck) < count:
                fresh = [TABLETOP[i] for i in rng.permutation(len(TABLETOP))]
                # those still in the deck go first; their second copies must not meet them on one table
                deck = deck + [n for n in fresh if n not in deck] + [n for n in fresh if n in deck]
            deals.append(deck[:count])
            deck = deck[count:]
        return deals

    def _load(self, simulator: Simulator, sequence: int) -> None:
        rng = self._rng(1, sequence)
        specs = tuple(target_object(name) for name in self._deals[sequence])
        table = Table(material=random_surface(rng))
        floor, backdrop = random_surface(rng), random_surface(rng)
        scene = Scene(objects=specs, table=table, floor=floor, backdrop=backdrop, lights=random_lights(rng))
        simulator.load(None, scene)
        simulator.reset()
        for name, T_world_object in arrange(specs, table, rng).items():
            simulator.set_object_pose(name, T_world_object)

    def _image(self, simulator: Simulator, sequence: int, moment: int) -> Rendering:
        table = simulator.scene.table
        assert table is not None
        view = CameraView(self._viewpoint(table, sequence, moment))
        return simulator.render(view, *self._size, segmentation=True, shadows=True)

    def _viewpoint(self, table: Table, sequence: int, moment: int) -> NDArray[np.float64]:
        """Return T_world_camera on a smooth path around the table."""
        rng = self._rng(2, sequence)
        start, direction = rng.uniform(0, 2 * math.pi), rng.choice([-1.0, 1.0])
        phase, drift = rng.uniform(0, 2 * math.pi, 2), rng.uniform(-0.05, 0.05, (2, 3))
        t = moment / SEQUENCE_FRAMES
        azimuth = start + direction * SWEEP * t
        elevation = _between(ELEVATION, math.sin(phase[0] + 3.0 * t))
        distance = _between(DISTANCE, math.sin(phase[1] + 2.0 * t))
        middle = np.array([table.center[0], table.center[1], table.top + 0.05]) + (1 - t) * drift[0] + t * drift[1]
        offset = [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
        return look_at(middle + distance * np.array(offset), middle)


def arrange(specs: tuple[ObjectSpec, ...], table: Table, rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    """Stand objects in the middle of a table, close but not inside one another: name to T_world_object.

    The area grows when an object finds no room, so that all of them get a place.
    """
    placed: list[NDArray[np.float64]] = []
    poses = {}
    for spec in specs:
        rest = quat_wxyz_to_matrix(spec.rest_quat_wxyz)
        extents = np.abs(rest) @ np.asarray(spec.half_extents)
        spread = SPREAD
        while True:
            x, y = (float(v) for v in np.asarray(table.center[:2]) + rng.uniform(-spread, spread, 2))
            yaw = rng.uniform(0, 2 * math.pi)
            corners = _rectangle(x, y, extents[0] + GAP / 2, extents[1] + GAP / 2, yaw)
            if all(_apart(corners, other) for other in placed):
                break
            spread = min(spread * 1.01, 0.45)
        placed.append(corners)
        poses[spec.name] = make_transform(rotation_about("z", yaw) @ rest, [x, y, table.top + spec.rest_height])
    return poses


def _between(limits: tuple[float, float], sine: float) -> float:
    return limits[0] + (limits[1] - limits[0]) * 0.5 * (1 + sine)


def _rectangle(x: float, y: float, a: float, b: float, yaw: float) -> NDArray[np.float64]:
    """Return the corners (4, 2) of a rectangle of half sides a and b, in order."""
    R = rotation_about("z", yaw)[:2, :2]
    return np.array([[a, b], [-a, b], [-a, -b], [a, -b]]) @ R.T + [x, y]


def _apart(p: NDArray[np.float64], q: NDArray[np.float64]) -> bool:
    """Return True if two rectangles (4, 2) do not overlap: a separating axis runs along a side of one of them."""
    for corners in (p, q):
        for side in (corners[1] - corners[0], corners[2] - corners[1]):
            a, b = p @ side, q @ side
            if a.max() < b.min() or b.max() < a.min():
                return True
    return False
