"""Reading meshes: convex pieces in meters, and one clear line for a file that cannot be used."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import quat_wxyz_to_matrix
from icub_core.scene import Geom, Material, ObjectSpec, RestPose, Vec3
from icub_simulators.objects.solids import center_of_mass, hull_volume, oriented_hull, rest_pose
from icub_support.cache import Arrays, cached_arrays, cached_text, content_key

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MESH_SUFFIXES = (".obj", ".stl")
MAX_OBJECT = 2.0
"""Meters; more is taken for a mesh in millimeters."""
MIN_OBJECT = 2e-3
MAX_FACES = 2_000_000
NEARLY_CONVEX = 0.01
"""A mesh whose volume differs by less than this share from its hull's is taken for convex."""
_CHUNK = 1 << 24
SPECK = 2e-3
"""Pieces below this share of the volume are left out of the collision shape."""


def read_mesh(path: Path) -> tuple[FloatArray, IntArray]:
    """Read vertices (V, 3) and triangles (F, 3) of an OBJ or STL file, in the file's unit.

    Raises:
        DataError: For a missing, unreadable, empty, faceless or far too large file, or vertices that are not finite.
    """
    import trimesh

    if not path.is_file():
        raise DataError(f"no mesh file {path}")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise DataError(f"mesh {path} has suffix '{path.suffix}'; expected one of {', '.join(MESH_SUFFIXES)}")
    if path.stat().st_size == 0:
        raise DataError(f"mesh {path} is empty")
    count = count_faces(path)  # before millions of them are read
    if count > MAX_FACES:
        raise DataError(f"mesh {path} has {count} faces; expected at most {MAX_FACES}: decimate it first")
    try:
        mesh = trimesh.load(path, force="mesh", process=False, skip_materials=True)
        vertices = np.asarray(getattr(mesh, "vertices", []), dtype=np.float64)  # a file of points gives no mesh
        faces = np.asarray(getattr(mesh, "faces", []), dtype=np.int64)
    except Exception as error:  # the readers raise whatever the broken file provokes
        raise DataError(
            f"mesh {path} cannot be read: {str(error).splitlines()[0] if str(error) else type(error)}"
        ) from error
    if faces.ndim != 2 or len(faces) == 0:
        raise DataError(f"mesh {path} has no faces; expected at least 4 triangles")
    used = np.unique(faces)
    if used[-1] >= len(vertices):
        raise DataError(f"mesh {path} names vertex {used[-1] + 1} of {len(vertices)}")
    if not np.all(np.isfinite(vertices[used])):
        raise DataError(f"mesh {path} has vertices that are not finite numbers")
    remap = np.zeros(len(vertices), dtype=np.int64)
    remap[used] = np.arange(len(used))
    return vertices[used], remap[faces]


def count_faces(path: Path) -> int:
    """Count the faces that an OBJ or STL file announces, without reading them: 10 million take a second or two."""
    with path.open("rb") as file:
        if path.suffix.lower() == ".stl":
            head = file.read(84)
            count = int.from_bytes(head[80:84], "little")
            if path.stat().st_size == 84 + 50 * count:
                return count  # binary
            file.seek(0)
        mark = b"facet normal" if path.suffix.lower() == ".stl" else b"\nf "
        count, rest = 0, b"\n"
        while chunk := file.read(_CHUNK):
            chunk = rest + chunk
            count += chunk.count(mark)
            rest = chunk[1 - len(mark) :]  # too short for a mark, long enough for one that is cut in two
    return count


def check_size(path: Path, points: FloatArray) -> None:
    """Raise DataError unless the points, in meters, are of a size that a hand or a table can deal with."""
    extents = np.ptp(points, axis=0)
    largest = float(extents.max())
    if largest > MAX_OBJECT:
        raise DataError(
            f"mesh {path} is {largest:.3g} m long; expected at most {MAX_OBJECT} m. "
            "Did you mean millimeters? Then give scale=0.001"
        )
    if largest < MIN_OBJECT:
        raise DataError(f"mesh {path} is {largest:.3g} m long; expected at least {MIN_OBJECT} m: give a larger scale")
    if hull_volume(points) < 1e-4 * largest**3:
        raise DataError(f"mesh {path} is flat ({', '.join(f'{e:.3g}' for e in extents)} m); expected a solid body")


def convex_pieces(vertices: FloatArray, faces: IntArray, most: int, concavity: float) -> list[FloatArray]:
    """Decompose a mesh into at most `most` convex pieces (CoACD), kept by content hash.

    A mesh that is convex already, to within `NEARLY_CONVEX` of its volume, is its own only piece.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
        most: Largest number of pieces; 1 gives the hull.
        concavity: Allowed error, share of the object's size.

    Returns:
        Vertices of each piece, (N_i, 3), in the unit of `vertices`.
    """
    if most == 1 or abs(_volume(vertices, faces) / hull_volume(vertices) - 1) < NEARLY_CONVEX:
        return [vertices]
    key = content_key(vertices.tobytes(), faces.tobytes(), most, concavity, "coacd-2")

    def compute() -> Arrays:
        import coacd

        logger.info("decomposing a mesh of %d faces into convex pieces (kept for the next time)", len(faces))
        coacd.set_log_level("error")
        parts = coacd.run_coacd(coacd.Mesh(vertices, faces), threshold=concavity, max_convex_hull=most, seed=0)
        return {f"{i:04d}": np.asarray(part[0], dtype=np.float64) for i, part in enumerate(parts)}

    arrays = cached_arrays("convex", key, compute)
    return [arrays[name] for name in sorted(arrays)]


def without_specks(pieces: list[FloatArray]) -> list[FloatArray]:
    """Return the pieces that are more than `SPECK` of the volume of all."""
    volumes = [hull_volume(p) for p in pieces]
    return [p for p, volume in zip(pieces, volumes, strict=True) if volume > SPECK * sum(volumes)]


def _volume(vertices: FloatArray, faces: IntArray) -> float:
    """Volume enclosed by a closed surface; meaningless (and seldom near the hull's) for an open one."""
    a, b, c = (vertices[faces[:, i]] - vertices[0] for i in range(3))
    return float(abs(np.einsum("fi,fi->f", a, np.cross(b, c)).sum()) / 6)


def solid_object(
    name: str,
    pieces: list[FloatArray],
    *,
    surface: tuple[FloatArray, IntArray] | None,
    mass: float,
    material: Material,
    friction: Vec3,
    rest_poses: tuple[RestPose, ...] = (),
) -> ObjectSpec:
    """Turn convex pieces in meters into an object whose origin is the center of its box.

    Args:
        name: Of the object.
        pieces: (N_i, 3) vertices of each convex piece.
        surface: Vertices and faces to draw; None draws the pieces.
        mass: kg.
        material: Look.
        friction: Sliding, torsional, rolling.
        rest_poses: How it may stand, with heights of the pieces' origin. It stands in the first; without any, in the
            lowest stable pose.
    """
    everything = np.concatenate(pieces)
    low, high = everything.min(axis=0), everything.max(axis=0)
    middle = (low + high) / 2
    pieces = [p - middle for p in pieces]
    everything = everything - middle
    rests = rest_poses or (rest_pose(everything, center_of_mass(pieces)),)
    # the origin has moved
    rests = tuple(
        RestPose(r.quat_wxyz, -float((everything @ quat_wxyz_to_matrix(r.quat_wxyz)[2]).min()), r.share) for r in rests
    )
    visual: tuple[Geom, ...] = ()
    if surface is not None:
        visual = (Geom("mesh", mesh=_write_obj(surface[0] - middle, surface[1])),)
    half = (high - low) / 2
    return ObjectSpec(
        name=name,
        collision=tuple(Geom("mesh", mesh=_write_obj(*oriented_hull(p))) for p in pieces),
        visual=visual,
        mass=mass,
        half_extents=(float(half[0]), float(half[1]), float(half[2])),
        rest_height=rests[0].height,
        rest_quat_wxyz=rests[0].quat_wxyz,
        rest_poses=rests if rest_poses else (),
        material=material,
        friction=friction,
    )


def _write_obj(vertices: FloatArray, faces: NDArray[np.integer]) -> Path:
    """Write an OBJ into the cache under its content's hash (every loader reads files) and return its path."""
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return cached_text("pieces", "\n".join(lines) + "\n", ".obj")
