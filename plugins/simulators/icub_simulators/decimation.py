"""Quadric vertex clustering: a mesh in few faces, in one vectorized pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.geometry import FloatArray

IntArray = NDArray[np.int64]

_FINEST, _COARSEST = 200, 2  # grid cells along the longest side
_FLATNESS = 1e-2
"""Singular values of a cell's quadric below this share of the largest are taken for a plane or an edge."""


def decimate(vertices: FloatArray, faces: IntArray, max_faces: int) -> tuple[FloatArray, IntArray]:
    """Return a mesh of at most about `max_faces` triangles near the surface of the given one.

    Vertices that fall into one cell of a cubic grid become one vertex, put where the sum of squared distances to the
    planes of the cell's triangles is least. The grid is the finest that keeps to the limit.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
        max_faces: Limit; a mesh below it is returned as it is, with equal vertices merged.

    Returns:
        Vertices (V', 3) and faces (F', 3).

    Source: Lindstrom, "Out-of-core simplification of large polygonal models", 2000.
    """
    vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
    faces = _proper(inverse.reshape(-1)[faces])
    if len(faces) <= max_faces:
        return vertices, faces
    low, high = _COARSEST, _FINEST
    while low < high:  # the finest grid within the limit
        cells = (low + high + 1) // 2
        if len(_proper(_cells(vertices, cells)[faces])) <= max_faces:
            low = cells
        else:
            high = cells - 1
    cell = _cells(vertices, low)
    return _representatives(vertices, faces, cell), _proper(cell[faces])


def _cells(vertices: FloatArray, along: int) -> IntArray:
    """Number the occupied grid cells: (V,) index of each vertex's cell."""
    low = vertices.min(axis=0)
    step = float(np.ptp(vertices, axis=0).max()) / along * (1 + 1e-9)
    grid = ((vertices - low) / step).astype(np.int64)
    key = (grid[:, 0] * (along + 1) + grid[:, 1]) * (along + 1) + grid[:, 2]
    return np.unique(key, return_inverse=True)[1].reshape(-1)


def _proper(faces: IntArray) -> IntArray:
    """Drop triangles that have collapsed, and doubles."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    start = np.argmin(faces, axis=1)[:, None]
    turned = np.take_along_axis(faces, (start + np.arange(3)) % 3, axis=1)  # the same triangle starts with one corner
    return np.unique(turned, axis=0)


def _representatives(vertices: FloatArray, faces: IntArray, cell: IntArray) -> FloatArray:
    """Return the position of one vertex per cell."""
    count = int(cell.max()) + 1
    members = np.bincount(cell, minlength=count).astype(np.float64)
    mean = np.stack([np.bincount(cell, vertices[:, i], count) for i in range(3)], axis=1) / members[:, None]
    corners = vertices[faces]  # (F, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # length: twice the area
    A, b = np.zeros((count, 3, 3)), np.zeros((count, 3))
    outer = np.einsum("fi,fj->fij", normals, normals)
    for corner in range(3):
        where = cell[faces[:, corner]]
        offset = np.einsum("fi,fi->f", normals, corners[:, corner] - mean[where])
        np.add.at(A, where, outer)
        np.add.at(b, where, normals * offset[:, None])
    values, vectors = np.linalg.eigh(A)
    kept = values > _FLATNESS * values[:, -1:]
    inverse = np.where(kept & (values > 0), 1.0 / np.where(values > 0, values, 1.0), 0.0)
    shift = np.einsum(
        "nij,nj,nkj,nk->ni", vectors, inverse, vectors, b
    )  # moves off the mean only where planes ask for it
    spread = np.zeros(count)
    np.maximum.at(spread, cell, np.linalg.norm(vertices - mean[cell], axis=1))
    length = np.linalg.norm(shift, axis=1)
    shift *= np.minimum(1.0, spread / np.maximum(length, 1e-12))[:, None]  # nearly parallel planes meet far away
    return mean + shift
