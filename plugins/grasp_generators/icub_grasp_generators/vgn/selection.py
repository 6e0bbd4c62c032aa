"""From the network's outputs to a short list of grasps: smooth, mask, threshold, keep the best of every neighborhood.

Source: Breyer et al. 2020 and the released code's detection. DIFF: there, local maxima alone are kept; a smooth quality
has one or two, and an arm often reaches neither. Here a voxel is kept unless a better one within 1.5 cm was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

SMOOTHING = 1.0
"""Standard deviation of the Gaussian over the quality, voxels."""
SURFACE_REACH = 2
"""Voxels that a grasp may lie beyond what was measured as outside of the surface."""
WIDTHS = (1.33, 9.33)
"""Openings that the gripper has, voxels of 7.5 mm."""
SUPPRESSED = 2
"""Voxels along each axis around a chosen one from which no other is chosen."""
MOST = 64
"""Voxels chosen of one field."""
_INSIDE = 1e-3


@dataclass(frozen=True, eq=False)
class Selected:
    """The best voxels, best first.

    Attributes:
        index: (K, 3).
        quality: (K,) 0..1, smoothed.
        quaternion: (K, 4) xyzw.
        width: (K,) voxels.
    """

    index: NDArray[np.intp]
    quality: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    width: NDArray[np.float64]


def select(
    tsdf: NDArray[np.float32],
    quality: NDArray[np.float32],
    rotation: NDArray[np.float32],
    width: NDArray[np.float32],
    *,
    threshold: float,
    widths: tuple[float, float] | None = WIDTHS,
) -> Selected:
    """Choose voxels.

    Args:
        tsdf: (40, 40, 40), as `Volume.tsdf` returns it.
        quality: (40, 40, 40), 0..1.
        rotation: (4, 40, 40, 40) unit quaternions xyzw.
        width: (40, 40, 40) voxels.
        threshold: Least smoothed quality.
        widths: Openings that are possible; None takes any.
    """
    smooth = ndimage.gaussian_filter(quality.astype(np.float64), SMOOTHING, mode="nearest")
    smooth[~near_surface(tsdf)] = 0.0
    if widths is not None:
        smooth[(width < widths[0]) | (width > widths[1])] = 0.0
    smooth[smooth < threshold] = 0.0
    index = _best_apart(smooth)
    i, j, k = index.T
    return Selected(
        index, smooth[i, j, k], rotation[:, i, j, k].T.astype(np.float64), width[i, j, k].astype(np.float64)
    )


def _best_apart(quality: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return voxels (K, 3) with a quality above 0, best first, none within `SUPPRESSED` of a better one."""
    candidates = np.argwhere(quality > 0)
    candidates = candidates[np.argsort(-quality[tuple(candidates.T)], kind="stable")]
    free, chosen = np.ones(quality.shape, dtype=np.bool_), []
    for i, j, k in candidates:
        if free[i, j, k]:
            chosen.append((i, j, k))
            low_i, low_j, low_k = max(i - SUPPRESSED, 0), max(j - SUPPRESSED, 0), max(k - SUPPRESSED, 0)
            free[low_i : i + SUPPRESSED + 1, low_j : j + SUPPRESSED + 1, low_k : k + SUPPRESSED + 1] = False
            if len(chosen) == MOST:
                break
    return np.array(chosen, dtype=np.intp).reshape(-1, 3)


def near_surface(tsdf: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Say which voxels lie outside of the surface and at most `SURFACE_REACH` beyond the measured band."""
    outside = tsdf > 0.5
    inside = (tsdf > _INSIDE) & (tsdf < 0.5)
    return np.asarray(ndimage.binary_dilation(outside, iterations=SURFACE_REACH, mask=~inside))
