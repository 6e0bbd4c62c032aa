"""Household things of the project's own, built from code alone."""

from __future__ import annotations

import zlib
from functools import lru_cache

import numpy as np

from icub_core.errors import ConfigError, unknown_name
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Material, ObjectSpec, RestPose
from icub_simulators.objects.household.kinds import LYING, STANDING
from icub_simulators.objects.meshes import solid_object
from icub_simulators.objects.solids import hull_volume
from icub_simulators.objects.textures import PATTERNS, print_texture, random_ink

KINDS = {**STANDING, **LYING}
EACH = 8
"""Things of one kind."""
NAMES = tuple(f"{kind}_{i}" for kind in sorted(KINDS) for i in range(EACH))
DENSITY = 500.0
"""kg/m^3, as of the resized objects of `random1000`."""
LIGHTEST = 0.03
"""Kilograms."""
UPRIGHT = RestPose((1.0, 0.0, 0.0, 0.0), 0.0)


class Household(ObjectSet):
    """Invented household things: bottles, mugs, bowls, jugs, tools and toys, 8 of each of 18 kinds.

    Names are ``bottle_0`` to ``wrench_7``. The name alone decides shape, color and print, and together with `size` the
    length. Vessels are hollow and stand; tools lie. Their shapes are in no training set of the project.

    Args:
        size: Lowest and highest largest extent in meters; each thing is resized to a length drawn in between. None
            keeps the size it is invented with, 6 to 27 cm.
    """

    def __init__(self, size: list[float] | None = None) -> None:
        if size is not None and (len(size) != 2 or not 0.01 <= size[0] <= size[1] <= 1.0):
            raise ConfigError(f"household size is {size}; expected [lowest, highest] meters within 0.01 and 1")
        self._size = None if size is None else (float(size[0]), float(size[1]))

    @property
    def names(self) -> tuple[str, ...]:
        """The names, kind by kind."""
        return NAMES

    def get(self, name: str) -> ObjectSpec:
        """Build one object; raises ConfigError for a name that is not in the set."""
        if name not in NAMES:
            raise ConfigError(unknown_name("object in 'household'", name, NAMES))
        return _build(name, self._size)


def _rng(name: str, purpose: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(f"household {purpose} {name}".encode()))


@lru_cache(maxsize=256)
def _build(name: str, size: tuple[float, float] | None) -> ObjectSpec:
    kind = name.rpartition("_")[0]
    part = KINDS[kind](_rng(name, "shape"))
    if size is not None:
        factor = _rng(name, "size").uniform(*size) / float(np.ptp(part.vertices, axis=0).max())
        part = part.stretched(factor, factor, factor)
    look = _rng(name, "look")
    pattern = PATTERNS[int(look.integers(len(PATTERNS)))]
    texture = print_texture(pattern, random_ink(look), random_ink(look), int(look.integers(1 << 31)))
    pieces = list(part.pieces)
    return solid_object(
        name,
        pieces,
        surface=(part.vertices, part.faces),
        mass=max(DENSITY * sum(hull_volume(p) for p in pieces), LIGHTEST),
        material=Material(texture=texture),
        friction=(0.5, 0.005, 0.0001),
        rest_poses=(UPRIGHT,) if kind in STANDING else (),
    )
