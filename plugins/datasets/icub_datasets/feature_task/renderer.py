"""Renders the scenes of the FEATURE-TASK with MuJoCo: images with exact visible masks.

All classes live in one model; a frame moves a few of them in front of the camera and hides the rest. Nothing is
simulated: objects are placed so that their lowest point touches the table, which costs nothing and looks right.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import SimulationError
from icub_datasets.feature_task.objects import TaskObject, feature_task_objects, read_obj
from icub_datasets.feature_task.textures import background_texture, product_texture
from icub_support.gl import prepare

HEIGHT, WIDTH = 240, 320
BACKGROUNDS = 48
FURNITURE = 5
FINGERS = 5
MIN_PIXELS = 50
_HIDDEN, _SHOWN = 5, 0  # geom groups: MuJoCo's default view shows 0 to 2 only


@dataclass(frozen=True, eq=False)
class LabeledImage:
    """One frame with its exact annotation.

    Attributes:
        rgb: (H, W, 3) uint8.
        instances: (H, W) uint8, 0 where no object is visible, else 1 + index into `labels`.
        labels: (N,) int64, class of each instance, from 1.
    """

    rgb: NDArray[np.uint8]
    instances: NDArray[np.uint8]
    labels: NDArray[np.int64]


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """A uniform random rotation matrix (3, 3)."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _resting_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """A rotation that puts one of six sides down and turns about the vertical."""
    sides = [np.eye(3)]
    for axis, angle in ((0, 1), (0, 2), (0, 3), (1, 1), (1, 3)):
        c, s = round(np.cos(angle * np.pi / 2)), round(np.sin(angle * np.pi / 2))
        i, j = [(1, 2), (2, 0)][axis]
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        sides.append(turn)
    side = sides[0] if rng.random() < 0.45 else sides[int(rng.integers(6))]
    yaw = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ side


class FeatureTaskRenderer:
    """Draws random labeled frames; the same frame seed gives the same frame."""

    def __init__(self, class_seed: int = 0, meshes: int | None = None, products: int | None = None) -> None:
        """Build the model with all classes.

        Args:
            class_seed: Seed of shapes, textures and backgrounds.
            meshes: Number of mesh classes; None: the default of the FEATURE-TASK.
            products: Number of invented products; None: the default.

        Raises:
            SimulationError: When MuJoCo cannot render on this machine.
            DataError: When the meshes are not installed.
        """
        context_class = prepare("mujoco")
        import mujoco

        # MuJoCo chose a context class when it was first imported, perhaps before `prepare` found the right one
        vars(sys.modules[mujoco.Renderer.__module__])["gl_context"].GLContext = context_class
        self._mujoco = mujoco
        counts = {k: v for k, v in {"meshes": meshes, "products": products}.items() if v is not None}
        self.objects: list[TaskObject] = feature_task_objects(class_seed, **counts)
        self._model = self._build(class_seed)
        # the compiler marks geoms at a body's origin and then ignores their position, which is set here per frame
        self._model.geom_sameframe[:] = 0
        self._data = mujoco.MjData(self._model)
        try:
            self._renderer = mujoco.Renderer(self._model, HEIGHT, WIDTH)
        except Exception as error:  # the binding raises several unrelated types when no GL is found
            raise SimulationError(f"MuJoCo cannot render here: {error}") from error
        self._classes = np.zeros(self._model.ngeom + 1, dtype=np.int64)
        for label, item in enumerate(self.objects, start=1):
            body = self._model.body(item.name)
            first = int(body.geomadr[0])
            self._classes[first : first + int(body.geomnum[0])] = label

    def __enter__(self) -> FeatureTaskRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the GL context."""
        self._renderer.close()

    # model ----------------------------------------------------------------------------------------------------

    def _build(self, seed: int):  # noqa: ANN202  (mujoco is imported late)
        mj = self._mujoco
        spec = mj.MjSpec()
        spec.visual.quality.shadowsize = 512
        spec.visual.quality.offsamples = 4
        spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
        spec.stat.extent, spec.stat.center = 1.0, [0, 0, 0]  # near plane at 1 cm whatever the floor's size
        spec.visual.map.znear, spec.visual.map.zfar = 0.01, 30.0
        rng = np.random.default_rng([seed, 3])
        role = int(mj.mjtTextureRole.mjTEXROLE_RGB)

        def material(name: str, pixels: NDArray[np.uint8], kind: int) -> None:
            texture = spec.add_texture(name=name, type=kind, nchannel=3, width=pixels.shape[1], height=pixels.shape[0])
            texture.data = pixels.tobytes()
            made = spec.add_material(name=name, specular=float(rng.uniform(0, 0.8)), shininess=float(rng.uniform(0, 1)))
            made.textures[role] = name

        for index in range(BACKGROUNDS):
            material(f"background_{index}", background_texture(rng), mj.mjtTexture.mjTEXTURE_2D)
        world = spec.worldbody
        plane, box = mj.mjtGeom.mjGEOM_PLANE, mj.mjtGeom.mjGEOM_BOX
        plain = dict(contype=0, conaffinity=0, group=_SHOWN)
        world.add_geom(name="floor", type=plane, size=[6, 6, 1], pos=[0, 0, -0.75], material="background_0", **plain)
        world.add_geom(name="table", type=box, size=[0.6, 0.6, 0.02], material="background_1", **plain)
        world.add_geom(name="wall", type=box, size=[4, 0.05, 3], material="background_2", **plain)
        for index in range(FURNITURE):
            world.add_geom(name=f"furniture_{index}", type=box, size=[0.2] * 3, material="background_3", **plain)
        for index in range(FINGERS):
            kind = mj.mjtGeom.mjGEOM_CAPSULE
            world.add_geom(name=f"finger_{index}", type=kind, size=[0.01, 0.03, 0], rgba=[0.8, 0.6, 0.5, 1], **plain)
        for index in range(3):
            world.add_light(name=f"lamp_{index}", pos=[0, 0, 2], dir=[0, 0, -1], castshadow=index == 0)
        world.add_camera(name="camera", pos=[0, -1, 1])
        shapes = {
            "box": box,
            "cylinder": mj.mjtGeom.mjGEOM_CYLINDER,
            "ellipsoid": mj.mjtGeom.mjGEOM_ELLIPSOID,
            "capsule": mj.mjtGeom.mjGEOM_CAPSULE,
            "mesh": mj.mjtGeom.mjGEOM_MESH,
        }
        for item in self.objects:
            material(item.name, product_texture(rng), mj.mjtTexture.mjTEXTURE_CUBE)
            body = world.add_body(name=item.name)
            for index, part in enumerate(item.parts):
                options = dict(plain, group=_HIDDEN, material=item.name, pos=part.position)
                if part.mesh is not None:
                    mesh = spec.add_mesh(name=f"{item.name}_{index}", scale=part.size)
                    vertices, faces = read_obj(part.mesh)
                    mesh.uservert, mesh.userface = vertices.ravel().tolist(), faces.ravel().tolist()
                    mesh.smoothnormal = False
                    mesh.inertia = mj.mjtMeshInertia.mjMESH_INERTIA_CONVEX
                    body.add_geom(type=shapes["mesh"], meshname=mesh.name, **options)
                else:
                    body.add_geom(type=shapes[part.shape], size=part.size, **options)
        return spec.compile()

    # one frame ------------------------------------------------------------------------------------------------

    def render(self, seed: list[int]) -> LabeledImage:
        """Render the frame of a seed (any list of non-negative integers)."""
        rng = np.random.default_rng(seed)
        mj, model, data = self._mujoco, self._model, self._data
        model.geom_group[self._classes[:-1] > 0] = _HIDDEN
        for index in range(FINGERS):
            model.geom(f"finger_{index}").group[0] = _HIDDEN
        self._furnish(rng)
        self._light(rng)
        if rng.random() < 0.35:
            self._present(rng)
        else:
            self._lay_table(rng)
        mj.mj_kinematics(model, data)
        mj.mj_camlight(model, data)
        renderer = self._renderer
        renderer.update_scene(data, camera=0)
        rgb = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        segments = renderer.render()
        renderer.disable_segmentation_rendering()
        geoms = np.where(segments[..., 1] == int(mj.mjtObj.mjOBJ_GEOM), segments[..., 0], -1)
        return self._label(rgb, self._classes[geoms])

    @staticmethod
    def _label(rgb: NDArray[np.uint8], classes: NDArray[np.int64]) -> LabeledImage:
        counts = np.bincount(classes.ravel())
        labels = np.flatnonzero(counts >= MIN_PIXELS)
        labels = labels[labels > 0]
        table = np.zeros(len(counts), dtype=np.uint8)
        table[labels] = np.arange(1, len(labels) + 1)
        return LabeledImage(rgb, table[classes], labels.astype(np.int64))

    def _dress(self, rng: np.random.Generator, name: str) -> None:
        """Give a piece of furniture a random material, tint and repetition."""
        geom = self._model.geom(name)
        material = int(self._model.material(f"background_{int(rng.integers(BACKGROUNDS))}").id)
        geom.matid[0] = material
        self._model.mat_rgba[material, :3] = rng.uniform(0.5, 1.0, size=3)
        self._model.mat_texrepeat[material] = rng.uniform(0.5, 4.0)

    def _furnish(self, rng: np.random.Generator) -> None:
        model = self._model
        for name in ("floor", "table", "wall"):
            self._dress(rng, name)
        table = model.geom("table")
        table.size[:2] = rng.uniform(0.35, 1.0, size=2)
        table.pos[2] = -table.size[2]
        wall = model.geom("wall")
        wall.pos[:] = [0, rng.uniform(0.8, 3.0), 1.0]
        for index in range(FURNITURE):
            piece = model.geom(f"furniture_{index}")
            piece.group[0] = _SHOWN if rng.random() < 0.5 else _HIDDEN
            self._dress(rng, f"furniture_{index}")
            piece.size[:] = rng.uniform(0.1, 0.4, size=3)
            angle, far = rng.uniform(0, np.pi), rng.uniform(1.1, 2.2)
            piece.pos[:] = [far * np.cos(angle), far * np.sin(angle), rng.uniform(-0.6, 0.4)]

    def _light(self, rng: np.random.Generator) -> None:
        model = self._model
        ambient = rng.uniform(0.25, 0.6)
        model.vis.headlight.ambient[:] = ambient
        model.vis.headlight.diffuse[:] = rng.uniform(0.05, 0.45)
        model.vis.headlight.specular[:] = rng.uniform(0.0, 0.2)
        for index in range(3):
            lamp = model.light(f"lamp_{index}")
            lamp.active[0] = index == 0 or rng.random() < 0.5
            azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 2.5)
            lamp.pos[:] = [np.cos(azimuth) * rng.uniform(0, 1.5), np.sin(azimuth) * rng.uniform(0, 1.5), height]
            aim = rng.uniform(-0.2, 0.2, size=3) - lamp.pos
            lamp.dir[:] = aim / np.linalg.norm(aim)
            lamp.diffuse[:] = rng.uniform(0.3, 0.9) * rng.uniform(0.8, 1.0, size=3)
            lamp.specular[:] = rng.uniform(0.0, 0.5)

    def _aim(self, rng: np.random.Generator, target: NDArray[np.float64], distance: float, elevation: float) -> None:
        """Put the camera at a distance (m) and elevation (rad) from a target (3,), looking near it."""
        model = self._model
        azimuth = rng.uniform(-0.6, 0.6) - np.pi / 2
        away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        position = target + distance * away
        look = target + rng.uniform(-0.06, 0.06, size=3) * distance - position
        z = -look / np.linalg.norm(look)
        x = np.cross([0.0, 0.0, 1.0], z)
        x /= np.linalg.norm(x)
        roll = rng.normal(0, 0.08)
        y = np.cross(z, x)
        x, y = np.cos(roll) * x + np.sin(roll) * y, np.cos(roll) * y - np.sin(roll) * x
        quaternion = np.zeros(4)
        self._mujoco.mju_mat2Quat(quaternion, np.stack([x, y, z], axis=1).ravel())
        model.cam_pos[0], model.cam_quat[0] = position, quaternion
        model.cam_fovy[0] = rng.uniform(38, 60)

    def _place(self, label: int, rotation: NDArray[np.float64], position: NDArray[np.float64]) -> None:
        body = self._model.body(self.objects[label - 1].name)
        quaternion = np.zeros(4)
        self._mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
        body.pos[:], body.quat[:] = position, quaternion
        self._model.geom_group[self._classes[:-1] == label] = _SHOWN

    def _lay_table(self, rng: np.random.Generator) -> None:
        """Objects on the table, discs that do not overlap much, seen from 0.3 to 1.2 m."""
        count = int(rng.integers(3, 13))
        labels = rng.permutation(len(self.objects))[:count] + 1
        spread = rng.uniform(0.12, 0.32)
        placed: list[tuple[float, float, float]] = []
        for label in labels:
            rotation = _resting_rotation(rng) if rng.random() < 0.8 else random_rotation(rng)
            points = self.objects[label - 1].points @ rotation.T
            radius = float(np.linalg.norm(points[:, :2], axis=1).max()) * 0.85
            for _ in range(20):
                x, y = rng.uniform(-spread, spread, size=2)
                if all(np.hypot(x - a, y - b) > radius + r for a, b, r in placed):
                    placed.append((x, y, radius))
                    self._place(int(label), rotation, np.array([x, y, -points[:, 2].min()]))
                    break
        self._aim(rng, np.array([0, 0, 0.04]), 0.3 + 0.9 * rng.beta(1.2, 2.0), rng.uniform(0.25, 1.35))

    def _present(self, rng: np.random.Generator) -> None:
        """One or two objects held close to the camera, often with fingers around them."""
        target = np.array([0, 0, rng.uniform(0.15, 0.5)])
        distance = rng.uniform(0.28, 0.7)
        self._aim(rng, target, distance, rng.uniform(-0.2, 0.9))
        count = 1 if rng.random() < 0.75 else 2
        for turn, label in enumerate(rng.permutation(len(self.objects))[:count] + 1):
            offset = rng.uniform(-0.04, 0.04, size=3) + (turn * rng.choice([-1.0, 1.0]) * np.array([0.14, 0, 0]))
            self._place(int(label), random_rotation(rng), target + offset)
        if rng.random() < 0.5:
            skin = rng.uniform([0.1, 0.1, 0.1], [0.95, 0.9, 0.9])
            side = random_rotation(rng)[0] * rng.uniform(0.04, 0.09)
            for index in range(int(rng.integers(2, FINGERS + 1))):
                finger = self._model.geom(f"finger_{index}")
                finger.group[0] = _SHOWN
                finger.rgba[:3] = skin
                finger.size[:2] = [rng.uniform(0.006, 0.014), rng.uniform(0.02, 0.12)]
                finger.pos[:] = target + side + rng.normal(0, 0.02, size=3)
                quaternion = rng.normal(size=4)
                finger.quat[:] = quaternion / np.linalg.norm(quaternion)
