"""The thousand random objects that come with ``pybullet_data``."""

from __future__ import annotations

import importlib.util
import logging
import zlib
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.geometry import quat_wxyz_to_matrix
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Material, ObjectSpec
from numpy.typing import NDArray

from icub_simulators.cache import Arrays, cached_arrays, content_key
from icub_simulators.objects.meshes import solid_object
from icub_simulators.objects.solids import center_of_mass, hull_volume, narrowest_width, rest_pose
from icub_simulators.objects.textures import PATTERNS, print_texture, random_ink

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

FILE_UNIT = 0.015
"""Metres per unit of the OBJ files, from their URDFs."""
MASS = 0.1
"""Kilograms at the true size, from their URDFs."""
DENSITY = 500.0
"""kg/m^3 of a resized object; between a full cracker box (210) and a full can (1000)."""
MOST_PIECES = 16
GRASPABLE_WIDTH = (0.038, 0.066)
"""Metres between thumb and fingers that the iCub's hand was seen to hold."""
GRASPABLE_HEIGHT = (0.055, 0.25)
"""Lower objects leave no room for the fingers above the table; higher ones topple."""
COUNT = 1000
BROKEN = (168,)
"""Files without a single finite vertex."""


class Random1000(ObjectSet):
    """Random household-like shapes of ``pybullet_data/random_urdfs``, with procedural colours and prints.

    Names are ``random_000`` to ``random_999`` without 168, whose file holds no number. Rest pose: the lowest stable one of the hull. Objects of more than
    16 convex pieces keep the largest 16.

    Args:
        size: Lowest and highest largest extent in metres; each object is resized to a length drawn in between (always
            the same for one object and range) and weighs 500 kg/m^3. None keeps the true size and 0.1 kg.
        graspable: Keep only objects that the iCub's hand can span from above or from the side in their rest pose:
            narrowest horizontal width 38 to 66 mm, height 55 to 250 mm.
    """

    def __init__(self, size: list[float] | None = None, graspable: bool = False) -> None:
        if size is not None and (len(size) != 2 or not 0.01 <= size[0] <= size[1] <= 1.0):
            raise ConfigError(f"random1000 size is {size}; expected [lowest, highest] metres within 0.01 and 1")
        self._size = None if size is None else (float(size[0]), float(size[1]))
        self._graspable = graspable
        self._root = _data_root()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names in numerical order; with `graspable` the first use looks at all objects (seconds, then kept)."""
        everything = tuple(f"random_{i:03d}" for i in range(COUNT) if i not in BROKEN)
        if not self._graspable:
            return everything
        key = content_key("graspable-2", *(self._size or (0.0,)), *GRASPABLE_WIDTH, *GRASPABLE_HEIGHT)
        chosen = cached_arrays(
            "random1000", key, lambda: {"keep": np.array([self._can_be_held(n) for n in everything])}
        )
        return tuple(name for name, keep in zip(everything, chosen["keep"], strict=True) if keep)

    def get(self, name: str) -> ObjectSpec:
        """Build one object; raises ConfigError for a name that is not in the set."""
        if name not in self.names:
            raise ConfigError(unknown_name("object in 'random1000'", name, self.names))
        return _build(self._root, name, self._size)

    def _choose(self, names: tuple[str, ...]) -> Arrays:
        logger.info("looking for graspable ones among %d random objects (kept for the next time)", len(names))
        return {"keep": np.array([self._can_be_held(name) for name in names])}

    def _can_be_held(self, name: str) -> bool:
        pieces = _scaled_pieces(self._root, name, self._size)
        points = np.concatenate(pieces)
        rest = rest_pose(points, center_of_mass(pieces))
        standing = points @ quat_wxyz_to_matrix(rest.quat_wxyz).T
        width, height = narrowest_width(standing[:, :2]), float(np.ptp(standing[:, 2]))
        return (
            GRASPABLE_WIDTH[0] <= width <= GRASPABLE_WIDTH[1] and GRASPABLE_HEIGHT[0] <= height <= GRASPABLE_HEIGHT[1]
        )


def _data_root() -> Path:
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or spec.origin is None:
        raise DataError("object set 'random1000' needs the files of the package 'pybullet': pip install pybullet")
    return Path(spec.origin).parent / "random_urdfs"


def _seed(name: str, purpose: str) -> int:
    return zlib.crc32(f"{purpose} {name}".encode())


def _scaled_pieces(root: Path, name: str, size: tuple[float, float] | None) -> list[FloatArray]:
    """Read the convex pieces (the file holds them as groups), largest first, in metres."""
    number = name.removeprefix("random_")
    path = root / number / f"{number}.obj"
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from error
    groups: list[list[list[float]]] = []
    for line in lines:
        if line.startswith("o "):
            groups.append([])
        elif line.startswith("v "):
            groups[-1].append([float(v) for v in line.split()[1:4]])
    pieces = [FILE_UNIT * np.array(g) for g in groups]
    volumes = [hull_volume(p) for p in pieces]
    order = sorted(range(len(pieces)), key=lambda i: -volumes[i])[:MOST_PIECES]
    pieces = [pieces[i] for i in order if volumes[i] > 0]
    if size is not None:
        length = np.random.default_rng(_seed(name, "size")).uniform(*size)
        factor = length / float(np.ptp(np.concatenate(pieces), axis=0).max())
        pieces = [factor * p for p in pieces]
    return pieces


@lru_cache(maxsize=256)
def _build(root: Path, name: str, size: tuple[float, float] | None) -> ObjectSpec:
    rng = np.random.default_rng(_seed(name, "look"))
    pattern = PATTERNS[int(rng.integers(len(PATTERNS)))]
    texture = print_texture(pattern, random_ink(rng), random_ink(rng), _seed(name, "print"))
    return solid_object(
        name,
        _scaled_pieces(root, name, size),
        surface=None,
        density=DENSITY,
        mass=MASS if size is None else None,
        material=Material(texture=texture),
        friction=(0.5, 0.005, 0.0001),
    )
