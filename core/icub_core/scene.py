"""What stands in a world besides the robot: objects, table, lights, cameras. Data only; simulators build it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError

Shape = Literal["box", "cylinder", "sphere", "ellipsoid", "capsule", "mesh"]
Rgba = tuple[float, float, float, float]
Vec3 = tuple[float, float, float]
QuatWxyz = tuple[float, float, float, float]

NUMBER_OF_SIZES = {"box": 3, "cylinder": 2, "sphere": 1, "ellipsoid": 3, "capsule": 2, "mesh": 0}


@dataclass(frozen=True, eq=False)
class Geom:
    """One convex piece of an object, in the object's frame.

    Attributes:
        shape: Kind of solid.
        size: Meters: box and ellipsoid half extents (3); cylinder and capsule (radius, half length along z); sphere
            (radius,); mesh () - its size is in the file.
        position: Center in the object's frame.
        quat_wxyz: Orientation in the object's frame.
        mesh: OBJ or STL file, for shape ``"mesh"``; its hull is what collides.
        mesh_scale: Factor from the file's unit to meters.
    """

    shape: Shape
    size: tuple[float, ...] = ()
    position: Vec3 = (0.0, 0.0, 0.0)
    quat_wxyz: QuatWxyz = (1.0, 0.0, 0.0, 0.0)
    mesh: Path | None = None
    mesh_scale: float = 1.0

    def __post_init__(self) -> None:
        expected = NUMBER_OF_SIZES[self.shape]
        if len(self.size) != expected or any(not s > 0 for s in self.size):
            raise DataError(f"a {self.shape} has size {self.size}; expected {expected} positive half extents in meters")
        if (self.shape == "mesh") != (self.mesh is not None):
            raise DataError(f"a {self.shape} geom has mesh={self.mesh}; exactly the shape 'mesh' needs a file")


@dataclass(frozen=True, eq=False)
class Material:
    """Color, or a texture mapped on all six sides of the object (cube mapping, needs no UV coordinates).

    Attributes:
        rgba: Base color, 0..1; multiplies the texture.
        texture: (S, S, 3) uint8 square image, or None.
        specular, shininess: 0..1.
    """

    rgba: Rgba = (0.7, 0.7, 0.7, 1.0)
    texture: NDArray[np.uint8] | None = None
    specular: float = 0.2
    shininess: float = 0.3


@dataclass(frozen=True)
class RestPose:
    """One way in which an object stands on a table.

    Attributes:
        quat_wxyz: Orientation; any turn about the vertical is the same pose.
        height: Of the object's origin above the table top, meters.
        share: Of drops in every orientation that ended so, 0..1; None where nothing was dropped.
    """

    quat_wxyz: QuatWxyz
    height: float
    share: float | None = None


@dataclass(frozen=True, eq=False)
class ObjectSpec:
    """One rigid object.

    Attributes:
        name: Unique in its set.
        collision: Convex pieces that collide.
        visual: What is drawn; empty means the collision pieces.
        mass: Kilograms, with inertia from the collision pieces at uniform density.
        friction: Sliding, torsional, rolling coefficients.
        rest_quat_wxyz: Orientation in which it stands on a table.
        rest_height: Height of the object's origin above the table top in that orientation, meters.
        half_extents: Half size of the axis-aligned box around the object in its own frame, centered on the origin.
        rest_poses: Known ways to stand, the stated one first, then by frequency; may be empty.
    """

    name: str
    collision: tuple[Geom, ...]
    mass: float
    half_extents: Vec3
    rest_height: float
    rest_quat_wxyz: QuatWxyz = (1.0, 0.0, 0.0, 0.0)
    visual: tuple[Geom, ...] = ()
    material: Material = field(default_factory=Material)
    friction: Vec3 = (0.5, 0.005, 0.0001)
    rest_poses: tuple[RestPose, ...] = ()

    def __post_init__(self) -> None:
        if not self.collision:
            raise DataError(f"object '{self.name}' has no collision piece")
        if not self.mass > 0:
            raise DataError(f"object '{self.name}' has mass {self.mass}; expected kilograms above 0")


@dataclass(frozen=True, eq=False)
class Table:
    """A box to put things on.

    Attributes:
        center: World position of the box's center; half_size: meters.
    """

    center: Vec3 = (-0.68, 0.0, 0.9)
    half_size: Vec3 = (0.5, 1.0, 0.05)
    material: Material = field(default_factory=lambda: Material(rgba=(0.55, 0.42, 0.3, 1.0)))

    @property
    def top(self) -> float:
        """World height of the table top, meters."""
        return self.center[2] + self.half_size[2]


@dataclass(frozen=True)
class Light:
    """A directional light: `direction` is where it shines, `diffuse` its color."""

    direction: Vec3 = (0.5, -0.35, -1.0)
    diffuse: Vec3 = (0.6, 0.6, 0.6)
    ambient: Vec3 = (0.3, 0.3, 0.3)


@dataclass(frozen=True, eq=False)
class Scene:
    """A world without its robot.

    Attributes:
        objects: Every object that may appear; a simulator creates all of them, in this order.
        table: None for an empty floor.
        floor, backdrop: Materials of the ground plane and of what is behind everything.
        timestep: Physics step, seconds.
    """

    objects: tuple[ObjectSpec, ...] = ()
    table: Table | None = field(default_factory=Table)
    lights: tuple[Light, ...] = (Light(),)
    floor: Material = field(default_factory=lambda: Material(rgba=(0.35, 0.37, 0.4, 1.0)))
    timestep: float = 0.005
    backdrop: Material = field(default_factory=lambda: Material(rgba=(0.62, 0.68, 0.75, 1.0)))

    def __post_init__(self) -> None:
        names = [o.name for o in self.objects]
        if len(set(names)) != len(names):
            raise DataError(f"a scene names an object twice: {sorted(n for n in names if names.count(n) > 1)[0]}")


@dataclass(frozen=True, eq=False)
class CameraView:
    """Where a free camera stands and what it sees.

    Attributes:
        T_world_camera: (4, 4), camera z forward, y down.
        fovy: Vertical field of view, radians.
    """

    T_world_camera: NDArray[np.float64]
    fovy: float = 0.7410801
