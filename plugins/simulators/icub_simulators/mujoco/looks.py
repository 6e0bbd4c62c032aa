"""Materials, textures and lights: put into a specification before it is compiled, changed in the model afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from icub_core.scene import Light, Material, Scene
from icub_simulators.mujoco.builder import FLOOR_GEOM, OBJECT_PREFIX, TABLE_BODY
from icub_simulators.mujoco.robot_spec import HIDDEN_GROUP

TEXTURE_SIZE = 256
"""Side of the images that table, floor and backdrop can be given at any time, pixels."""
FLOOR_TILES = 5.0
"""How often the floor's image is repeated along its 10 m."""
LIGHT_SLOTS = 4
"""Lights that the model has room for; those that a scene does not use are off."""
LIGHT_DISTANCE = 2.5
"""Meters from the middle of the scene at which the shadow map of a directional light starts."""

TABLE, FLOOR, BACKDROP = "look/table", "look/floor", "look/backdrop"
PLAIN = "/plain"
"""Suffix of the untextured twin of a material: in software, texturing doubles the time of a small image."""


def dress(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Give everything in the specification its material, and add lights and backdrop."""
    _set_visual(spec)
    _add_material(spec, FLOOR, scene.floor, mujoco.mjtTexture.mjTEXTURE_2D, TEXTURE_SIZE).texrepeat = [FLOOR_TILES] * 2
    _add_material(spec, FLOOR + PLAIN, scene.floor, mujoco.mjtTexture.mjTEXTURE_2D, 0)
    if scene.table is not None:
        _add_material(spec, TABLE, scene.table.material, mujoco.mjtTexture.mjTEXTURE_CUBE, TEXTURE_SIZE)
        _add_material(spec, TABLE + PLAIN, scene.table.material, mujoco.mjtTexture.mjTEXTURE_CUBE, 0)
    _add_texture(spec, BACKDROP, TEXTURE_SIZE, mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    for item in scene.objects:
        name = f"look/{item.name}"
        size = len(item.material.texture) if item.material.texture is not None else 0
        _add_material(spec, name, item.material, mujoco.mjtTexture.mjTEXTURE_CUBE, size)
        for geom in spec.body(OBJECT_PREFIX + item.name).geoms:
            if geom.group != HIDDEN_GROUP:
                geom.material = name
    for slot in range(max(LIGHT_SLOTS, len(scene.lights))):
        spec.worldbody.add_light(name=f"light/{slot}", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, active=False)


def _set_visual(spec: mujoco.MjSpec) -> None:
    spec.stat.extent = 1.0  # clipping planes and shadow maps are multiples of it
    spec.stat.center = [-0.4, 0.0, 1.0]
    visual = spec.visual
    visual.map.znear, visual.map.zfar = 0.02, 40.0
    visual.map.shadowclip, visual.map.shadowscale = 1.2, 1.0
    visual.headlight.active = 1  # carries the ambient light: that of a lamp does not reach into its own shadow
    visual.quality.numslices, visual.quality.numstacks, visual.quality.numquads = 20, 10, 1


def _add_material(
    spec: mujoco.MjSpec, name: str, look: Material, kind: mujoco.mjtTexture, size: int
) -> mujoco.MjsMaterial:
    """Add a material; with `size` > 0 it has a texture of that side, white where the look has none."""
    material = spec.add_material(
        name=name, rgba=look.rgba, specular=look.specular, shininess=look.shininess, reflectance=0.0
    )
    if size:
        _add_texture(spec, name, size, kind)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return material


def _add_texture(spec: mujoco.MjSpec, name: str, size: int, kind: mujoco.mjtTexture) -> None:
    """Reserve a texture: the image comes after compilation, where it is one copy instead of a list of numbers."""
    spec.add_texture(
        name=name, type=kind, nchannel=3, width=size, height=size, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT
    )


def fill_textures(model: mujoco.MjModel, scene: Scene) -> None:
    """Put the scene's images into a compiled model."""
    set_surface(model, FLOOR, scene.floor)
    set_texture(model, BACKDROP, backdrop_image(scene.backdrop))
    if scene.table is not None:
        set_surface(model, TABLE, scene.table.material)
    for item in scene.objects:
        if item.material.texture is not None:
            set_texture(model, f"look/{item.name}", item.material.texture)


def texture_data(image: NDArray[np.uint8], flat: bool) -> NDArray[np.uint8]:
    """Lay an image out as MuJoCo keeps it: once, or on the six faces of a cube."""
    return np.ascontiguousarray(image if flat else np.concatenate([image] * 6)).reshape(-1)


def image_of(look: Material, size: int) -> NDArray[np.uint8]:
    """Return the look's texture at the given side, white where it has none."""
    if look.texture is None:
        return np.full((size, size, 3), 255, np.uint8)
    if len(look.texture) == size:
        return look.texture
    return np.asarray(cv2.resize(look.texture, (size, size), interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def backdrop_image(look: Material) -> NDArray[np.uint8]:
    """Return what the sky box shows: it knows no material, so the color goes into the image."""
    return (image_of(look, TEXTURE_SIZE) * np.asarray(look.rgba[:3])).astype(np.uint8)


def set_surface(model: mujoco.MjModel, name: str, look: Material) -> int:
    """Change the look of the table or the floor in a compiled model; return its texture's number, to be uploaded."""
    for variant in (name, name + PLAIN):
        material = model.material(variant).id
        model.mat_rgba[material] = look.rgba
        model.mat_specular[material], model.mat_shininess[material] = look.specular, look.shininess
    chosen = model.material(name if look.texture is not None else name + PLAIN).id
    if name == FLOOR:
        model.geom_matid[model.geom(FLOOR_GEOM).id] = chosen
    else:
        model.geom_matid[model.geom_bodyid == model.body(TABLE_BODY).id] = chosen
    return set_texture(model, name, image_of(look, TEXTURE_SIZE))


def set_texture(model: mujoco.MjModel, name: str, image: NDArray[np.uint8]) -> int:
    """Change a texture in a compiled model; return its number."""
    number = int(model.texture(name).id)
    flat = model.tex_type[number] == int(mujoco.mjtTexture.mjTEXTURE_2D)
    data, start = texture_data(image, flat), int(model.tex_adr[number])
    model.tex_data[start : start + len(data)] = data
    return number


def set_lights(model: mujoco.MjModel, lights: Sequence[Light], center: NDArray[np.float64]) -> None:
    """Switch the first lights on as stated and the others off."""
    headlight = model.vis.headlight
    headlight.ambient[:] = np.clip(np.sum([light.ambient for light in lights], axis=0) if lights else 0.4, 0, 1)
    headlight.diffuse[:], headlight.specular[:] = 0.0, 0.0
    for slot in range(model.nlight):
        model.light_active[slot] = slot < len(lights)
        if slot >= len(lights):
            continue
        light = lights[slot]
        direction = np.asarray(light.direction) / np.linalg.norm(light.direction)
        model.light_pos[slot] = center - LIGHT_DISTANCE * direction
        model.light_dir[slot] = direction
        model.light_diffuse[slot], model.light_ambient[slot] = light.diffuse, 0.0
        model.light_specular[slot] = 0.3 * np.asarray(light.diffuse)
        model.light_castshadow[slot] = 1
