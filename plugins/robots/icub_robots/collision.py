"""Does a configuration touch the table, or the robot itself? Shapes by coal, through Pinocchio."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from functools import cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from icub_core.geometry import FloatArray, rpy_to_matrix
from icub_core.scene import Table
from icub_robots.kinematics.model import PinocchioModel

TABLE = "table"
_TRUNK = ("root_link", "torso_1", "torso_2", "chest", "head", "r_hip_1", "l_hip_1", "r_upper_leg", "l_upper_leg")
_UPPER_ARM = ("upper_arm",)
_LOWER_ARM = ("elbow_1", "forearm", "wrist_1", "hand")
_HULLS = (*_TRUNK, *(f"{side}_{name}" for side in "rl" for name in (*_UPPER_ARM, *_LOWER_ARM)))


class CollisionChecker:
    """Collisions of links with a table and with each other.

    Hands and forearms have the shapes of the URDF (boxes, capsules); every other link is the convex hull of its visual
    mesh, which never misses a contact but may report one a little early. Checked are: upper arm, forearm, wrist, hand
    and fingers with the table; both arms with each other; upper arms with head and legs; what is below the elbow with
    the whole trunk. Links of one arm are not checked with each other (joint limits keep them apart, and closing fingers
    are meant to touch).

    Args:
        model: The robot.
    """

    def __init__(self, model: PinocchioModel) -> None:
        self._model = model
        self._geometry = pin.buildGeomFromUrdf(model.model, str(model.description.urdf), pin.GeometryType.COLLISION)
        self._shapes: dict[str, list[int]] = {}
        for i, shape in enumerate(self._geometry.geometryObjects):
            link = model.model.frames[shape.parentFrame].name
            if link in model.description.capsule_links:
                cylinder = shape.geometry
                shape.geometry = coal.Capsule(cylinder.radius, 2.0 * cylinder.halfLength)
            elif isinstance(shape.geometry, coal.BVHModelBase):
                shape.geometry = _convex_hull(shape.meshPath, tuple(shape.meshScale.tolist()))
            self._shapes.setdefault(link, []).append(i)
        self._add_hulls(name for name in _HULLS if name not in self._shapes)
        self._table_size: tuple[float, ...] = (1.0, 1.0, 1.0)
        box = pin.GeometryObject(TABLE, 0, pin.SE3.Identity(), coal.Box(*self._table_size))
        self._table = self._geometry.addGeometryObject(box)
        self._add_pairs()
        self._data = pin.GeometryData(self._geometry)
        self._margin, self._with_table = 0.0, True

    def _arm(self, side: str) -> tuple[list[str], list[str]]:
        """Return the links of an arm: above the elbow, and below it with the fingers."""
        letter = side[0]
        fingers = [name for name in self._shapes if name.startswith(f"{letter}_hand_")]
        return [f"{letter}_{name}" for name in _UPPER_ARM], [f"{letter}_{name}" for name in _LOWER_ARM] + fingers

    def _add_hulls(self, links: Iterable[str]) -> None:
        """Add the convex hull of each link's visual mesh."""
        visual = _visual_meshes(self._model)
        for link in links:
            for path, scale, T_link_mesh in visual.get(link, ()):
                frame_id = self._model.frame_id(link)
                frame = self._model.model.frames[frame_id]
                placement = frame.placement * T_link_mesh
                hull = _convex_hull(path, scale)
                shape = pin.GeometryObject(f"{link}_hull", frame.parentJoint, frame_id, placement, hull)
                self._shapes.setdefault(link, []).append(self._geometry.addGeometryObject(shape))

    def _add_pairs(self) -> None:
        pairs: set[tuple[str, str]] = set()
        arms = {side: self._arm(side) for side in ("right", "left")}
        for upper, lower in arms.values():
            pairs |= {(link, TABLE) for link in (*upper, *lower)}
            pairs |= {(link, other) for link in lower for other in _TRUNK}
            pairs |= {(link, other) for link in upper for other in ("head", "r_upper_leg", "l_upper_leg")}
        right, left = (upper + lower for upper, lower in arms.values())
        pairs |= {(link, other) for link in right for other in left}
        self._shapes[TABLE] = [self._table]
        self._names: list[tuple[str, str]] = []
        for first, second in sorted(pairs):
            for a in self._shapes.get(first, ()):
                for b in self._shapes.get(second, ()):
                    self._geometry.addCollisionPair(pin.CollisionPair(a, b))
                    self._names.append((first, second))

    def collisions(self, q: FloatArray, table: Table | None = None, margin: float = 0.0) -> tuple[tuple[str, str], ...]:
        """Return the pairs of links (or link and ``"table"``) that are closer than `margin` meters at `q` (n,)."""
        self._place_table(table)
        if margin != self._margin:
            for request in self._data.collisionRequests:
                request.security_margin = margin
            self._margin = margin
        pin.computeCollisions(
            self._model.model, self._model.data, self._geometry, self._data, self._model.to_pinocchio(q), False
        )
        found = {self._names[i] for i, result in enumerate(self._data.collisionResults) if result.isCollision()}
        if table is None:  # pairs that are switched off keep their last result
            found = {names for names in found if TABLE not in names}
        return tuple(sorted(found))

    def _place_table(self, table: Table | None) -> None:
        if self._with_table != (table is not None):
            self._with_table = table is not None
            switch = self._data.activateCollisionPair if self._with_table else self._data.deactivateCollisionPair
            for i, names in enumerate(self._names):
                if TABLE in names:
                    switch(i)
        if table is None:
            return
        shape = self._geometry.geometryObjects[self._table]
        size = tuple(2.0 * half for half in table.half_size)
        if size != self._table_size:
            shape.geometry = coal.Box(*size)
            self._table_size = size
        shape.placement = pin.SE3(np.eye(3), np.array(table.center))


@cache
def _convex_hull(path: str, scale: tuple[float, ...]) -> Any:
    mesh = coal.MeshLoader().load(path, np.array(scale))
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


def _visual_meshes(model: PinocchioModel) -> dict[str, list[tuple[str, tuple[float, ...], Any]]]:
    """Return, by link, the visual meshes: file, scale, pose in the link."""
    meshes: dict[str, list[tuple[str, tuple[float, ...], Any]]] = {}
    for link in ET.parse(model.description.urdf).getroot().findall("link"):
        for visual in link.findall("visual"):
            mesh, origin = visual.find("geometry/mesh"), visual.find("origin")
            if mesh is None or origin is None:
                continue
            xyz, rpy = (np.array([float(x) for x in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
            scale = tuple(float(x) for x in mesh.get("scale", "1 1 1").split())
            pose = pin.SE3(rpy_to_matrix(rpy), xyz)
            meshes.setdefault(link.attrib["name"], []).append((mesh.attrib["filename"], scale, pose))
    return meshes
