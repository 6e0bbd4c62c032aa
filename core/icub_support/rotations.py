"""Rotations that are spread evenly over all of them."""

from __future__ import annotations

import numpy as np

from icub_core.geometry import FloatArray, quat_wxyz_to_matrix


def spread_rotations(count: int) -> FloatArray:
    """Return `count` rotations (count, 3, 3) that are spread evenly over all of them; always the same ones.

    Source: super-Fibonacci spirals, Alexa 2022.
    """
    s = np.arange(count) + 0.5
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    r, big_r = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return quat_wxyz_to_matrix(
        np.stack([r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)], axis=1)
    )
