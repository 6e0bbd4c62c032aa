"""Ground truth without a labeller: the blob closest to the camera, kept where consecutive frames agree.

Source: thesis 11.8 (Automatic Data Acquisition).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame

Mask = NDArray[np.bool_]

MINIMUM_PIXELS = 150
"""A smaller blob is noise, or an object too far away to be taught."""
MAX_SHARE = 0.4
"""A blob that covers more of the image is the room, or an object held too close."""
DEPTH_EXTENT = 0.22
"""How far behind its nearest point a hand-held object may reach, meters."""
DEPTH_STEP = 0.025
"""A larger jump between neighboring pixels separates two surfaces, meters."""


def closest_blob(depth: NDArray[np.float32]) -> Mask | None:
    """Segment the object nearest to the camera.

    Args:
        depth: (H, W) float32, meters, 0 where nothing was measured.

    Returns:
        (H, W) bool, or None when nothing large enough stands out.
    """
    valid = np.isfinite(depth) & (depth > 0)
    if np.count_nonzero(valid) < MINIMUM_PIXELS:
        return None
    # the nearest few pixels may be speckle: take the depth that MINIMUM_PIXELS pixels are nearer than
    nearest = np.partition(depth[valid], MINIMUM_PIXELS - 1)[MINIMUM_PIXELS - 1]
    candidate = valid & (depth < nearest + DEPTH_EXTENT)
    count, labels = cv2.connectedComponents((candidate & ~_depth_edges(depth)).astype(np.uint8), connectivity=4)
    sizes = np.bincount(labels.ravel(), minlength=count)
    large = [label for label in range(1, count) if sizes[label] >= MINIMUM_PIXELS]
    if not large:
        return None
    blob = labels == min(large, key=lambda label: float(np.percentile(depth[labels == label], 5)))
    if np.count_nonzero(blob) > MAX_SHARE * blob.size:
        return None
    return _with_rim(blob, depth, candidate)


def _depth_edges(depth: NDArray[np.float32]) -> Mask:
    """Mark the pixels whose right or lower neighbor lies on another surface."""
    edges = np.zeros(depth.shape, dtype=bool)
    edges[:, :-1] |= np.abs(np.diff(depth, axis=1)) > DEPTH_STEP
    edges[:-1, :] |= np.abs(np.diff(depth, axis=0)) > DEPTH_STEP
    return edges


def _with_rim(blob: Mask, depth: NDArray[np.float32], candidate: Mask) -> Mask:
    """Give back the pixels that the edge test took from the blob's own side of its outline, and close pinholes."""
    grown = cv2.dilate(blob.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    rim = grown & ~blob & candidate
    neighborhood = cv2.erode(np.where(blob, depth, np.float32(np.inf)), np.ones((3, 3), np.uint8))
    whole = blob | (rim & (np.abs(depth - neighborhood) < DEPTH_STEP))
    closed = cv2.morphologyEx(whole.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)).astype(bool)
    return closed & candidate


def overlap(first: Mask, second: Mask) -> float:
    """Return the intersection over union of two masks of one size; 0 for two empty ones."""
    union = np.count_nonzero(first | second)
    return np.count_nonzero(first & second) / union if union else 0.0


class CoherentMasks:
    """Passes on a frame only if its mask overlaps those of the frames before and after it.

    The decision on a frame falls when the next one arrives, so what comes out is one frame late.
    """

    def __init__(self, minimum_overlap: float = 0.5) -> None:
        """Keep frames whose masks overlap both neighbors by at least `minimum_overlap` (IoU)."""
        self.minimum_overlap = minimum_overlap
        self.rejected = 0
        self._pending: tuple[RgbdFrame, Mask] | None = None
        self._pending_agrees = False

    def push(self, frame: RgbdFrame, mask: Mask | None) -> tuple[RgbdFrame, Mask] | None:
        """Take the next frame of the stream; return the one before it if it is confirmed."""
        before, agreed_before = self._pending, self._pending_agrees
        if mask is None:
            self.rejected += 1 + (before is not None)
            self._pending, self._pending_agrees = None, False
            return None
        agrees = before is not None and overlap(before[1], mask) >= self.minimum_overlap
        # the first frame of a stream has no frame before it that could disagree
        self._pending, self._pending_agrees = (frame, mask), agrees or before is None
        if before is None:
            return None
        if agreed_before and agrees:
            return before
        self.rejected += 1
        return None
