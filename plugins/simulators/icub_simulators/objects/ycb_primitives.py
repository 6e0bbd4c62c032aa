"""Eight objects of the YCB set as primitives of the published size, mass and friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from icub_core.errors import ConfigError, unknown_name
from icub_core.interfaces.object_set import ObjectSet
from icub_core.scene import Geom, Material, ObjectSpec, QuatWxyz, Vec3
from icub_simulators.objects.textures import Pattern, Rgb, print_texture

FRICTION: Vec3 = (0.5, 0.005, 0.0001)  # of the YCB objects in the thesis's scene

_ALONG_X: QuatWxyz = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # turns a cylinder's z axis to x
_SIDEWAYS: QuatWxyz = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # 90 degrees about x: y stands up


def _box(x: float, y: float, z: float) -> tuple[Geom, ...]:
    return (Geom("box", (x / 2, y / 2, z / 2)),)


def _bottle(x: float, y: float, z: float, *, body: float, cap_radius: float) -> tuple[Geom, ...]:
    """Build a body with rounded narrow sides (a box and two cylinders) of height `body`, and a round cap above it."""
    radius, offset, center = x / 2, (y - x) / 2, (body - z) / 2
    cap = z - body
    return (
        Geom("box", (radius, offset, body / 2), (0.0, 0.0, center)),
        Geom("cylinder", (radius, body / 2), (0.0, offset, center)),
        Geom("cylinder", (radius, body / 2), (0.0, -offset, center)),
        Geom("cylinder", (cap_radius, cap / 2), (0.0, 0.0, (z - cap) / 2)),
    )


def _drill() -> tuple[Geom, ...]:
    """Build foot with battery, handle, motor housing and chuck inside 0.184 x 0.057 x 0.187 m (x forward, z up)."""
    return (
        Geom("box", (0.050, 0.0285, 0.020), (-0.030, 0.0, -0.0735)),
        Geom("box", (0.0175, 0.023, 0.046), (-0.030, 0.0, -0.0075)),
        Geom("cylinder", (0.0275, 0.063), (-0.029, 0.0, 0.066), _ALONG_X),
        Geom("cylinder", (0.0140, 0.029), (0.063, 0.0, 0.066), _ALONG_X),
    )


@dataclass(frozen=True)
class _Entry:
    size: Vec3  # of the surrounding box, meters
    mass: float  # kg
    build: Callable[[], tuple[Geom, ...]]
    pattern: Pattern
    base: Rgb
    ink: Rgb
    text: str
    rest: QuatWxyz = (1.0, 0.0, 0.0, 0.0)
    rest_height: float = 0.0  # 0: half of the z size


_CATALOG: dict[str, _Entry] = {
    "003_cracker_box": _Entry(
        (0.060, 0.158, 0.210), 0.411, lambda: _box(0.060, 0.158, 0.210), "label", (190, 30, 25), (215, 60, 20), "CRACK"
    ),
    # stands on its narrow side, as in the thesis: 0.038 wide, 0.175 long, 0.089 high
    "004_sugar_box": _Entry(
        (0.038, 0.089, 0.175), 0.514, lambda: _box(0.038, 0.089, 0.175), "stripes", (238, 226, 150), (40, 70, 160), "",
        _SIDEWAYS, 0.0445,
    ),
    "005_tomato_soup_can": _Entry(
        (0.066, 0.066, 0.101), 0.349, lambda: (Geom("cylinder", (0.033, 0.0505)),), "bands", (200, 25, 35),
        (240, 238, 230), "",
    ),
    "006_mustard_bottle": _Entry(
        (0.058, 0.095, 0.190), 0.603, lambda: _bottle(0.058, 0.095, 0.190, body=0.150, cap_radius=0.014), "label",
        (235, 190, 20), (160, 30, 20), "MSTRD",
    ),
    "008_pudding_box": _Entry(
        (0.035, 0.110, 0.089), 0.187, lambda: _box(0.035, 0.110, 0.089), "rings", (110, 60, 35), (225, 175, 140), ""
    ),
    "010_potted_meat_can": _Entry(
        (0.050, 0.097, 0.082), 0.370, lambda: _box(0.050, 0.097, 0.082), "checks", (40, 70, 135), (225, 200, 60), ""
    ),
    "021_bleach_cleanser": _Entry(
        (0.065, 0.098, 0.250), 1.131, lambda: _bottle(0.065, 0.098, 0.250, body=0.195, cap_radius=0.017), "blobs",
        (232, 236, 240), (40, 135, 190), "",
    ),
    "035_power_drill": _Entry(
        (0.184, 0.057, 0.187), 0.895, _drill, "diagonal", (225, 95, 20), (35, 35, 40), ""
    ),
}  # fmt: skip


class YcbPrimitives(ObjectSet):
    """The eight YCB objects of the thesis, built from boxes and cylinders.

    Origins are the centers of the surrounding boxes. Sizes and masses are the published ones; each object has a color
    and a print of its own, which stand in for the photographs on the original meshes.

    Source: thesis 12.4; rest poses are those of its grasping scenes, stated in the primitives' own axes.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """The eight names, by YCB number."""
        return tuple(_CATALOG)

    def get(self, name: str) -> ObjectSpec:
        """Build one object; raises ConfigError for a name that is not in the set."""
        if name not in _CATALOG:
            raise ConfigError(unknown_name("object in 'ycb_primitives'", name, _CATALOG))
        entry = _CATALOG[name]
        x, y, z = entry.size
        return ObjectSpec(
            name=name,
            collision=entry.build(),
            mass=entry.mass,
            half_extents=(x / 2, y / 2, z / 2),
            rest_height=entry.rest_height or z / 2,
            rest_quat_wxyz=entry.rest,
            material=Material(texture=print_texture(entry.pattern, entry.base, entry.ink, int(name[:3]), entry.text)),
            friction=FRICTION,
        )
