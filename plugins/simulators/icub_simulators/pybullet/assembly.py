"""Putting robot, table and objects into a Bullet world."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from icub_core.errors import SimulationError
from icub_core.geometry import FloatArray, matrix_to_quat_wxyz, quat_wxyz_to_matrix
from icub_core.robot_description import ContactMaterial, RobotDescription
from icub_core.scene import Geom, ObjectSpec, Table
from icub_simulators.objects.mass_properties import MassProperties
from icub_simulators.pybullet.client import silence
from icub_simulators.visual_meshes import decimated
from icub_support.cache import cached_file, cached_text

_TINY_MASS, _TINY_INERTIA = 1e-6, 1e-9
_ELLIPSOID_DETAIL = 3


def xyzw(quat_wxyz: Any) -> list[float]:
    """Turn a quaternion into Bullet's order."""
    w, x, y, z = quat_wxyz
    return [float(x), float(y), float(z), float(w)]


def load_robot(client: Any, robot: RobotDescription) -> int:
    """Load the robot, fixed at its root; return its number.

    Raises:
        SimulationError: When the URDF cannot be read.
    """
    position = robot.T_world_root[:3, 3].tolist()
    orientation = xyzw(matrix_to_quat_wxyz(robot.T_world_root[:3, :3]))
    flags = client.URDF_USE_SELF_COLLISION | client.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
    flags |= client.URDF_USE_INERTIA_FROM_FILE
    try:
        path = _prepared_urdf(robot)
        with silence():
            body = client.loadURDF(str(path), position, orientation, useFixedBase=True, flags=flags)
    except (client.error, ET.ParseError, OSError) as error:
        raise SimulationError(f"Bullet cannot read {robot.urdf} of robot '{robot.name}': {error}") from error
    return int(body)


def _prepared_urdf(robot: RobotDescription) -> Path:
    """Write the URDF as Bullet needs it: true capsules, light meshes, no frames without mass (they would get 1 kg)."""
    root = ET.parse(robot.urdf).getroot()
    for link in root.findall("link"):
        if link.find("inertial") is None:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "mass", value=repr(_TINY_MASS))
            moment = repr(_TINY_INERTIA)
            ET.SubElement(inertial, "inertia", ixx=moment, iyy=moment, izz=moment, ixy="0", ixz="0", iyz="0")
        if link.get("name") in robot.capsule_links:
            for cylinder in list(link.iter("cylinder")):
                cylinder.tag = "capsule"
        for element in link.findall("visual"):
            for mesh in element.iter("mesh"):
                mesh.set("filename", str(decimated(Path(mesh.attrib["filename"].removeprefix("file://")))))
    return cached_text("bullet", ET.tostring(root, encoding="unicode"), ".urdf")


def set_robot_contacts(client: Any, body: int, links: dict[str, int], robot: RobotDescription, floor: int) -> None:
    """Give links their friction and switch off the pairs that never collide."""
    default = ContactMaterial()
    for name, link in links.items():
        sliding, torsional, rolling = robot.contacts.get(name, default).friction
        client.changeDynamics(
            body, link, lateralFriction=sliding, spinningFriction=torsional, rollingFriction=rolling,
            linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, restitution=0.0,
        )  # fmt: skip
        client.setCollisionFilterPair(body, floor, link, -1, 0)
    for first, second in robot.contact_excludes:
        client.setCollisionFilterPair(body, body, links[first], links[second], 0)


def add_floor(client: Any) -> int:
    """Add the ground plane, drawn as a large box."""
    shape = client.createCollisionShape(client.GEOM_PLANE)
    look = client.createVisualShape(client.GEOM_BOX, halfExtents=[5.0, 5.0, 0.01], visualFramePosition=[0, 0, -0.01])
    floor = client.createMultiBody(0.0, shape, look)
    client.changeDynamics(floor, -1, lateralFriction=1.0, restitution=0.0)
    return int(floor)


def add_table(client: Any, table: Table) -> int:
    """Add the table top."""
    shape = client.createCollisionShape(client.GEOM_BOX, halfExtents=list(table.half_size))
    look = client.createVisualShape(client.GEOM_BOX, halfExtents=list(table.half_size))
    body = client.createMultiBody(0.0, shape, look, basePosition=list(table.center))
    client.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.0)
    return int(body)


def add_object(client: Any, spec: ObjectSpec, mass: MassProperties, place: FloatArray) -> int:
    """Add an object at `place` (3,); its base frame in Bullet is that of its inertia.

    Bullet multiplies friction coefficients where MuJoCo takes the larger, or that of the geom of higher priority: with
    1 for objects (or more where they ask for it) the product with table, links and fingertips is the same number.
    """
    R = quat_wxyz_to_matrix(mass.quat_wxyz)
    collision = client.createCollisionShapeArray(**_shapes(client, spec.collision, mass.center, R, "collision"))
    visual = client.createVisualShapeArray(**_shapes(client, spec.visual or spec.collision, mass.center, R, "visual"))
    if collision < 0 or visual < 0:
        raise SimulationError(f"Bullet cannot build object '{spec.name}'")
    body = client.createMultiBody(spec.mass, collision, visual, basePosition=place.tolist())
    sliding, torsional, rolling = spec.friction
    client.changeDynamics(
        body, -1, lateralFriction=max(sliding, 1.0), spinningFriction=torsional, rollingFriction=rolling,
        linearDamping=0.0, angularDamping=0.0, restitution=0.0, localInertiaDiagonal=mass.inertia.tolist(),
    )  # fmt: skip
    return int(body)


def _shapes(
    client: Any, pieces: tuple[Geom, ...], center: FloatArray, R: FloatArray, prefix: str
) -> dict[str, list[Any]]:
    """Describe pieces, relative to the inertial frame (center, R), as the arrays that Bullet takes."""
    kinds = {
        "box": client.GEOM_BOX,
        "cylinder": client.GEOM_CYLINDER,
        "sphere": client.GEOM_SPHERE,
        "capsule": client.GEOM_CAPSULE,
        "ellipsoid": client.GEOM_MESH,
        "mesh": client.GEOM_MESH,
    }
    n = len(pieces)
    table: dict[str, list[Any]] = {
        "shapeTypes": [kinds[piece.shape] for piece in pieces],
        "radii": [0.1] * n,
        "halfExtents": [[0.1] * 3] * n,
        "lengths": [0.1] * n,
        "fileNames": [""] * n,
        "meshScales": [[1.0] * 3] * n,
        f"{prefix}FramePositions": [],
        f"{prefix}FrameOrientations": [],
    }
    for i, piece in enumerate(pieces):
        if piece.shape == "box":
            table["halfExtents"][i] = list(piece.size)
        elif piece.shape == "sphere":
            table["radii"][i] = piece.size[0]
        elif piece.shape in ("cylinder", "capsule"):
            table["radii"][i], table["lengths"][i] = piece.size[0], 2 * piece.size[1]
        elif piece.shape == "ellipsoid":
            table["fileNames"][i], table["meshScales"][i] = str(_unit_ball()), list(piece.size)
        else:
            if piece.mesh is None or not piece.mesh.is_file():
                raise SimulationError(f"no mesh file {piece.mesh}")
            table["fileNames"][i], table["meshScales"][i] = str(piece.mesh), [piece.mesh_scale] * 3
        orientation = matrix_to_quat_wxyz(R.T @ quat_wxyz_to_matrix(piece.quat_wxyz))
        table[f"{prefix}FramePositions"].append((R.T @ (np.array(piece.position) - center)).tolist())
        table[f"{prefix}FrameOrientations"].append(xyzw(orientation))
    if prefix == "visual":
        table["lengths"] = table.pop("lengths")
    return table


def _unit_ball() -> Path:
    """Write a ball of radius 1 once (Bullet has no ellipsoid) and return its path."""

    def make() -> bytes:
        import trimesh

        return str(trimesh.exchange.obj.export_obj(trimesh.creation.icosphere(_ELLIPSOID_DETAIL))).encode()

    return cached_file("pieces", f"unit_ball_{_ELLIPSOID_DETAIL}.obj", make)
