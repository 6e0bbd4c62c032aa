"""Test images: taught objects among distractors on a table, never in the room where they were taught."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.geometry import look_at, make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.interfaces.simulator import Rendering, Simulator
from icub_core.scene import CameraView, ObjectSpec, Scene, Table
from icub_support.appearance import random_lights, random_surface

FRAMES_PER_ROOM = 5
"""Images taken before table, floor and lamps change."""
MINIMUM_VISIBLE_PIXELS = 80
"""An object that shows less is no fair question."""


@dataclass(frozen=True)
class Tabletop:
    """What the test images look like.

    Attributes:
        frames: How many.
        targets, distractors: Lowest and highest number of taught and never taught objects in an image.
        spread: Half side of the area on the table in which things stand, meters.
        nearest, farthest: Camera distance from the middle of that area, meters.
        width, height: Pixels.
    """

    frames: int = 50
    targets: tuple[int, int] = (2, 4)
    distractors: tuple[int, int] = (2, 4)
    spread: float = 0.22
    nearest: float = 0.55
    farthest: float = 0.85
    width: int = 320
    height: int = 240


def standing_pose(spec: ObjectSpec, x: float, y: float, table_top: float, yaw: float) -> NDArray[np.float64]:
    """Return T_world_object (4, 4) of an object in its rest pose at x, y, turned by `yaw` about the vertical."""
    R = rotation_about("z", yaw) @ quat_wxyz_to_matrix(spec.rest_quat_wxyz)
    return make_transform(R, [x, y, table_top + spec.rest_height])


def _footprint(spec: ObjectSpec) -> float:
    """Return the radius of a disc around the object's center that it stands within, meters."""
    extents = np.abs(quat_wxyz_to_matrix(spec.rest_quat_wxyz)) @ np.asarray(spec.half_extents)
    return float(np.hypot(extents[0], extents[1]))


def scatter(
    specs: Sequence[ObjectSpec], center: tuple[float, float], spread: float, rng: np.random.Generator
) -> dict[str, tuple[float, float]]:
    """Draw places on a table such that no two footprints overlap; what finds no room is left out."""
    placed: list[tuple[float, float, float]] = []
    places = {}
    for spec in specs:
        radius = _footprint(spec)
        for _ in range(60):
            x, y = (float(v) for v in np.asarray(center) + rng.uniform(-spread, spread, 2))
            if all(np.hypot(x - px, y - py) > radius + pr for px, py, pr in placed):
                placed.append((x, y, radius))
                places[spec.name] = (x, y)
                break
    return places


def visible_instances(image: Rendering, names: Sequence[str]) -> tuple[Instance, ...]:
    """Return the true instances that show enough pixels, from a rendering's segmentation."""
    assert image.segmentation is not None
    found = []
    for index, name in enumerate(names):
        mask = image.segmentation == index
        if np.count_nonzero(mask) >= MINIMUM_VISIBLE_PIXELS:
            found.append(Instance.from_mask(name, mask))
    return tuple(found)


def tabletop_images(
    simulator: Simulator,
    targets: Sequence[ObjectSpec],
    distractors: Sequence[ObjectSpec],
    tabletop: Tabletop,
    rng: np.random.Generator,
) -> Iterator[tuple[RgbdFrame, tuple[Instance, ...]]]:
    """Yield images and the true instances of all objects in them, distractors included.

    Args:
        simulator: Its world is replaced.
        targets: Taught objects.
        distractors: Objects that were never taught.
        tabletop: Numbers and ranges.
        rng: Decides everything random.
    """
    objects = (*targets, *distractors)
    names = [spec.name for spec in objects]
    scene = Scene(objects=objects)
    table = scene.table or Table()
    middle = (table.center[0] + 0.28, table.center[1])
    for number in range(tabletop.frames):
        if number % FRAMES_PER_ROOM == 0:
            furniture = replace(table, material=random_surface(rng))
            room = replace(scene, table=furniture, floor=random_surface(rng), lights=random_lights(rng))
            simulator.load(None, room)  # cameras stand anywhere, also where the robot's head would be in the way
        simulator.reset()
        drawn: list[ObjectSpec] = []
        for pool, (low, high) in ((targets, tabletop.targets), (distractors, tabletop.distractors)):
            count = min(int(rng.integers(low, high + 1)), len(pool))
            drawn += [pool[i] for i in rng.permutation(len(pool))[:count]]
        for name, (x, y) in scatter(drawn, middle, tabletop.spread, rng).items():
            spec = objects[names.index(name)]
            simulator.set_object_pose(name, standing_pose(spec, x, y, table.top, rng.uniform(0, 2 * np.pi)))
        image = simulator.render(
            CameraView(_viewpoint(middle, table.top, tabletop, rng)), tabletop.width, tabletop.height,
            segmentation=True, shadows=True,
        )  # fmt: skip
        yield image.frame, visible_instances(image, names)


def _viewpoint(
    middle: tuple[float, float], table_top: float, tabletop: Tabletop, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw T_world_camera of a camera on the robot's side of the table, 25 to 60 degrees above it."""
    target = np.array([*middle, table_top + 0.05]) + rng.uniform(-0.05, 0.05, 3)
    azimuth, elevation = rng.uniform(-1.0, 1.0), rng.uniform(0.44, 1.05)
    offset = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return look_at(target + rng.uniform(tabletop.nearest, tabletop.farthest) * offset, target)
