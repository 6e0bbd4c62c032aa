"""What a stereo depth camera measures instead of the true depth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.interfaces.simulator import Rendering

BASELINE = 0.055
"""Meters between the two imagers of a RealSense D415."""
DISPARITY_NOISE = 0.08
"""Standard deviation of a measured disparity, pixels (the maker's figure for well textured surfaces)."""
DISPARITY_STEP = 1.0 / 32.0
"""Disparities are whole multiples of this, pixels."""
EDGE_JUMP = 1.0
"""Pixels of disparity between neighbors that make an edge, where matching windows see two surfaces."""
EDGE_LOSS = 0.6
"""Share of edge pixels that are not measured."""
FARTHEST = 10.0
"""Meters beyond which nothing is measured."""


class DepthNoise:
    """Noise of one camera, the same after every `reset`."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin the random numbers again."""
        self._rng = np.random.default_rng(0)

    def apply(self, rendering: Rendering) -> Rendering:
        """Return the image with measured instead of true depth."""
        frame = rendering.frame
        depth = stereo_depth(frame.depth, float(frame.intrinsics[0, 0]), self._rng)
        return Rendering(replace(frame, depth=depth), rendering.segmentation)


def stereo_depth(depth: NDArray[np.float32], focal: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Turn true depth into that of a stereo camera: noise and steps that grow with the square of distance, and holes.

    Holes are where the second imager, `BASELINE` to the right, sees something nearer, and along edges of depth.

    Args:
        depth: (H, W), meters, 0 where nothing is.
        focal: Pixels.
        rng: Draws the noise.

    Returns:
        (H, W) float32 meters, 0 where nothing was measured.
    """
    known = (depth > 0) & (depth < FARTHEST)
    disparity = np.where(known, focal * BASELINE / np.where(known, depth, 1.0), 0.0)
    in_second = np.arange(depth.shape[1]) - disparity  # column at which the second imager sees each pixel
    nearest_after = np.minimum.accumulate(in_second[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth.shape, dtype=bool)
    hidden[:, :-1] = in_second[:, :-1] >= nearest_after[:, 1:]
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(disparity, kernel) - cv2.erode(disparity, kernel) > EDGE_JUMP
    lost = edge & (rng.random(depth.shape) < EDGE_LOSS)
    measured = disparity + rng.normal(0.0, DISPARITY_NOISE, depth.shape)
    measured = np.round(measured / DISPARITY_STEP) * DISPARITY_STEP
    seen = known & ~hidden & ~lost & (measured > DISPARITY_STEP)
    return np.where(seen, focal * BASELINE / np.where(seen, measured, 1.0), 0.0).astype(np.float32)
