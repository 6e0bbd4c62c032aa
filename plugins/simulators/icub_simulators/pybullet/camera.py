"""Images by Bullet's own software renderer: no graphics library needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame
from icub_core.errors import SimulationError
from icub_core.geometry import FloatArray, invert, pinhole
from icub_core.interfaces.simulator import Rendering
from icub_core.scene import CameraView, Light, Material
from icub_simulators.pybullet.world import World
from icub_support.cache import cached_file, content_key

NEAR, FAR = 0.02, 40.0
_MAX_SIDE = 8192


class Camera:
    """Looks at one world. Bullet draws one light: the first of the scene, with the ambient light of all."""

    def __init__(self, world: World) -> None:
        self._world = world
        scene = world.scene
        self.set_surface(world.floor, scene.floor)
        if world.table is not None and scene.table is not None:
            self.set_surface(world.table, scene.table.material)
        for body, item in zip(world.bodies, scene.objects, strict=True):
            self.set_surface(body, item.material)
        self.lights = scene.lights
        self.backdrop = scene.backdrop

    def set_surface(self, body: int, look: Material) -> None:
        """Paint every shape of a body."""
        client = self._world.client
        texture = -1
        if look.texture is not None:
            texture = client.loadTexture(str(_texture_file(look.texture)))
        for shape in range(len(client.getVisualShapeData(body))):
            client.changeVisualShape(
                body, -1, shapeIndex=shape, rgbaColor=list(look.rgba), textureUniqueId=texture,
                specularColor=[look.specular] * 3,
            )  # fmt: skip

    def render(self, view: CameraView, width: int, height: int, segmentation: bool, shadows: bool) -> Rendering:
        """Draw; see the simulator's interface."""
        if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
            raise SimulationError(f"an image of {width} x {height} pixels; expected 1 to {_MAX_SIDE} a side")
        client = self._world.client
        _, _, rgba, raw, codes = client.getCameraImage(
            width, height, _view_matrix(view.T_world_camera), _projection(view.fovy, width, height),
            renderer=client.ER_TINY_RENDERER, shadow=int(shadows), **self._light(),
        )  # fmt: skip
        rgb = np.ascontiguousarray(np.reshape(rgba, (height, width, 4))[..., :3]).astype(np.uint8)
        raw = np.reshape(raw, (height, width)).astype(np.float32)
        codes = np.reshape(codes, (height, width))
        depth = np.float32(NEAR * FAR) / (np.float32(FAR) - np.float32(FAR - NEAR) * raw)
        nothing = (codes < 0) | (depth > 0.99 * FAR)
        depth[nothing] = 0.0
        rgb[nothing] = (255 * np.asarray(self.backdrop.rgba[:3])).astype(np.uint8)
        intrinsics = pinhole(width, height, view.fovy)
        frame = RgbdFrame(rgb, depth, intrinsics, np.array(view.T_world_camera, dtype=np.float64), self._world.time)
        return Rendering(frame, self._objects(codes) if segmentation else None)

    def _objects(self, codes: NDArray[np.integer]) -> NDArray[np.int32]:
        body = np.where(codes >= 0, codes & ((1 << 24) - 1), -1)
        seen = np.full(codes.shape, -1, np.int32)
        for number, known in enumerate(self._world.bodies):
            seen[body == known] = number
        return seen

    def _light(self) -> dict[str, Any]:
        if not self.lights:
            return {"lightAmbientCoeff": 0.4, "lightDiffuseCoeff": 0.0, "lightSpecularCoeff": 0.0}
        first: Light = self.lights[0]
        ambient = float(np.clip(np.sum([np.mean(light.ambient) for light in self.lights]), 0, 1))
        diffuse = np.asarray(first.diffuse, dtype=np.float64)
        strength = float(diffuse.max())
        return {
            "lightDirection": [-v for v in first.direction],  # Bullet asks where the light is
            "lightColor": (diffuse / max(strength, 1e-6)).tolist(),
            "lightDistance": 5.0,
            "lightAmbientCoeff": ambient,
            "lightDiffuseCoeff": strength,
            "lightSpecularCoeff": 0.1,
        }


def _view_matrix(T_world_camera: FloatArray) -> list[float]:
    """Return the (16,) column-major view matrix of a camera that looks along +z with y down (OpenGL's: -z, y up)."""
    T_world_gl = np.array(T_world_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return [float(v) for v in invert(T_world_gl).T.ravel()]


def _projection(fovy: float, width: int, height: int) -> list[float]:
    """Return the (16,) column-major projection matrix, shifted so that Bullet's samples are the pixels' centers.

    Bullet's renderer samples the corner of a pixel, half a pixel off the center that `intrinsics` state.
    """
    f = 1.0 / np.tan(0.5 * fovy)
    P = np.zeros((4, 4))
    P[0, 0], P[1, 1] = f * height / width, f
    P[0, 2], P[1, 2] = 1.0 / width, 1.0 / height
    P[2, 2], P[2, 3] = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
    P[3, 2] = -1.0
    return [float(v) for v in P.T.ravel()]


def _texture_file(image: NDArray[np.uint8]) -> Path:
    """Write a texture into the cache, where Bullet reads it."""
    name = f"{content_key(image.tobytes(), *image.shape)}.png"
    return cached_file("textures", name, lambda: cv2.imencode(".png", image[..., ::-1])[1].tobytes())
