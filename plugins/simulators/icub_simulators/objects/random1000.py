"""The thousand random objects that come with ``pybullet_data``."""

from __future__ import annotations

import importlib.util
import logging
import zlib
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, DataError, unknown_name
from icub_core.geometry import quat_wxyz_to_matrix
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Material, ObjectSpec, RestPose
from icub_simulators.objects.meshes import solid_object, without_specks
from icub_simulators.objects.solids import (
    STABLE_TILT,
    center_of_mass,
    hull_volume,
    narrowest_width,
    stable_poses,
)
from icub_simulators.objects.textures import PATTERNS, print_texture, random_ink
from icub_support.cache import Arrays, cached_arrays, content_key

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

FILE_UNIT = 0.015
"""Meters per unit of the OBJ files, from their URDFs."""
MASS = 0.1
"""Kilograms at the true size, from their URDFs."""
DENSITY = 500.0
"""kg/m^3 of a resized object; between a full cracker box (210) and a full can (1000)."""
LIGHTEST = 0.03
"""Kilograms of a resized object; slender shapes would weigh a gram."""
MAX_PIECES = 16
HAND_WIDTH = (0.040, 0.062)
"""Meters that a resized object leaves between thumb and fingers; 38 to 66 mm were seen to be held."""
HAND_HEIGHT = (0.050, 0.25)
"""Lower objects leave no room for the fingers above the table; higher ones topple."""
HAND_LENGTH = (0.07, 0.22)
"""Meters of the largest extent of a resized object, where the caller names none."""
COUNT = 1000
BROKEN = (168,)
"""Files without a single finite vertex."""


class Random1000(ObjectSet):
    """Random shapes of ``pybullet_data/random_urdfs``, with procedural colors and prints.

    Names are ``random_000`` to ``random_999`` without 168, whose file holds no number. Objects of more than 16 convex
    pieces keep the largest 16. At their true size (8 to 18 cm wide) few of them fit a hand.

    Args:
        size: Lowest and highest largest extent in meters; each object is resized to a length drawn in between (always
            the same for one object and range) and weighs 500 kg/m^3, at least 30 g. None keeps true size and 0.1 kg.
        graspable: Resize each object for the iCub's hand instead: in the lowest stable pose that allows it, its
            narrowest horizontal width is 40 to 62 mm (drawn once an object), its height 50 to 250 mm and its largest
            extent within `size` (7 to 22 cm where none is given). Objects that cannot be are left out.
    """

    def __init__(self, size: list[float] | None = None, graspable: bool = False) -> None:
        if size is not None and (len(size) != 2 or not 0.01 <= size[0] <= size[1] <= 1.0):
            raise ConfigError(f"random1000 size is {size}; expected [lowest, highest] meters within 0.01 and 1")
        self._size = None if size is None else (float(size[0]), float(size[1]))
        self._graspable = graspable
        self._root = _data_root()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names in numerical order; with `graspable` the first use looks at all objects (seconds, then kept)."""
        everything = tuple(f"random_{i:03d}" for i in range(COUNT) if i not in BROKEN)
        if not self._graspable:
            return everything
        key = content_key("graspable-3", *(self._size or HAND_LENGTH), *HAND_WIDTH, *HAND_HEIGHT)
        keep = cached_arrays("random1000", key, lambda: self._choose(everything))["keep"]
        return tuple(name for name, kept in zip(everything, keep, strict=True) if kept)

    def get(self, name: str) -> ObjectSpec:
        """Build one object; raises ConfigError for a name that is not in the set."""
        if name not in self.names:
            raise ConfigError(unknown_name("object in 'random1000'", name, self.names))
        return _build(self._root, name, self._size, self._graspable)

    def _choose(self, names: tuple[str, ...]) -> Arrays:
        logger.info("looking for graspable ones among %d random objects (kept for the next time)", len(names))
        fits = [_fit_to_hand(name, _read_pieces(self._root, name), self._size or HAND_LENGTH) for name in names]
        return {"keep": np.array([fit is not None for fit in fits])}


def _data_root() -> Path:
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or spec.origin is None:
        raise DataError(
            "object set 'random1000' needs the meshes of the package pybullet, which is not installed; type: "
            "pip install 'icub-kit[pybullet]' (it is built from source on Python 3.12 and later)"
        )
    return Path(spec.origin).parent / "random_urdfs"


def _seed(name: str, purpose: str) -> int:
    return zlib.crc32(f"{purpose} {name}".encode())


def _read_pieces(root: Path, name: str) -> list[FloatArray]:
    """Read the convex pieces (the file holds them as groups) at their true size, largest first, meters."""
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
    order = sorted(range(len(pieces)), key=lambda i: -volumes[i])[:MAX_PIECES]
    return [pieces[i] for i in order if volumes[i] > 0]


def _fit_to_hand(name: str, pieces: list[FloatArray], length: tuple[float, float]) -> tuple[float, RestPose] | None:
    """Find the scale and the lowest stable pose in which the hand can span the object; None where there is none."""
    points = np.concatenate(pieces)
    wanted = np.random.default_rng(_seed(name, "width")).uniform(*HAND_WIDTH)
    largest = float(np.ptp(points, axis=0).max())
    for pose, tilt in stable_poses(points, center_of_mass(pieces)):
        if tilt < STABLE_TILT:
            continue
        standing = points @ quat_wxyz_to_matrix(pose.quat_wxyz).T
        factor = wanted / narrowest_width(standing[:, :2])
        height = factor * float(np.ptp(standing[:, 2]))
        if HAND_HEIGHT[0] <= height <= HAND_HEIGHT[1] and length[0] <= factor * largest <= length[1]:
            return factor, pose
    return None


@lru_cache(maxsize=256)
def _build(root: Path, name: str, size: tuple[float, float] | None, graspable: bool) -> ObjectSpec:
    pieces = _read_pieces(root, name)
    factor, rest = 1.0, None
    if graspable:
        fit = _fit_to_hand(name, pieces, size or HAND_LENGTH)
        assert fit is not None  # `names` holds the others back
        factor, rest = fit
    elif size is not None:
        length = np.random.default_rng(_seed(name, "size")).uniform(*size)
        factor = length / float(np.ptp(np.concatenate(pieces), axis=0).max())
    pieces = [factor * p for p in without_specks(pieces)]
    resized = graspable or size is not None
    mass = max(DENSITY * sum(hull_volume(p) for p in pieces), LIGHTEST) if resized else MASS
    rng = np.random.default_rng(_seed(name, "look"))
    pattern = PATTERNS[int(rng.integers(len(PATTERNS)))]
    texture = print_texture(pattern, random_ink(rng), random_ink(rng), _seed(name, "print"))
    return solid_object(
        name,
        pieces,
        surface=None,
        mass=mass,
        material=Material(texture=texture),
        friction=(0.5, 0.005, 0.0001),
        rest_poses=() if rest is None else (rest,),
    )
