"""What hand trials are done with: `random1000` and household shapes drawn at random, as heavy as household things.

The shapes are cartons, cans, bottles and tools of random proportions, upright. The weights of `random1000` are for its
own slender shapes (30 to 360 g), and what holds them need not hold a full bottle; here both kinds weigh what a
surrounding box of household density would.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from icub_core.construct import build
from icub_core.errors import ConfigError, unknown_name
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Geom, ObjectSpec, QuatWxyz, Vec3

SHAPES = 10_000
"""Numbers from here on belong to the random shapes, lower ones to `random1000`."""

DENSITY = (200.0, 900.0)
"""kg/m^3 of the surrounding box: a carton of crackers, a full bottle."""
MASS = (0.05, 1.2)
"""Kilograms, at least and at most."""
_ALONG_X: QuatWxyz = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)

_Parts = tuple[tuple[Geom, ...], Vec3]


class OneObject(ObjectSet):
    """A set of a single object."""

    def __init__(self, spec: ObjectSpec) -> None:
        self._spec = spec

    @property
    def names(self) -> tuple[str, ...]:
        """The object's name."""
        return (self._spec.name,)

    def get(self, name: str) -> ObjectSpec:
        """Return the object; ConfigError for another name."""
        if name != self._spec.name:
            raise ConfigError(unknown_name("object", name, self.names))
        return self._spec


class TrialObjects:
    """Objects by number: the number alone decides shape and mass."""

    def __init__(self) -> None:
        self._random: ObjectSet = build("objects", {"plugin": "random1000", "graspable": True})

    def draw(self, rng: np.random.Generator, count: int) -> list[int]:
        """Return `count` numbers, as many of `random1000` as of shapes; an odd one is a shape."""
        known = rng.choice(len(self._random.names), count // 2, replace=False)
        return [int(i) for i in known] + [SHAPES + int(i) for i in rng.integers(100_000, size=count - len(known))]

    def get(self, number: int) -> ObjectSpec:
        """Build one object."""
        rng = np.random.default_rng([0, number])
        spec = random_shape(number) if number >= SHAPES else self._random.get(self._random.names[number])
        volume = 8 * float(np.prod(spec.half_extents))
        return replace(spec, mass=float(np.clip(rng.uniform(*DENSITY) * volume, *MASS)))


def random_shape(number: int) -> ObjectSpec:
    """Build the carton, can, bottle or tool of this number; origin in the middle of the surrounding box, 1 kg."""
    rng = np.random.default_rng([1, number])
    kinds: tuple[Callable[[np.random.Generator], _Parts], ...] = (_carton, _can, _bottle, _tool)
    parts, (x, y, z) = kinds[int(rng.integers(len(kinds)))](rng)
    return ObjectSpec(f"shape_{number}", parts, 1.0, (x / 2, y / 2, z / 2), z / 2)


def _carton(rng: np.random.Generator) -> _Parts:
    x, y, z = rng.uniform(0.03, 0.068), rng.uniform(0.04, 0.18), rng.uniform(0.05, 0.25)
    return (Geom("box", (x / 2, y / 2, z / 2)),), (x, y, z)


def _can(rng: np.random.Generator) -> _Parts:
    width, z = rng.uniform(0.035, 0.07), rng.uniform(0.06, 0.22)
    return (Geom("cylinder", (width / 2, z / 2)),), (width, width, z)


def _bottle(rng: np.random.Generator) -> _Parts:
    """Build an oval or round or square body and a narrower neck."""
    x, z = rng.uniform(0.04, 0.07), rng.uniform(0.13, 0.27)
    y, body = x + rng.uniform(0.0, 0.05), z * rng.uniform(0.6, 0.85)
    neck, middle = rng.uniform(0.01, 0.4 * x), (body - z) / 2
    cap = Geom("cylinder", (neck, (z - body) / 2), (0.0, 0.0, body / 2))
    if rng.random() < 0.3:
        return (Geom("box", (x / 2, y / 2, body / 2), (0.0, 0.0, middle)), cap), (x, y, z)
    offset = (y - x) / 2
    rounds = tuple(Geom("cylinder", (x / 2, body / 2), (0.0, s * offset, middle)) for s in (-1.0, 1.0))
    core = (Geom("box", (x / 2, offset, body / 2), (0.0, 0.0, middle)),) if offset > 1e-3 else ()
    return (*core, *rounds, cap), (x, y, z)


def _tool(rng: np.random.Generator) -> _Parts:
    """Build a foot, a handle on it and a head above, each a box or, for the head, a lying cylinder."""
    foot = np.array([rng.uniform(0.06, 0.11), rng.uniform(0.045, 0.07), rng.uniform(0.02, 0.06)])
    handle = np.array([rng.uniform(0.025, 0.05), rng.uniform(0.025, 0.055), rng.uniform(0.05, 0.11)])
    length, thick = rng.uniform(0.06, 0.19), rng.uniform(0.035, 0.065)
    shift_handle = rng.uniform(-0.5, 0.5) * (foot[0] - handle[0])
    shift_head = shift_handle + rng.uniform(-0.3, 0.3) * length
    z = float(foot[2] + handle[2] + thick)
    low = min(-foot[0] / 2, shift_head - length / 2)
    high = max(foot[0] / 2, shift_head + length / 2)
    back = -(low + high) / 2
    head_at = (float(shift_head + back), 0.0, z / 2 - thick / 2)
    head = (
        Geom("cylinder", (thick / 2, length / 2), head_at, _ALONG_X)
        if rng.random() < 0.5
        else Geom("box", (length / 2, thick / 2, thick / 2), head_at)
    )
    parts = (
        Geom("box", tuple(foot / 2), (float(back), 0.0, float(foot[2] - z) / 2)),
        Geom("box", tuple(handle / 2), (float(shift_handle + back), 0.0, float(foot[2] - z / 2 + handle[2] / 2))),
        head,
    )
    return parts, (float(high - low), float(max(foot[1], handle[1], thick)), z)
