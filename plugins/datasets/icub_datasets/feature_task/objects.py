"""The classes of the FEATURE-TASK: meshes of ``pybullet_data`` and invented products made of primitives.

None of them has the size of an object that is later taught (the YCB objects), so that what is learned on the
FEATURE-TASK is tested on objects that are new.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from icub_core.errors import DataError

# Published sizes of the YCB objects used in the thesis's experiments, meters (ycbbenchmarks.com). No class may
# have a bounding box that is within RESEMBLANCE of one of these on all three sorted sides.
YCB_SIZES: dict[str, tuple[float, float, float]] = {
    "003_cracker_box": (0.060, 0.158, 0.210),
    "004_sugar_box": (0.038, 0.089, 0.175),
    "005_tomato_soup_can": (0.066, 0.066, 0.101),
    "006_mustard_bottle": (0.058, 0.095, 0.190),
    "008_pudding_box": (0.035, 0.110, 0.089),
    "010_potted_meat_can": (0.050, 0.097, 0.082),
    "021_bleach_cleanser": (0.250, 0.098, 0.065),
    "025_mug": (0.080, 0.080, 0.082),
    "035_power_drill": (0.035, 0.046, 0.184),
}
RESEMBLANCE = 0.12
MESH_COUNT = 110
PRODUCT_COUNT = 70


@dataclass(frozen=True)
class Part:
    """One geometry of an object: a primitive, or a mesh file.

    Attributes:
        shape: "box", "cylinder", "ellipsoid", "capsule" or "mesh".
        size: (3,) half sizes of a primitive (cylinder and capsule: radius, half length, 0), meters; a mesh's scale.
        position: (3,) of the part in the object's frame, meters.
        mesh: Path of the OBJ file of a mesh.
    """

    shape: str
    size: tuple[float, float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mesh: Path | None = None


@dataclass(frozen=True, eq=False)
class TaskObject:
    """One class of the FEATURE-TASK.

    Attributes:
        name: Unique name.
        parts: Its geometries.
        points: (K, 3) points whose hull holds the object, object frame, meters.
    """

    name: str
    parts: tuple[Part, ...]
    points: NDArray[np.float64]

    @property
    def extents(self) -> NDArray[np.float64]:
        """(3,) sides of the bounding box in the object's frame, meters."""
        return np.ptp(self.points, axis=0)


def resembles_ycb(extents: NDArray[np.float64]) -> str | None:
    """Return the name of the YCB object that a box of `extents` (3,) meters could be taken for, or None."""
    mine = np.sort(np.asarray(extents))
    for name, size in YCB_SIZES.items():
        theirs = np.sort(np.array(size))
        if np.all(np.abs(mine - theirs) <= RESEMBLANCE * theirs):
            return name
    return None


def mesh_folder() -> Path:
    """Return the folder of the 1000 random meshes that are installed with PyBullet; DataError where it is not."""
    try:
        import pybullet_data
    except ImportError as error:
        raise DataError(
            "data set 'feature_task' needs the meshes of the package pybullet, which is not installed; type: "
            "pip install 'icub-kit[pybullet]' (it is built from source on Python 3.12 and later)"
        ) from error
    folder = Path(pybullet_data.getDataPath()) / "random_urdfs"
    if not folder.is_dir():
        raise DataError(f"no folder {folder}: this pybullet has no random_urdfs; reinstall it")
    return folder


def read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read all shapes of an OBJ file of triangles: vertices (V, 3) and faces (F, 3).

    MuJoCo's own reader keeps the faces of the first shape only, and these meshes consist of several convex shapes.
    """
    lines = [line.split() for line in path.read_text().splitlines() if line[:2] in ("v ", "f ")]
    vertices = [line[1:4] for line in lines if line[0] == "v"]
    faces = [[int(word.split("/")[0]) - 1 for word in line[1:4]] for line in lines if line[0] == "f"]
    if len(vertices) < 4 or len(faces) < 4:
        raise DataError(f"{path}: expected a mesh, found {len(vertices)} vertices and {len(faces)} faces")
    return np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int64)


def _mesh_objects(rng: np.random.Generator, count: int) -> list[TaskObject]:
    """`count` meshes of random_urdfs, their longest side resized to 9 to 20 cm."""
    folder = mesh_folder()
    names = sorted(p.name for p in folder.iterdir() if (p / f"{p.name}.obj").is_file())
    if len(names) < count:
        raise DataError(f"{folder}: expected at least {count} objects, found {len(names)}")
    found: list[TaskObject] = []
    for name in rng.permutation(names):
        path = folder / name / f"{name}.obj"
        vertices, _ = read_obj(path)
        extents = np.ptp(vertices, axis=0)
        scale = rng.uniform(0.09, 0.20) / extents.max()
        if extents.min() * scale < 0.02 or resembles_ycb(extents * scale):
            continue
        center = (vertices.max(0) + vertices.min(0)) / 2 * scale
        hull = vertices[ConvexHull(vertices).vertices]
        x, y, z = (-center).tolist()
        part = Part("mesh", (float(scale),) * 3, (x, y, z), path)
        found.append(TaskObject(f"mesh_{name}", (part,), hull * scale - center))
        if len(found) == count:
            return found
    raise DataError(f"{folder}: only {len(found)} of {count} objects can be used")


def _hull_points(parts: tuple[Part, ...]) -> NDArray[np.float64]:
    """Points around primitives: corners of boxes, rings of round shapes."""
    clouds = []
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    for part in parts:
        size, position = np.array(part.size), np.array(part.position)
        if part.shape == "box":
            signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3)
            cloud = signs * size
        elif part.shape == "ellipsoid":
            latitudes = np.linspace(-np.pi / 2, np.pi / 2, 9)
            a, b = (g.ravel() for g in np.meshgrid(angles, latitudes))
            cloud = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], axis=1) * size
        else:
            radius, half = part.size[0], part.size[1] + (part.size[0] if part.shape == "capsule" else 0.0)
            ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros_like(angles)], axis=1)
            cloud = np.concatenate([ring + [0, 0, half], ring - [0, 0, half]])
        clouds.append(cloud + position)
    return np.concatenate(clouds)


def _random_product(rng: np.random.Generator) -> tuple[str, tuple[Part, ...]]:
    """One invented product: its kind and its parts."""
    kind = str(rng.choice(["box", "can", "bottle", "ellipsoid", "tool", "tub"], p=[0.34, 0.18, 0.2, 0.1, 0.1, 0.08]))
    if kind == "box":
        a, b, c = (float(v) for v in np.sort(rng.uniform([0.02, 0.04, 0.08], [0.08, 0.14, 0.22])) / 2)
        return kind, (Part("box", (a, b, c)),)
    if kind == "can":
        return kind, (Part("cylinder", (float(rng.uniform(0.02, 0.055)), float(rng.uniform(0.02, 0.1)), 0.0)),)
    if kind == "ellipsoid":
        a, b, c = rng.uniform(0.03, 0.085, size=3).tolist()
        return kind, (Part("ellipsoid", (a, b, c)),)
    if kind == "bottle":
        height, radius = float(rng.uniform(0.05, 0.09)), float(rng.uniform(0.022, 0.045))
        neck = float(rng.uniform(0.3, 0.65)) * radius
        top = float(rng.uniform(0.01, 0.03))
        flat = rng.random() < 0.4
        body = Part("ellipsoid", (radius, radius * 0.6, height)) if flat else Part("cylinder", (radius, height, 0.0))
        shoulder = Part("ellipsoid", (radius * 0.9, radius * (0.55 if flat else 0.9), radius), (0.0, 0.0, height * 0.9))
        return kind, (body, shoulder, Part("cylinder", (neck, top, 0.0), (0.0, 0.0, height + radius * 0.7 + top / 2)))
    if kind == "tool":
        a, b = float(rng.uniform(0.015, 0.03)), float(rng.uniform(0.04, 0.09))
        c, d = float(rng.uniform(0.012, 0.025)), float(rng.uniform(0.03, 0.07))
        side = float(rng.uniform(-0.6, 0.6)) * b
        return kind, (Part("box", (a, b, a)), Part("box", (c, c, d), (0.0, side, -d)))
    radius, half = float(rng.uniform(0.035, 0.06)), float(rng.uniform(0.02, 0.05))
    lid = Part("cylinder", (radius * 1.06, 0.006, 0.0), (0.0, 0.0, half))
    return kind, (Part("cylinder", (radius, half, 0.0)), lid)


def _products(rng: np.random.Generator, count: int) -> list[TaskObject]:
    found: list[TaskObject] = []
    while len(found) < count:
        kind, parts = _random_product(rng)
        points = _hull_points(parts)
        center = (points.max(0) + points.min(0)) / 2
        if resembles_ycb(np.ptp(points, axis=0)):
            continue
        moved = []
        for part in parts:
            x, y, z = (np.array(part.position) - center).tolist()
            moved.append(Part(part.shape, part.size, (x, y, z)))
        found.append(TaskObject(f"{kind}_{len(found):03d}", tuple(moved), points - center))
    return found


def feature_task_objects(seed: int = 0, meshes: int = MESH_COUNT, products: int = PRODUCT_COUNT) -> list[TaskObject]:
    """Return the classes of the FEATURE-TASK, in label order (label 1 is the first).

    Args:
        seed: Chooses the meshes and draws the products; scenes have a seed of their own.
        meshes: Number of ``random_urdfs`` meshes.
        products: Number of invented products.

    Raises:
        DataError: When the meshes are not installed or too few of them can be used.
    """
    rng = np.random.default_rng([seed, 1])
    return _mesh_objects(rng, meshes) + _products(np.random.default_rng([seed, 2]), products)
