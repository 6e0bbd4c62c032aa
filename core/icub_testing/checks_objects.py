"""Contract of object sets."""

from __future__ import annotations

import numpy as np

from icub_core.errors import ConfigError
from icub_core.geometry import quat_wxyz_to_matrix
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Geom, ObjectSpec
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_raises

MAX_OBJECTS = 8
"""Objects of a large set that are looked at, spread over the whole set."""
MARGIN = 0.005
"""Meters by which a piece may stick out of the stated extents."""


def _some(names: tuple[str, ...]) -> list[str]:
    chosen = np.linspace(0, len(names) - 1, min(MAX_OBJECTS, len(names))).round().astype(int)
    return [names[i] for i in chosen]


def _half_size(geom: Geom) -> tuple[float, ...] | None:
    """Half extents of a primitive in its own frame; None for a mesh, whose size is in a file."""
    match geom.shape:
        case "box" | "ellipsoid":
            return geom.size
        case "sphere":
            return geom.size * 3
        case "cylinder":
            return (geom.size[0], geom.size[0], geom.size[1])
        case "capsule":
            return (geom.size[0], geom.size[0], geom.size[0] + geom.size[1])
        case _:
            return None


def check_names(make: Make) -> None:
    """There are names, each once, in the same order at every call."""
    objects: ObjectSet = make()
    names = objects.names
    expect(len(names) > 0, "at least one object", 0)
    expect(len(set(names)) == len(names), "every name once", "a name twice")
    expect(names == objects.names == make().names, "the same order at every call", "another one")


def check_get(make: Make) -> None:
    """Every name gives an object of that name."""
    objects = make()
    for name in _some(objects.names):
        spec = objects.get(name)
        expect(isinstance(spec, ObjectSpec), "an ObjectSpec", type(spec).__name__)
        expect(spec.name == name, f"an object named '{name}'", spec.name)


def check_repeatable(make: Make) -> None:
    """The same name gives the same object."""
    first, second = make(), make()
    for name in _some(first.names):
        one, other = first.get(name), second.get(name)
        for field in ("mass", "half_extents", "rest_height", "rest_quat_wxyz", "friction"):
            expect(getattr(one, field) == getattr(other, field), f"the same {field} of '{name}'", getattr(other, field))
        expect(
            [repr(g) for g in one.collision] == [repr(g) for g in other.collision],
            f"the same pieces of '{name}'",
            "others",
        )
        a, b = one.material.texture, other.material.texture
        expect(
            (a is None) == (b is None) and (a is None or np.array_equal(a, b)),
            f"the same texture of '{name}'",
            "another",
        )


def check_unknown(make: Make) -> None:
    """A name that does not exist raises ConfigError with the nearest one."""
    objects = make()
    nearest = objects.names[0]
    error = expect_raises(ConfigError, lambda: objects.get(nearest + "_"), "for an unknown object")
    expect(nearest in str(error), f"a message that names '{nearest}'", str(error))


def check_extents(make: Make) -> None:
    """Primitive pieces lie within the stated extents, and the object stands above the table."""
    objects = make()
    for name in _some(objects.names):
        spec = objects.get(name)
        expect(spec.rest_height > 0, f"a rest height of '{name}' above 0", spec.rest_height)
        expect(
            all(0 < half < 2 for half in spec.half_extents), f"half extents of '{name}' in meters", spec.half_extents
        )
        for geom in spec.collision:
            half = _half_size(geom)
            if half is None:
                continue
            reach = np.abs(quat_wxyz_to_matrix(geom.quat_wxyz)) @ np.asarray(half) + np.abs(geom.position)
            inside = bool(np.all(reach <= np.asarray(spec.half_extents) + MARGIN))
            expect(inside, f"pieces of '{name}' within {spec.half_extents}", reach.round(4).tolist())
