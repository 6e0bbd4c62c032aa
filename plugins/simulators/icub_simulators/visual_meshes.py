"""Meshes of the body with few faces, since the time of software rendering grows with their number."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

import numpy as np

from icub_core.errors import DataError, SimulationError
from icub_simulators.decimation import decimate
from icub_simulators.objects.meshes import read_mesh
from icub_support.cache import cached_file, content_key

logger = logging.getLogger(__name__)

FACES = 400
"""Triangles per link. The whole body has about 14,000: faceted in close-ups, clearly the robot at 160 x 120 pixels."""


def decimated(path: Path) -> Path:
    """Return an OBJ file (kept by content hash, in the unit of the original) with the same surface in few faces.

    Raises:
        SimulationError: When the mesh is missing or cannot be read.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise SimulationError(f"cannot read mesh {path}, named by the robot's URDF: {error.strerror}") from error
    return cached_file("decimated", f"{content_key(raw, FACES, 'clusters-1')}.obj", partial(_decimated_obj, path))


def _decimated_obj(path: Path) -> bytes:
    logger.info("decimating %s (kept for the next time)", path.name)
    try:
        vertices, faces = read_mesh(path)
    except DataError as error:
        raise SimulationError(str(error)) from error
    vertices, faces = decimate(vertices, faces, FACES)
    lines = [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(faces) + 1]
    return ("\n".join(lines) + "\n").encode()
