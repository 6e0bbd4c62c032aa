"""A floating parallel-jaw gripper and one object on a table, in MuJoCo: the trials that VGN was made with.

The gripper's frame: origin on the palm, z forward along the fingers, y along the opening (Panda's hand: 8 cm wide,
fingers of 5 cm). Its base stands where a trial begins; it advances and lifts on three stiff slides.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from icub_core.data import PointCloud
from icub_core.errors import SimulationError
from icub_core.geometry import FloatArray, look_at, make_transform, matrix_to_quat_wxyz
from icub_core.scene import ObjectSpec

MAX_WIDTH = 0.08
FINGER_DEPTH = 0.05
PRE_GRASP = 0.05
LIFT = 0.10
"""Meters: opening, length of the fingers, way before the grasp and after it."""

_TIMESTEP = 0.004
_SEGMENTS = 5  # of the approach; contact is looked for after each
_SEGMENT_STEPS = 8
_CLOSING_STEPS = 60
_LIFT_SEGMENTS = 8
_HOLD_STEPS = 15
_SETTLE_STEPS = 60
_STIFFNESS, _DAMPING = 4000.0, 80.0  # N/m and Ns/m of the slides, for 0.4 kg
_FINGER_STIFFNESS, _FINGER_DAMPING, _FORCE = 3000.0, 100.0, 30.0  # closes at 0.3 m/s
_SQUEEZE = 0.01  # meters beyond closed that the fingers are sent, so that thin things are held too
_HALF_FINGER = (0.01, 0.006, FINGER_DEPTH / 2)
_HALF_PALM = (0.015, 0.06, 0.02)
_HELD_WIDTH = 0.1  # share of the opening below which nothing is between the fingers
_LOW_ANGLE = np.pi / 3  # from straight down; beyond it the object is lifted before the gripper goes back
_RAYS = 96
_RAY_FIELD = 0.13  # meters around the object that a view shows

_XML = """
<mujoco>
  <option timestep="{dt}" cone="elliptic" impratio="10" integrator="implicitfast"/>
  <worldbody>
    <geom name="table" type="box" size="1 1 0.05" pos="0 0 -0.05"/>
    <body name="base" mocap="true" gravcomp="1">
      <body name="palm" gravcomp="1">
        <joint name="x" type="slide" axis="1 0 0" damping="{damping}"/>
        <joint name="y" type="slide" axis="0 1 0" damping="{damping}"/>
        <joint name="z" type="slide" axis="0 0 1" damping="{damping}"/>
        <geom type="box" size="{palm}" pos="0 0 -{palm_z}" mass="0.3"/>
        <body name="left" gravcomp="1">
          <joint name="left" type="slide" axis="0 1 0" limited="true" range="-0.002 {open}" damping="{slow}"/>
          <geom type="box" size="{finger}" pos="0 {y} {z}" mass="0.05" friction="1 0.01 0.0001" condim="4"/>
        </body>
        <body name="right" gravcomp="1">
          <joint name="right" type="slide" axis="0 -1 0" limited="true" range="-0.002 {open}" damping="{slow}"/>
          <geom type="box" size="{finger}" pos="0 -{y} {z}" mass="0.05" friction="1 0.01 0.0001" condim="4"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="{kp}"/><position joint="y" kp="{kp}"/><position joint="z" kp="{kp}"/>
    <position joint="left" kp="{finger_kp}" forcelimited="true" forcerange="-{force} {force}"/>
    <position joint="right" kp="{finger_kp}" forcelimited="true" forcerange="-{force} {force}"/>
  </actuator>
</mujoco>
"""

_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}
_OBJECT_GROUP = 1


@dataclass(frozen=True)
class Outcome:
    """Of one trial.

    Attributes:
        held: Whether the object came up between the fingers.
        width: Opening at which it was held, meters; the largest otherwise.
    """

    held: bool
    width: float


class GripperWorld:
    """One object on a table whose top is at height 0, and the gripper.

    Args:
        item: The object; its convex pieces collide.

    Attributes:
        center: (3,) the object's center of mass where it was placed, meters.
    """

    def __init__(self, item: ObjectSpec) -> None:
        self._model = _compile(item)
        self._item = item
        self._data = mujoco.MjData(self._model)
        self._object = self._model.body("object").id
        self.center = np.zeros(3)
        self._state = np.zeros(mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_INTEGRATION))

    def place(self, yaw: float) -> bool:
        """Put the object on the table, turned by `yaw`, out of the gripper's way; say whether it stayed upright."""
        model, data = self._model, self._data
        mujoco.mj_resetData(model, data)
        data.mocap_pos[0] = (0.0, 0.0, 1.0)
        half = yaw / 2
        turned = np.zeros(4)
        mujoco.mju_mulQuat(
            turned, np.array([np.cos(half), 0.0, 0.0, np.sin(half)]), np.array(self._item.rest_quat_wxyz)
        )
        start = self._model.body("object").jntadr[0]
        address = model.jnt_qposadr[start]
        data.qpos[address : address + 3] = (0.0, 0.0, self._item.rest_height + 0.001)
        data.qpos[address + 3 : address + 7] = turned
        mujoco.mj_step(model, data, _SETTLE_STEPS)
        mujoco.mj_getState(model, data, self._state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, data)
        self.center = np.array(data.xipos[self._object])
        sunk = abs(float(data.qpos[address + 2]) - self._item.rest_height)
        return sunk < 0.01 and not data.warning.number.any()

    def view(self, eye: FloatArray) -> tuple[PointCloud, FloatArray]:
        """Return what a camera at `eye` (3,) sees of the object where it was placed, and outward normals (N, 3)."""
        self._restore()
        R = look_at(eye, self.center)[:3, :3]
        away = float(np.linalg.norm(self.center - eye))
        line = np.linspace(-_RAY_FIELD / away, _RAY_FIELD / away, _RAYS)
        x, y = np.meshgrid(line, line)
        rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) @ R.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        count = len(rays)
        geom, distance, normals = np.full(count, -1, dtype=np.int32), np.zeros(count), np.zeros(3 * count)
        groups = np.zeros(6, dtype=np.uint8)
        groups[_OBJECT_GROUP] = 1
        mujoco.mj_multiRay(
            self._model, self._data, eye, rays.ravel(), groups, 1, -1, geom, distance, normals, count, 10.0
        )
        hit = geom >= 0
        points = eye + distance[hit, None] * rays[hit]
        return PointCloud(points, viewpoint=np.array(eye)), normals.reshape(-1, 3)[hit]

    def grasp(self, T: FloatArray) -> Outcome:
        """Try the gripper pose T (4, 4): advance, close, lift. Touching anything on the way in is a failure."""
        failed = Outcome(False, MAX_WIDTH)
        if _meets_table(T) or _meets_table(T @ make_transform(None, [0.0, 0.0, -PRE_GRASP])):
            return failed
        model, data = self._model, self._data
        self._restore()
        data.mocap_pos[0] = T[:3, 3] - PRE_GRASP * T[:3, 2]
        data.mocap_quat[0] = matrix_to_quat_wxyz(T[:3, :3])
        data.joint("left").qpos[0] = data.joint("right").qpos[0] = MAX_WIDTH / 2
        data.ctrl[:] = (0.0, 0.0, 0.0, MAX_WIDTH / 2, MAX_WIDTH / 2)
        mujoco.mj_forward(model, data)
        if self._touched():
            return failed
        for segment in range(1, _SEGMENTS + 1):
            data.ctrl[2] = PRE_GRASP * segment / _SEGMENTS
            mujoco.mj_step(model, data, _SEGMENT_STEPS)
            if self._touched():
                return failed
        data.ctrl[3:] = -_SQUEEZE
        mujoco.mj_step(model, data, _CLOSING_STEPS)
        if self._opening() < _HELD_WIDTH * MAX_WIDTH:
            return failed
        up = np.array([0.0, 0.0, LIFT])
        sideways = np.arccos(np.clip(-T[2, 2], -1.0, 1.0)) > _LOW_ANGLE
        way = T[:3, :3].T @ up if sideways else np.array([0.0, 0.0, -LIFT])
        before = float(data.xipos[self._object][2])
        for segment in range(1, _LIFT_SEGMENTS + 1):
            data.ctrl[:3] = np.array([0.0, 0.0, PRE_GRASP]) + way * segment / _LIFT_SEGMENTS
            mujoco.mj_step(model, data, _SEGMENT_STEPS)
        mujoco.mj_step(model, data, _HOLD_STEPS)
        risen = float(data.xipos[self._object][2]) - before
        expected = LIFT if sideways else LIFT * -float(T[2, 2])
        width = self._opening()
        held = risen > 0.7 * expected and width > _HELD_WIDTH * MAX_WIDTH and not data.warning.number.any()
        return Outcome(True, width) if held else failed

    def _restore(self) -> None:
        mujoco.mj_setState(self._model, self._data, self._state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self._model, self._data)

    def _opening(self) -> float:
        return float(self._data.joint("left").qpos[0] + self._data.joint("right").qpos[0])

    def _touched(self) -> bool:
        """Return True if the gripper meets object or table; the object rests on the table, which does not count."""
        bodies = self._model.geom_bodyid[np.asarray(self._data.contact.geom).reshape(-1, 2)]
        return bool(np.any(~np.isin(bodies, (0, self._object))))


def _compile(item: ObjectSpec) -> mujoco.MjModel:
    numbers = {
        "dt": _TIMESTEP, "damping": _DAMPING, "kp": _STIFFNESS, "finger_kp": _FINGER_STIFFNESS,
        "slow": _FINGER_DAMPING, "force": _FORCE,
        "palm": " ".join(map(str, _HALF_PALM)), "palm_z": _HALF_PALM[2] + 1e-3, "open": MAX_WIDTH / 2,
        "finger": " ".join(map(str, _HALF_FINGER)), "y": _HALF_FINGER[1], "z": _HALF_FINGER[2],
    }  # fmt: skip
    spec = mujoco.MjSpec.from_string(_XML.format(**numbers))
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    meshes: dict[tuple[str, float], str] = {}
    for piece in item.collision:
        geom = body.add_geom(
            type=_GEOMS[piece.shape], pos=piece.position, quat=piece.quat_wxyz, group=_OBJECT_GROUP, condim=4
        )
        geom.friction = item.friction
        geom.size[: len(piece.size)] = piece.size
        if piece.mesh is not None:
            key = (str(piece.mesh), piece.mesh_scale)
            if key not in meshes:
                meshes[key] = f"mesh{len(meshes)}"
                spec.add_mesh(name=meshes[key], file=key[0], scale=3 * [piece.mesh_scale])
            geom.meshname = meshes[key]
    try:
        model = spec.compile()
    except ValueError as error:
        raise SimulationError(f"MuJoCo cannot build a world for '{item.name}': {error}") from error
    factor = item.mass / model.body_mass[model.body("object").id]
    model.body_mass[model.body("object").id] *= factor
    model.body_inertia[model.body("object").id] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


_CORNERS = np.array(
    [(x, y, z) for x in (-0.015, 0.015) for y in (-0.06, 0.06) for z in (-0.04, 0.0)]
    + [(x, y, FINGER_DEPTH) for x in (-0.01, 0.01) for y in (-0.052, 0.052)]
)
"""Corners of palm and open fingers, in the gripper's frame, meters."""


def _meets_table(T: FloatArray) -> bool:
    return bool(np.min(_CORNERS @ T[2, :3] + T[2, 3]) < 0.0)
