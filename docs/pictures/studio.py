"""Light, furniture and files of the documentation's images."""

from __future__ import annotations

import io
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

import icub_core as icub
from icub_core.geometry import look_at, make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.scene import CameraView, Light, Material, ObjectSpec, Scene, Table

Image = NDArray[np.uint8]
FOLDER = Path(__file__).parents[1] / "images"
MAX_PNG, MAX_GIF = 150_000, 1_500_000
KEY = Light(direction=(0.45, -0.5, -1.0), diffuse=(0.42, 0.42, 0.42), ambient=(0.26, 0.26, 0.26))
FILL = Light(direction=(0.7, 0.8, -0.6), diffuse=(0.22, 0.22, 0.22), ambient=(0.26, 0.26, 0.26))
STUDIO = (KEY, FILL)
WALL = Material(rgba=(0.80, 0.83, 0.87, 1.0))
FLOOR = Material(rgba=(0.55, 0.58, 0.62, 1.0))
WOOD = Material(rgba=(0.60, 0.47, 0.35, 1.0))
WOODEN_TABLE = Table(material=WOOD)

logger = logging.getLogger(__name__)


def save_png(name: str, image: Image) -> None:
    """Write a PNG of 256 colors, smaller until it fits into the limit."""
    path, picture = FOLDER / f"{name}.png", Pillow.fromarray(image)
    while True:
        buffer = io.BytesIO()
        # a palette refined by a few rounds of k-means: the median cut alone turns skin and wood gray
        picture.quantize(256, kmeans=4, dither=Pillow.Dither.NONE).save(buffer, "png", optimize=True)
        if buffer.tell() <= MAX_PNG:
            path.write_bytes(buffer.getvalue())
            logger.info("%s: %d x %d, %d kB", path, *picture.size, buffer.tell() // 1000)
            return
        picture = picture.resize((int(0.9 * picture.width), int(0.9 * picture.height)), Pillow.Resampling.LANCZOS)


def save_gif(name: str, stills: Sequence[Image], video: Sequence[Image], seconds: Sequence[float]) -> None:
    """Write an endless GIF of still images and a video, smaller until it fits into the limit."""
    path, width = FOLDER / f"{name}.gif", video[0].shape[1]
    while True:
        size = (width, round(width * video[0].shape[0] / video[0].shape[1]))
        small = [Pillow.fromarray(f).resize(size, Pillow.Resampling.LANCZOS) for f in (*stills, *video)]
        # one palette for the video: what does not move stays the same and compresses to nothing
        middle = small[len(stills) + len(video) // 2].quantize(128, kmeans=4)
        drawn = [f.quantize(128, kmeans=2, dither=Pillow.Dither.NONE) for f in small[: len(stills)]]
        drawn += [f.quantize(palette=middle, dither=Pillow.Dither.NONE) for f in small[len(stills) :]]
        buffer = io.BytesIO()
        durations = [int(1000 * s) for s in seconds]
        drawn[0].save(buffer, "gif", save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=False)
        if buffer.tell() <= MAX_GIF:
            path.write_bytes(buffer.getvalue())
            logger.info("%s: %d x %d, %d frames, %d kB", path, *size, len(drawn), buffer.tell() // 1000)
            return
        width = int(0.92 * width)


@dataclass
class Studio:
    """A loaded simulator with its robot, and a friendly light."""

    simulator: Simulator
    robot: Robot

    @classmethod
    def open(cls, objects: Sequence[ObjectSpec] = (), table: bool = True, **robot: object) -> Studio:
        """Load the robot, the table and `objects`."""
        body = icub.load("robot", "icub", **robot)
        simulator = icub.load("simulator", "mujoco")
        simulator.load(body.description, room(objects, WOODEN_TABLE if table else None))
        simulator.reset()
        return cls(simulator, body)

    def shot(
        self,
        eye: Sequence[float],
        target: Sequence[float],
        fovy: float,
        size: tuple[int, int] = (320, 240),
        shadows: bool = True,
    ) -> Image:
        """Photograph from a free place, twice as large and halved again: smooth edges."""
        view = CameraView(look_at(eye, target), fovy)
        large = self.simulator.render(view, 2 * size[0], 2 * size[1], shadows=shadows).frame.rgb
        return np.asarray(cv2.resize(large, size, interpolation=cv2.INTER_AREA), np.uint8)

    def put(self, item: ObjectSpec, x: float, y: float, yaw: float = 0.0) -> None:
        """Stand an object on the table."""
        R = rotation_about("z", yaw) @ quat_wxyz_to_matrix(item.rest_quat_wxyz)
        self.simulator.set_object_pose(item.name, make_transform(R, [x, y, Table().top + item.rest_height]))


def room(objects: Sequence[ObjectSpec], table: Table | None = WOODEN_TABLE) -> Scene:
    """Return the studio with its light, a table and objects."""
    return Scene(tuple(objects), table, lights=STUDIO, floor=FLOOR, backdrop=WALL)


def ycb(*names: str) -> list[ObjectSpec]:
    """Return objects of the set ycb_primitives; all of them when none is named."""
    objects = icub.load("objects", "ycb_primitives")
    return [objects.get(name) for name in names or objects.names]


def halved(image: Image) -> Image:
    """Return an image of 320 x 240."""
    return np.asarray(cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA), np.uint8)
