"""Hand poses around the voxels that the network found: more ways for the hand to come than the one a voxel names."""

from __future__ import annotations

import numpy as np

from icub_core.data import PointCloud
from icub_core.geometry import FloatArray
from icub_grasp_generators.clouds import CLOUD_POINTS, thin
from icub_grasp_generators.vgn.exploration import MIN_GRIPPED, draw_poses, fitted, gripped_share

DRAWN = 1500
"""Poses drawn around all voxels together."""
MAX_SCORED = 300
"""Of those that keep clear, at most so many are scored."""


def around(points: FloatArray, cloud: PointCloud) -> FloatArray:
    """Draw poses (C, 4, 4) of a right hand whose palm points are near points (K, 3), as trials draw them.

    Half of them are moved so that the cloud lies between the fingers; those with next to nothing to grip are left out.
    The same input gives the same poses.
    """
    rng, surface = np.random.default_rng(0), thin(cloud.points, CLOUD_POINTS)
    drawn = draw_poses(points, rng, DRAWN)
    drawn[::2] = fitted(drawn[::2], surface, rng)
    return drawn[gripped_share(drawn, surface) >= MIN_GRIPPED]
