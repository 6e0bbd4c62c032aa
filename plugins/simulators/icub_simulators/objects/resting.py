"""How bodies come to rest: they are dropped on a plane in every orientation, in a physics engine.

Only the hull meets the plane, so one convex mesh collides; the pieces give the center of mass and the inertia. Contacts
are soft, which leaves a body tilted by a fraction of a degree: the facet of the hull that is nearest to where a drop
ended is what the body stands on.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from icub_core.errors import DataError
from icub_core.geometry import FloatArray, matrix_to_quat_wxyz, quat_wxyz_to_matrix
from icub_core.scene import RestPose
from icub_simulators.objects.solids import center_of_mass, hull_volume, stable_poses
from icub_support.cache import Arrays, cached_arrays, content_key
from icub_support.rotations import spread_rotations

logger = logging.getLogger(__name__)

DROPS = 64
CLEARANCE = 0.01
"""Meters between a body and the plane when it is let go."""
TIMESTEP, SUBSTEPS = 0.004, 10
LONGEST = 5.0
"""Seconds that a drop may take; a body that still moves then has no say."""
STILL_MOVE, STILL_TILT = 1e-3, np.deg2rad(1.0)
"""Meters and radians that a body may stray (soft contacts make light ones tremble) ..."""
STILL_LOOKS = 8
"""... in so many looks, 40 ms apart, to count as being at rest."""
FRICTION = (0.5, 0.005, 0.002)
"""Sliding, torsional, rolling. Rolling friction ends the rolling of round bodies."""
DENSITY = 500.0
"""kg/m^3; where a body comes to rest hardly depends on it."""
ALIKE, LEVEL = np.deg2rad(20.0), 0.02
"""Facets tilted by less against each other, on which the center of mass is as high but for this share, are one way to
lie: the side of a can that is made of flat faces."""


def rest_poses(pieces: list[FloatArray]) -> tuple[RestPose, ...]:
    """Drop a body and return how it lies then, most frequent first; kept by content, as the convex pieces are.

    Args:
        pieces: (N_i, 3) vertices of its convex pieces, meters, in the body's frame.

    Returns:
        Poses with the shares of drops that ended so. Empty when no drop came to rest.

    Raises:
        DataError: The pieces span no volume.
    """
    if hull_volume(np.concatenate(pieces)) == 0:
        raise DataError("the points span no volume; a rest pose needs a solid body")
    key = content_key(*(np.ascontiguousarray(p).tobytes() for p in pieces), DROPS, "drops-1")

    def compute() -> Arrays:
        rotations, settled = drop(pieces, spread_rotations(DROPS))
        if not settled.all():
            logger.warning("%d of %d drops of a body did not come to rest", int((~settled).sum()), DROPS)
        poses = _clustered(pieces, rotations[settled, 2])
        return {
            "quat_wxyz": np.array([pose.quat_wxyz for pose in poses]).reshape(-1, 4),
            "height": np.array([pose.height for pose in poses]),
            "share": np.array([pose.share for pose in poses], dtype=np.float64),
        }

    arrays = cached_arrays("rest", key, compute)
    found = []
    for quat, height, share in zip(arrays["quat_wxyz"], arrays["height"], arrays["share"], strict=True):
        w, x, y, z = (float(v) for v in quat)
        found.append(RestPose((w, x, y, z), float(height), float(share)))
    return tuple(found)


def drop(pieces: list[FloatArray], rotations: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Let a body go just above a plane, from rest.

    Args:
        pieces: (N_i, 3) vertices of its convex pieces, meters.
        rotations: (K, 3, 3) orientations to start from.

    Returns:
        Rotations (K, 3, 3) at the end, and whether the body had come to rest (K,) bool.
    """
    import mujoco

    everything = np.concatenate(pieces)
    model = _world(pieces)
    data = mujoco.MjData(model)
    ends, settled = np.empty_like(rotations), np.zeros(len(rotations), dtype=bool)
    for i, R in enumerate(rotations):
        mujoco.mj_resetData(model, data)
        data.qpos[:3] = (0.0, 0.0, CLEARANCE - float((everything @ R[2]).min()))
        data.qpos[3:7] = matrix_to_quat_wxyz(R)
        looks, place, up = 0, np.full(3, np.inf), np.zeros(3)
        while data.time < LONGEST and looks < STILL_LOOKS:
            mujoco.mj_step(model, data, nstep=SUBSTEPS)
            ends[i] = quat_wxyz_to_matrix(data.qpos[3:7])
            looks += 1
            if np.abs(data.qpos[:3] - place).max() > STILL_MOVE or ends[i, 2] @ up < np.cos(STILL_TILT):
                looks, place, up = 0, data.qpos[:3].copy(), ends[i, 2].copy()
        settled[i] = looks == STILL_LOOKS
    return ends, settled


def _world(pieces: list[FloatArray]) -> object:
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5.0, 5.0, 0.1], condim=6, friction=FRICTION)
    body = spec.worldbody.add_body()
    body.add_freejoint()

    def add(name: str, points: FloatArray, **geom: object) -> None:
        mesh = spec.add_mesh(name=name, uservert=points[ConvexHull(points).vertices].ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, **geom)

    for number, points in enumerate(pieces):
        add(f"piece {number}", points, density=DENSITY, contype=0, conaffinity=0)
    add("hull", np.concatenate(pieces), mass=0.0, condim=6, friction=FRICTION)
    return spec.compile()


def _clustered(pieces: list[FloatArray], up: FloatArray) -> list[RestPose]:
    """Count what the body stands on when the vertical, in its frame, is `up` (K, 3) at the ends of its drops."""
    points, center = np.concatenate(pieces), center_of_mass(pieces)
    facets = list(stable_poses(points, center))
    facet_up = np.array([quat_wxyz_to_matrix(pose.quat_wxyz)[2] for pose, _ in facets])
    height = np.array([pose.height for pose, _ in facets]) + facet_up @ center
    counts = np.bincount(np.argmax(up @ facet_up.T, axis=1), minlength=len(facets))
    rolls = (facet_up @ facet_up.T > np.cos(ALIKE)) & (np.abs(height[:, None] / height - 1.0) < LEVEL)
    _, group = connected_components(rolls, directed=False)
    found = []
    for number in np.unique(group[counts > 0]):
        members = np.flatnonzero((group == number) & (counts > 0))
        pose, _ = facets[max(members, key=lambda facet: facets[facet][1])]
        found.append(RestPose(pose.quat_wxyz, pose.height, float(counts[members].sum()) / len(up)))
    found.sort(key=lambda pose: (-(pose.share or 0.0), pose.height))
    return found
