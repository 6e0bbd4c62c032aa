"""Images of a world: color and depth in one pass, segmentation in a second."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame
from icub_core.errors import SimulationError
from icub_core.geometry import FloatArray, pinhole
from icub_core.interfaces.simulator import Rendering
from icub_core.robot_description import RobotDescription
from icub_core.scene import CameraView, Light, Material, Scene, Table
from icub_simulators.mujoco.builder import OBJECT_PREFIX, build_spec, compile_model, table_legs
from icub_simulators.mujoco.looks import (
    BACKDROP,
    FLOOR,
    TABLE,
    backdrop_image,
    dress,
    fill_textures,
    set_lights,
    set_surface,
    set_texture,
)
from icub_support.gl import make_context

_Frustum = tuple[FloatArray, FloatArray]

_PARKED_GROUP = 5
_SHOWN_GROUPS = (0, 1, 2)
_MAX_GEOMS = 4000
_MIN_BUFFER = (64, 64)
"""Pixels that graphics memory is reserved for at first; it grows with the images, and a larger one is slower."""
_MAX_SIDE = 8192
PLAIN, PRETTY = False, True
"""Two ways of drawing: without shadows and smoothing (fast), with both."""


class Renderer:
    """Draws one world. It has a model of its own, with meshes and textures, so that physics carries none of them.

    Raises SimulationError (one line, with what to install) when this machine cannot draw.
    """

    def __init__(self, robot: RobotDescription | None, scene: Scene) -> None:
        self._gl: Any = make_context("mujoco")
        spec = build_spec(robot, scene, visual=True)
        dress(spec, scene)
        self.model = compile_model(spec)
        self._data = mujoco.MjData(self.model)
        self._scene = mujoco.MjvScene(self.model, maxgeom=_MAX_GEOMS)
        self._camera = mujoco.MjvCamera()
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = [group in _SHOWN_GROUPS for group in range(len(self._options.geomgroup))]
        self._options.flags[:] = 0
        self._options.flags[int(mujoco.mjtVisFlag.mjVIS_TEXTURE)] = 1
        self._options.flags[int(mujoco.mjtVisFlag.mjVIS_STATIC)] = 1
        self._contexts: dict[bool, mujoco.MjrContext] = {}
        self._buffer = _MIN_BUFFER
        self._group = self.model.geom_group.copy()
        self._radius = np.where(self.model.geom_rbound > 0, self.model.geom_rbound, np.inf)  # planes end nowhere
        bodies = [self.model.body(OBJECT_PREFIX + item.name).id for item in scene.objects]
        self._geoms_of = [np.nonzero(self.model.geom_bodyid == body)[0] for body in bodies]
        self._object_of_geom = np.full(self.model.ngeom + 1, -1, np.int32)
        for number, geoms in enumerate(self._geoms_of):
            self._object_of_geom[geoms] = number
        self._flat_backdrop = _flat_color(scene.backdrop)
        self._center = np.array([-0.4, 0.0, scene.table.top if scene.table is not None else 0.0])
        self._table = scene.table
        self._legs = table_legs(self.model)
        fill_textures(self.model, scene)
        set_lights(self.model, scene.lights, self._center)

    def render(
        self, qpos: FloatArray, parked: NDArray[np.bool_], view: CameraView, width: int, height: int,
        segmentation: bool, shadows: bool, stamp: float,
    ) -> Rendering:  # fmt: skip
        """Draw the world with its joints and objects at `qpos` as `view` sees it; see the simulator's interface."""
        if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
            raise SimulationError(f"an image of {width} x {height} was asked for; expected 1 to {_MAX_SIDE} a side")
        self._pose(qpos, parked, None if shadows else view, width / height)
        self._aim(view, width, height)
        rgb, depth = self._draw(PRETTY if shadows else PLAIN, width, height, ids=False)
        objects = None
        if segmentation:
            codes, depth = self._draw(PLAIN, width, height, ids=True)  # smoothing would blend numbers and depths
            objects = self._objects(codes)
        intrinsics = pinhole(width, height, view.fovy)
        frame = RgbdFrame(rgb, depth, intrinsics, np.array(view.T_world_camera, dtype=np.float64), stamp)
        return Rendering(frame, objects)

    def set_appearance(
        self,
        table: Material | None,
        floor: Material | None,
        backdrop: Material | None,
        lights: Sequence[Light] | None,
    ) -> None:
        """Change what is given; see the simulator's interface."""
        changed = []
        for name, look in ((TABLE, table), (FLOOR, floor)):
            if look is not None:
                changed.append(set_surface(self.model, name, look))
        if backdrop is not None:
            self._flat_backdrop = _flat_color(backdrop)
            changed.append(set_texture(self.model, BACKDROP, backdrop_image(backdrop)))
        if lights is not None:
            if len(lights) > self.model.nlight:
                raise SimulationError(
                    f"{len(lights)} lights were asked for; this world has room for {self.model.nlight}"
                )
            set_lights(self.model, lights, self._center)
        self._gl.make_current()
        for context in self._contexts.values():
            for texture in changed:
                mujoco.mjr_uploadTexture(self.model, context, texture)

    def close(self) -> None:
        """Free the graphics memory."""
        if self._gl is None:
            return
        self._gl.make_current()
        for context in self._contexts.values():
            context.free()
        self._contexts.clear()
        self._gl.free()
        self._gl = None

    def _pose(self, qpos: FloatArray, parked: NDArray[np.bool_], view: CameraView | None, aspect: float) -> None:
        """Bring the drawn scene up to date; with a view, leave out what it cannot show.

        Without shadows nothing outside of the image can change it, and most of the robot is behind its own camera.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_camlight(self.model, self._data)
        group = self.model.geom_group
        group[:] = self._group
        for number in np.nonzero(parked)[0]:
            group[self._geoms_of[number]] = _PARKED_GROUP
        if view is not None:
            normals, offsets = _frustum(view, aspect)
            beyond = self._data.geom_xpos @ normals.T - offsets > self._radius[:, None]  # (ngeom, 4)
            group[beyond.any(axis=1)] = _PARKED_GROUP
            if self._table is not None and len(self._legs):
                group[self._legs[self._behind_top(view.T_world_camera[:3, 3], self._table)]] = _PARKED_GROUP
        mujoco.mjv_updateScene(
            self.model, self._data, self._options, None, self._camera, int(mujoco.mjtCatBit.mjCAT_ALL), self._scene
        )

    def _behind_top(self, eye: FloatArray, table: Table) -> NDArray[np.bool_]:
        """Return which legs (L,) the table's top hides from an eye (3,) above it: those whose feet it hides."""
        height = eye[2] - table.top
        if height <= 0:
            return np.zeros(len(self._legs), dtype=np.bool_)
        radius, half_length = self.model.geom_size[self._legs, :2].T
        feet = self._data.geom_xpos[self._legs]
        share = height / (eye[2] - feet[:, 2] + half_length)  # of the way from eye to foot, at the top
        crossing = eye[:2] + (feet[:, :2] - eye[:2]) * share[:, None] - table.center[:2]
        return np.asarray(np.all(np.abs(crossing) + radius[:, None] < table.half_size[:2], axis=1))

    def _aim(self, view: CameraView, width: int, height: int) -> None:
        """Overwrite the drawing camera (both eyes) by the wanted one."""
        T = view.T_world_camera
        near = self.model.vis.map.znear * self.model.stat.extent
        top = near * np.tan(0.5 * view.fovy)
        for eye in self._scene.camera:
            eye.pos = T[:3, 3]
            eye.forward = T[:3, 2]
            eye.up = -T[:3, 1]
            eye.orthographic = 0
            eye.frustum_center = 0.0
            eye.frustum_width = top * width / height
            eye.frustum_top, eye.frustum_bottom = top, -top
            eye.frustum_near, eye.frustum_far = near, self.model.vis.map.zfar * self.model.stat.extent

    def _draw(self, style: bool, width: int, height: int, ids: bool) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw and read color (or geom numbers) and metric depth, top row first."""
        self._gl.make_current()
        context = self._context(style, width, height)
        flags = self._scene.flags
        flags[int(mujoco.mjtRndFlag.mjRND_SHADOW)] = style is PRETTY
        flags[int(mujoco.mjtRndFlag.mjRND_REFLECTION)] = 0
        flags[int(mujoco.mjtRndFlag.mjRND_HAZE)] = 0
        fill = self._flat_backdrop if style is PLAIN and not ids else None
        flags[int(mujoco.mjtRndFlag.mjRND_SKYBOX)] = fill is None and not ids
        flags[int(mujoco.mjtRndFlag.mjRND_SEGMENT)] = ids
        flags[int(mujoco.mjtRndFlag.mjRND_IDCOLOR)] = ids
        viewport = mujoco.MjrRect(0, 0, width, height)
        rgb = np.empty((height, width, 3), np.uint8)
        raw = np.empty((height, width), np.float32)
        mujoco.mjr_render(viewport, self._scene, context)
        mujoco.mjr_readPixels(rgb, raw, viewport, context)
        near, far = np.float32(self._scene.camera[0].frustum_near), np.float32(self._scene.camera[0].frustum_far)
        depth = near * far / (near + raw[::-1] * (far - near))  # 1 is near, 0 is far
        rgb = np.ascontiguousarray(rgb[::-1])
        nothing = depth > 0.99 * far
        if nothing.any():
            depth[nothing] = 0.0
            if fill is not None:
                rgb[nothing] = fill
        return rgb, depth

    def _objects(self, codes: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Turn the colors of a segmentation pass into object numbers."""
        segment = (
            codes[..., 0].astype(np.int32) | codes[..., 1].astype(np.int32) << 8 | codes[..., 2].astype(np.int32) << 16
        )
        table = np.full(self._scene.ngeom + 1, -1, np.int32)
        kind = int(mujoco.mjtObj.mjOBJ_GEOM)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == kind and geom.segid >= 0:
                table[geom.segid + 1] = self._object_of_geom[geom.objid]
        return table[segment]

    def _context(self, style: bool, width: int, height: int) -> mujoco.MjrContext:
        """Return the drawing context of a style, made when first used, with a buffer of at least the given size."""
        if width > self._buffer[0] or height > self._buffer[1]:
            self._buffer = (max(width, self._buffer[0]), max(height, self._buffer[1]))
            for existing in self._contexts.values():
                mujoco.mjr_resizeOffscreen(*self._buffer, existing)
        if style not in self._contexts:
            self.model.vis.global_.offwidth, self.model.vis.global_.offheight = self._buffer
            self.model.vis.quality.offsamples = 4 if style is PRETTY else 0
            self.model.vis.quality.shadowsize = 1024 if style is PRETTY else 0
            context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100)
            context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # most precise far away
            self._contexts[style] = context
        context = self._contexts[style]
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        return context


def _frustum(view: CameraView, aspect: float) -> _Frustum:
    """Return normals (4, 3) and offsets (4,) of the image's edge planes, world frame: n x > offset outside."""
    half_y = 0.5 * view.fovy
    half_x = np.arctan(np.tan(half_y) * aspect)
    sx, cx, sy, cy = np.sin(half_x), np.cos(half_x), np.sin(half_y), np.cos(half_y)
    in_camera = np.array([[cx, 0.0, -sx], [-cx, 0.0, -sx], [0.0, cy, -sy], [0.0, -cy, -sy]])
    T = view.T_world_camera
    normals = in_camera @ T[:3, :3].T
    return normals, normals @ T[:3, 3]


def _flat_color(look: Material) -> NDArray[np.uint8] | None:
    """Return the color (3,) of a backdrop without texture: filling pixels in is faster than drawing a sky box."""
    return backdrop_image(look)[0, 0] if look.texture is None else None
