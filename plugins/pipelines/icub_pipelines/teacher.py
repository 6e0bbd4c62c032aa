"""The teacher: holds an object in front of the robot's head and turns it while the robot looks on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.geometry import make_transform, rotation_exp
from icub_core.interfaces.simulator import Simulator
from icub_pipelines.depth_masks import CoherentMasks, closest_blob

FRAMES_OF_A_ROUND = 60
"""Frames in which the hand goes once around its path."""
FRAME_RATE = 10.0
"""Frames a second that reach the robot."""


@dataclass(frozen=True)
class Showing:
    """How an object is shown.

    Attributes:
        frames: Images taken; a few are lost where masks disagree.
        nearest, farthest: Distance to the camera, meters.
        turn: Rotation between two frames, radians.
        width, height: Pixels.
    """

    frames: int = 60
    nearest: float = 0.32
    farthest: float = 0.62
    turn: float = 0.22
    width: int = 320
    height: int = 240


def _smooth_path(rng: np.random.Generator, frames: int) -> NDArray[np.float64]:
    """Return (frames, 3) values in -1..1 that drift like a hand: a sum of slow sines a coordinate.

    The speed does not depend on how many frames there are: a short showing is a piece of a long one.
    """
    t = np.arange(frames)[:, None] * (2 * np.pi / FRAMES_OF_A_ROUND)
    frequency = rng.uniform(0.5, 2.5, (2, 3))
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    return 0.5 * (np.sin(frequency[0] * t + phase[0]) + np.sin(frequency[1] * t + phase[1]))


def show(
    simulator: Simulator, name: str, showing: Showing, rng: np.random.Generator, camera: str
) -> Iterator[RgbdFrame]:
    """Move object `name` about in front of the head and yield what the camera sees.

    The gaze follows the blob that the robot itself found in the frame before (thesis 11.8), so it drifts as it would
    on the robot.

    Args:
        simulator: Loaded and reset, with the robot in its home pose.
        name: Object to show.
        showing: How.
        rng: Decides path and rotation.
        camera: Name of the robot's camera.
    """
    view = simulator.render(camera, showing.width, showing.height).frame.T_world_camera
    eye = view[:3, 3]
    # straight ahead and a little down: there the hands rest outside the image
    forward = view[:3, 2] * [1.0, 1.0, 0.0]
    forward /= np.linalg.norm(forward)
    side = np.array([-forward[1], forward[0], 0.0])
    path = _smooth_path(rng, showing.frames)
    distances = showing.nearest + (showing.farthest - showing.nearest) * (0.5 + 0.5 * path[:, 0])
    R = rotation_exp(rng.normal(0, 2, 3))
    axis = rng.normal(size=3)
    gaze: NDArray[np.float64] | None = None
    for i in range(showing.frames):
        axis += 0.4 * rng.normal(size=3)  # the wrist keeps changing its mind: all sides come into view
        R = rotation_exp(showing.turn * axis / np.linalg.norm(axis)) @ R
        position = eye + distances[i] * (
            forward + 0.25 * path[i, 1] * side + (0.15 * path[i, 2] - 0.3) * np.array([0, 0, 1.0])
        )
        simulator.set_object_pose(name, make_transform(R, position))
        image = simulator.render(
            camera, showing.width, showing.height, look_at=position if gaze is None else gaze
        ).frame
        frame = RgbdFrame(image.rgb, image.depth, image.intrinsics, image.T_world_camera, stamp=i / FRAME_RATE)
        mask = closest_blob(frame.depth)
        gaze = None if mask is None else np.median(frame.to_cloud(mask).points, axis=0)
        yield frame


def annotate(frames: Iterator[RgbdFrame], label: str) -> Iterator[tuple[RgbdFrame, Instance]]:
    """Pass on the frames whose depth blob agrees with its neighbors', annotated with it as `label`."""
    masks = CoherentMasks()
    for frame in frames:
        confirmed = masks.push(frame, closest_blob(frame.depth))
        if confirmed is not None:
            yield confirmed[0], Instance.from_mask(label, confirmed[1])
