"""A world without dynamics: joints glide to their targets, objects stay where they are put, cameras cast rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame, RobotState
from icub_core.errors import ConfigError, SimulationError, unknown_name
from icub_core.geometry import FloatArray, invert, look_at, make_transform, pinhole, quat_wxyz_to_matrix
from icub_core.interfaces.simulator import Fault, Rendering, Simulator
from icub_core.robot_description import RobotDescription
from icub_core.scene import CameraView, Scene
from icub_testing.tiny.robot import LINKS, TinyRobot

TIME_CONSTANT = 0.05
"""Time constant of a joint's approach to its target, seconds."""
PARKING = 50.0
"""Meters below the floor where parked objects wait."""
SKY = np.array([200, 220, 240], dtype=np.uint8)


class TinySimulator(Simulator):
    """Kinematic world of a `TinyRobot`; objects are boxes of their half extents."""

    def __init__(self) -> None:
        """Start empty; `load` builds the world."""
        self._scene: Scene | None = None
        self._robot: RobotDescription | None = None
        self._kinematics = TinyRobot()

    def load(self, robot: RobotDescription | None, scene: Scene) -> None:
        """Take the world over; any robot but the tiny one is refused."""
        if robot is not None and robot.joint_names != tuple(link.joint for link in LINKS):
            raise SimulationError(f"the tiny simulator knows only the robot 'tiny', not '{robot.name}'")
        self._scene, self._robot = scene, robot
        self._n = len(robot.joint_names) if robot is not None else 0
        self._A, self._b = robot.actuator_matrix() if robot is not None else (np.zeros((0, 0)), np.zeros(0))
        # smallest change of the joints that gives the wanted lengths
        self._pull = np.linalg.pinv(self._A) if robot is not None else np.zeros((0, 0))
        self.reset()

    @property
    def scene(self) -> Scene:
        """The scene that was loaded."""
        if self._scene is None:
            raise SimulationError("the tiny simulator has no world yet; call load first")
        return self._scene

    @property
    def time(self) -> float:
        """Simulated seconds since reset."""
        return self._steps * self.scene.timestep

    def reset(self) -> None:
        """Go home and park everything."""
        scene = self.scene
        self._steps = 0
        self._q = self._robot.home_q if self._robot is not None else np.zeros(0)
        self._dq = np.zeros(self._n)
        self._targets = self._A @ self._q + self._b
        self._faulty = False
        self._poses = (
            np.stack([_parked(i) for i in range(len(scene.objects))]) if scene.objects else np.zeros((0, 4, 4))
        )

    def set_joint_positions(self, q: FloatArray) -> None:
        """Teleport the robot."""
        self._require_world()
        self._q, self._dq = q.copy(), np.zeros(self._n)
        self._targets = self._A @ q + self._b

    def set_targets(self, targets: FloatArray) -> None:
        """Command every actuator."""
        self._require_world()
        if self._robot is None:
            return
        self._faulty |= not bool(np.all(np.isfinite(targets)))
        safe = np.where(np.isfinite(targets), targets, self._targets)
        self._targets = np.array([np.clip(t, *a.range) for t, a in zip(safe, self._robot.actuators, strict=True)])

    def step(self, n: int = 1) -> None:
        """Let the joints glide."""
        self._require_world()
        if self._robot is None:
            self._steps += n
            return
        share = 1.0 - np.exp(-self.scene.timestep / TIME_CONSTANT)
        for _ in range(n):
            change = share * (self._pull @ (self._targets - (self._A @ self._q + self._b)))
            q = np.clip(self._q + change, self._robot.lower, self._robot.upper)
            self._dq = (q - self._q) / self.scene.timestep
            self._q = q
            self._steps += 1

    def robot_state(self) -> RobotState:
        """Joint positions, velocities, lengths, contacts."""
        self._require_world()
        return RobotState(self._q.copy(), self._dq.copy(), self._A @ self._q + self._b, self.fingertip_contacts())

    def fingertip_contacts(self, hand: str | None = None) -> NDArray[np.bool_]:
        """Return which fingertips have their middle in an object."""
        self._require_world()
        if self._robot is None:
            return np.zeros(0, dtype=np.bool_)
        poses = self._kinematics.link_poses(self._q)
        tips = [poses[link][:3, 3] for link in self._robot.hand(hand).fingertips]
        return np.array([any(self._holds(i, tip) for i in range(len(self._poses))) for tip in tips])

    def link_pose(self, link: str) -> FloatArray:
        """T_world_link."""
        self._require_world()
        if self._robot is None:
            raise ConfigError(f"there is no robot in this world, so no link '{link}'")
        return self._kinematics.forward_kinematics(self._q, link)

    def object_pose(self, name: str) -> FloatArray:
        """T_world_object."""
        return self._poses[self._object(name)].copy()

    def set_object_pose(self, name: str, T_world_object: FloatArray) -> None:
        """Put an object somewhere."""
        self._poses[self._object(name)] = T_world_object

    def park_object(self, name: str) -> None:
        """Put an object below the floor."""
        i = self._object(name)
        self._poses[i] = _parked(i)

    def touching(self, name: str) -> bool:
        """Return True if the middle of any link lies in the object."""
        i = self._object(name)
        if self._robot is None:
            return False
        return any(self._holds(i, T[:3, 3]) for T in self._kinematics.link_poses(self._q).values())

    def render(
        self,
        camera: str | CameraView,
        width: int = 320,
        height: int = 240,
        *,
        look_at: FloatArray | None = None,
        segmentation: bool = False,
        shadows: bool = False,
    ) -> Rendering:
        """Cast one ray per pixel at the floor, the table and the objects; the robot is not drawn."""
        T_world_camera, fovy = self._camera(camera, look_at)
        K = pinhole(width, height, fovy)
        columns, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        rays = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(rows)], axis=-1)
        depth = np.full((height, width), np.inf)
        index = np.full((height, width), -1, dtype=np.int32)
        rgb = np.broadcast_to(SKY, (height, width, 3)).copy()
        boxes = [(i, self._poses[i], o.half_extents, o.material.rgba) for i, o in enumerate(self.scene.objects)]
        floor = (make_transform(None, [0.0, 0.0, -0.5]), (10.0, 10.0, 0.5), self.scene.floor.rgba)
        boxes.append((-1, *floor))
        if (table := self.scene.table) is not None:
            boxes.append((-1, make_transform(None, table.center), table.half_size, table.material.rgba))
        for i, T_world_box, half, rgba in boxes:
            hit = _ray_box(rays, invert(T_world_box) @ T_world_camera, np.asarray(half))
            nearer = hit < depth
            depth[nearer], index[nearer] = hit[nearer], i
            rgb[nearer] = (np.asarray(rgba[:3]) * 255).astype(np.uint8)
        depth[~np.isfinite(depth)] = 0.0
        frame = RgbdFrame(rgb, depth.astype(np.float32), K, T_world_camera, self.time)
        return Rendering(frame, index if segmentation else None)

    def save_state(self) -> FloatArray:
        """Steps, fault flag, joints, targets, object poses."""
        self._require_world()
        flags = [float(self._steps), float(self._faulty)]
        return np.concatenate([flags, self._q, self._dq, self._targets, self._poses.reshape(-1)])

    def restore_state(self, state: FloatArray) -> None:
        """Take the vector apart again."""
        self._require_world()
        self._steps, self._faulty = int(state[0]), False
        q, dq, targets, poses = np.split(state[2:].copy(), np.cumsum([self._n, self._n, len(self._b)]))
        self._q, self._dq, self._targets, self._poses = q, dq, targets, poses.reshape(-1, 4, 4)

    def faults(self) -> tuple[Fault, ...]:
        """A command that was not finite."""
        return (Fault.NOT_A_NUMBER,) if self._faulty else ()

    def close(self) -> None:
        """Do nothing: this world holds no engine."""

    def _require_world(self) -> None:
        _ = self.scene

    def _object(self, name: str) -> int:
        names = [spec.name for spec in self.scene.objects]
        if name not in names:
            raise ConfigError(unknown_name("object in this world", name, names))
        return names.index(name)

    def _holds(self, i: int, point: FloatArray) -> bool:
        """Return True if a point (3,) of the world lies in object `i`."""
        spot = self._poses[i][:3, :3].T @ (point - self._poses[i][:3, 3])
        return bool(np.all(np.abs(spot) <= np.asarray(self.scene.objects[i].half_extents)))

    def _camera(self, camera: str | CameraView, target: FloatArray | None) -> tuple[FloatArray, float]:
        self._require_world()
        if isinstance(camera, CameraView):
            T_world_camera, fovy = camera.T_world_camera, camera.fovy
        else:
            cameras = {c.name: c for c in self._robot.cameras} if self._robot is not None else {}
            if camera not in cameras:
                raise ConfigError(unknown_name("camera", camera, cameras))
            chosen = cameras[camera]
            T_link_camera = make_transform(quat_wxyz_to_matrix(chosen.quat_wxyz), chosen.position)
            T_world_camera, fovy = self.link_pose(chosen.link) @ T_link_camera, chosen.fovy
        return (T_world_camera if target is None else look_at(T_world_camera[:3, 3], target)), fovy


def _parked(i: int) -> FloatArray:
    return make_transform(None, [float(i), 0.0, -PARKING])


def _ray_box(rays: FloatArray, T_box_camera: FloatArray, half: FloatArray) -> FloatArray:
    """Depth (H, W) at which rays (H, W, 3), camera frame with z = 1, enter a box; infinite where they miss (slabs)."""
    origin = T_box_camera[:3, 3]
    direction = rays @ T_box_camera[:3, :3].T
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    first, second = (-half - origin) / direction, (half - origin) / direction
    enter = np.minimum(first, second).max(axis=-1)
    leave = np.maximum(first, second).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)
