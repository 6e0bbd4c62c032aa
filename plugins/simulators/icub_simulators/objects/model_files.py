"""Rigid objects described by URDF and MJCF files: their shapes as triangles, and their mass."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import make_transform, quat_wxyz_to_matrix
from icub_simulators.objects.meshes import IntArray, read_mesh

FloatArray = NDArray[np.float64]
Triangles = tuple[FloatArray, IntArray]

MODEL_SUFFIXES = (".urdf", ".xml")


@dataclass(frozen=True, eq=False)
class RigidModel:
    """What a model file describes, in its own frame and unit.

    Attributes:
        solids: Vertices (V, 3) and faces (F, 3) of every shape that collides.
        surface: Those of everything that is drawn.
        mass: kg as stated; 0 where the file states none.
    """

    solids: list[Triangles]
    surface: Triangles
    mass: float


def read_model(path: Path) -> RigidModel:
    """Read a URDF or MJCF file of one rigid object.

    MuJoCo reads the file, but takes only the first of several shapes of an OBJ; the meshes are therefore read again.

    Raises:
        DataError: For a file that cannot be read, has movable parts, or has no shape.
    """
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = False
        spec.compiler.fusestatic = False  # a URDF's first link would become part of the world, without its mass
        folder = path.parent / spec.meshdir
        files = {mesh.name: folder / mesh.file for mesh in spec.meshes}
        stated = any(body.explicitinertial or body.mass > 0 for body in spec.bodies[1:])
        model = spec.compile()
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"object file {path} cannot be read: {reason}") from error
    moving = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_FREE]
    if moving:
        raise DataError(f"object file {path} has the movable joint '{moving[0]}'; expected one rigid object")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solids: list[Triangles] = []
    drawn: list[Triangles] = []
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        vertices, faces = _triangles(model, geom, files)
        T = make_transform(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        shape = (vertices @ T[:3, :3].T + T[:3, 3], faces)
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        (solids if collides else drawn).append(shape)
    solids = solids or drawn
    if not solids:
        raise DataError(f"object file {path} has no shape; expected geometry of at least one solid")
    return RigidModel(solids, _joined(drawn or solids), float(model.body_mass.sum()) if stated else 0.0)


def _triangles(model: object, geom: int, files: dict[str, Path]) -> Triangles:
    """Return one shape in the frame of its geom."""
    import mujoco
    import trimesh

    assert isinstance(model, mujoco.MjModel)
    kind, size = model.geom_type[geom], model.geom_size[geom]
    types = mujoco.mjtGeom
    if kind == types.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        vertices, faces = read_mesh(files[model.mesh(mesh).name])
        vertices = vertices * model.mesh_scale[mesh]
        # the engine has moved the mesh to its center and axes, and the geom the other way
        R = quat_wxyz_to_matrix(model.mesh_quat[mesh])
        return (vertices - model.mesh_pos[mesh]) @ R, faces
    if kind == types.mjGEOM_BOX:
        solid = trimesh.creation.box(extents=2 * size)
    elif kind == types.mjGEOM_CYLINDER:
        solid = trimesh.creation.cylinder(radius=size[0], height=2 * size[1])
    elif kind == types.mjGEOM_CAPSULE:
        solid = trimesh.creation.capsule(radius=size[0], height=2 * size[1])  # centered, along z
    elif kind in (types.mjGEOM_SPHERE, types.mjGEOM_ELLIPSOID):
        solid = trimesh.creation.icosphere(subdivisions=3)
        solid.apply_scale(size if kind == types.mjGEOM_ELLIPSOID else size[0])
    else:
        raise DataError(f"a shape of kind {types(int(kind)).name} is no solid; expected boxes, cylinders, meshes, ...")
    return np.asarray(solid.vertices, dtype=np.float64), np.asarray(solid.faces, dtype=np.int64)


def _joined(shapes: list[Triangles]) -> Triangles:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in shapes[:-1]])
    faces = [faces + start for (_, faces), start in zip(shapes, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in shapes]), np.concatenate(faces)
