"""Geometry of convex pieces: volumes, hulls, and the pose in which a body comes to rest on a table."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from icub_core.errors import DataError
from icub_core.geometry import matrix_to_quat_wxyz
from icub_core.scene import RestPose

FloatArray = NDArray[np.float64]

STABLE_TILT = np.deg2rad(8.0)
"""A rest pose has to withstand being tilted by this much."""
COPLANAR = 1e-3
"""Hull triangles whose unit normals differ by less belong to one facet."""


def hull_volume(points: FloatArray) -> float:
    """Volume of the convex hull of (N, 3) points, cubic meters; 0 for flat ones."""
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def oriented_hull(points: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the corners (V, 3) of the convex hull of (N, 3) points and its triangles (F, 3), counterclockwise."""
    hull = ConvexHull(points)
    order = np.full(len(points), -1)
    order[hull.vertices] = np.arange(len(hull.vertices))
    faces = order[hull.simplices]
    corners = points[hull.vertices]
    # qhull leaves the winding open; outward is where the facet's normal points
    a, b, c = (corners[faces[:, i]] for i in range(3))
    flip = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[flip] = faces[flip][:, ::-1]
    return corners, faces


def center_of_mass(pieces: list[FloatArray]) -> FloatArray:
    """Center of mass (3,) of convex pieces, each (N_i, 3), at one density."""
    total, moment = 0.0, np.zeros(3)
    for points in pieces:
        hull = ConvexHull(points)
        middle = points[hull.vertices].mean(axis=0)
        tetrahedra = points[hull.simplices] - middle  # (T, 3, 3): with `middle` as fourth corner
        volumes = np.abs(np.linalg.det(tetrahedra)) / 6
        total += float(volumes.sum())
        moment += (volumes[:, None] * (tetrahedra.sum(axis=1) / 4 + middle)).sum(axis=0)
    return moment / total


def stable_poses(points: FloatArray, center: FloatArray) -> Iterator[tuple[RestPose, float]]:
    """Yield the poses in which a body can stand on a horizontal plane, lowest center of mass first, with their tilt.

    Every facet of the hull is a candidate. The tilt is the angle by which the body can be turned about the facet's
    nearest edge before it falls over; negative where it falls by itself.

    Args:
        points: (N, 3) points of the body, in its frame, meters.
        center: (3,) center of mass.

    Raises:
        DataError: When the points span no volume.
    """
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise DataError("the points span no volume; a rest pose needs a solid body") from error
    facets = _facets(hull)
    largest = np.unique(facets, return_index=True)[1]  # one triangle of each facet stands for its plane
    normals = hull.equations[largest, :3]
    heights = -(hull.equations[largest, 3] + normals @ center)  # of the center of mass above the plane
    size = np.bincount(facets)
    margins = _triangle_margins(points[hull.simplices[largest]], normals, center)
    for index in np.argsort(heights, kind="stable"):
        margin = float(margins[index])
        if size[index] > 1:
            margin = _margin(points[np.unique(hull.simplices[facets == index])], normals[index], center)
        R = rotation_taking(normals[index], np.array([0.0, 0.0, -1.0]))
        w, x, y, z = (float(v) for v in matrix_to_quat_wxyz(R))
        yield RestPose((w, x, y, z), -float((points @ R[2]).min())), float(np.arctan2(margin, heights[index]))


def _facets(hull: ConvexHull) -> NDArray[np.intp]:
    """Number the facets: neighboring triangles with the same normal belong to one."""
    normals = hull.equations[:, :3]
    n = len(normals)
    first = np.repeat(np.arange(n), 3)
    second = hull.neighbors.ravel()
    same = np.abs(normals[first] - normals[second]).max(axis=1) < COPLANAR
    links = coo_array((np.ones(same.sum()), (first[same], second[same])), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.intp)


def _triangle_margins(corners: FloatArray, normals: FloatArray, center: FloatArray) -> FloatArray:
    """Signed distance from the projected center to the nearest edge of each triangle (F, 3, 3), positive inside."""
    middle = corners.mean(axis=1)
    margins = np.full(len(corners), np.inf)
    for i in range(3):
        start, edge = corners[:, i], corners[:, (i + 1) % 3] - corners[:, i]
        inward = np.cross(normals, edge)
        inward *= np.sign(np.einsum("fi,fi->f", inward, middle - start))[:, None]
        length = np.maximum(np.linalg.norm(inward, axis=1), 1e-300)
        margins = np.minimum(margins, np.einsum("fi,fi->f", inward, center - start) / length)
    return margins


def rest_pose(points: FloatArray, center: FloatArray) -> RestPose:
    """Return the lowest pose that withstands `STABLE_TILT`, or the steadiest one where none does.

    Args:
        points: (N, 3) points of the body, in its frame, meters.
        center: (3,) center of mass.

    Raises:
        DataError: When the points span no volume.
    """
    best, best_tilt = None, -np.inf
    for pose, tilt in stable_poses(points, center):
        if tilt >= STABLE_TILT:
            return pose
        if best is None or tilt > best_tilt:
            best, best_tilt = pose, tilt
    assert best is not None  # a hull has facets
    return best


def rotation_taking(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) with R a = b for unit vectors (the shortest one, where it is unique)."""
    cosine = float(a @ b)
    if cosine < -1 + 1e-9:
        other = np.eye(3)[int(np.argmin(np.abs(a)))]
        axis = np.cross(a, other)
        axis /= np.linalg.norm(axis)
        return 2 * np.outer(axis, axis) - np.eye(3)
    x, y, z = np.cross(a, b)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + K + K @ K / (1 + cosine)


def narrowest_width(points_xy: FloatArray) -> float:
    """Smallest distance between two parallel lines that enclose (N, 2) points: what a hand has to span."""
    corners = points_xy[ConvexHull(points_xy).vertices]
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    spans = corners @ normals.T  # (corners, edges): the narrowest strip has one side along an edge
    return float((spans.max(axis=0) - spans.min(axis=0)).min())


def _margin(facet: FloatArray, normal: FloatArray, center: FloatArray) -> float:
    """Distance from the projected center of mass to the nearest edge of the facet; negative outside of it."""
    u = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    u /= np.linalg.norm(u)
    basis = np.stack([u, np.cross(normal, u)], axis=1)  # (3, 2)
    try:
        polygon = ConvexHull((facet - center) @ basis)
    except (QhullError, ValueError):
        return -np.inf
    return float(-polygon.equations[:, 2].max())  # lines n x + d <= 0 inside; the center is the origin
