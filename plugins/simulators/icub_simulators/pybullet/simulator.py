"""Simulator plugin: Bullet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_core.data import RobotState
from icub_core.errors import SimulationError
from icub_core.interfaces.simulator import Fault, Rendering, Simulator
from icub_core.robot_description import RobotCamera, RobotDescription
from icub_core.scene import CameraView, Light, Material, Scene
from icub_simulators.depth_noise import DepthNoise
from icub_simulators.pybullet.camera import Camera
from icub_simulators.pybullet.client import check_installed
from icub_simulators.pybullet.world import World
from icub_simulators.views import place_camera

FloatArray = NDArray[np.float64]


class PyBullet(Simulator):
    """A world in Bullet, on the same contract as MuJoCo's: an independent judge of grasps, and no graphics library.

    What differs: servos are velocity motors of the same stiffness and strength (see `servos`); frictions multiply,
    and are set so that the products are the same; saving clears the solver's memory of contacts, so that a run with a
    save in it differs in the last digits from one without; a image shows one light, and a backdrop of one color.

    Args:
        depth_noise: Give the depth of a stereo camera (noise, steps, holes at edges) instead of the true one.
    """

    def __init__(self, depth_noise: bool = False) -> None:
        check_installed()
        self._noise = DepthNoise() if depth_noise else None
        self._loaded: World | None = None
        self._camera: Camera | None = None
        self._cameras: dict[str, RobotCamera] = {}

    @property
    def _world(self) -> World:
        if self._loaded is None:
            raise SimulationError("no world is loaded; call load first")
        return self._loaded

    def load(self, robot: RobotDescription | None, scene: Scene) -> None:
        """Build the world."""
        world = World(robot, scene)
        self.close()
        self._loaded = world
        self._cameras = {camera.name: camera for camera in (robot.cameras if robot is not None else ())}

    @property
    def scene(self) -> Scene:
        """The scene that was loaded."""
        return self._world.scene

    @property
    def time(self) -> float:
        """Simulated seconds since reset."""
        return self._world.time

    def reset(self) -> None:
        """Home pose, zero velocity, objects parked, faults cleared."""
        self._world.reset()
        if self._noise is not None:
            self._noise.reset()

    def set_joint_positions(self, q: FloatArray) -> None:
        """Teleport the robot to `q` (n,)."""
        self._world.set_joint_positions(q)

    def set_targets(self, targets: FloatArray) -> None:
        """Command every actuator, (m,) rad; a command that is not finite is dropped and reported by `faults`."""
        self._world.set_targets(targets)

    def step(self, n: int = 1) -> None:
        """Advance physics by n timesteps."""
        self._world.step(n)

    def joint_positions(self) -> FloatArray:
        """Joint positions (n,), rad."""
        return self._world.joint_positions()

    def actuator_positions(self) -> FloatArray:
        """Actuated lengths (m,), rad."""
        return self._world.actuator_positions()

    def robot_state(self) -> RobotState:
        """Joint positions and velocities, actuator lengths, fingertip contacts of the first hand."""
        world = self._world
        contacts = self.fingertip_contacts()
        return RobotState(world.joint_positions(), world.joint_velocities(), world.actuator_positions(), contacts)

    def fingertip_contacts(self, hand: str | None = None) -> NDArray[np.bool_]:
        """Which fingertips of a hand touch any object."""
        robot = self._world.robot
        if hand is None:
            if robot is None or not robot.hands:
                return np.zeros(0, dtype=np.bool_)
            hand = robot.hand().name
        return self._world.fingertip_contacts(hand)

    def link_pose(self, link: str) -> FloatArray:
        """T_world_link (4, 4)."""
        return self._world.link_pose(link)

    def object_pose(self, name: str) -> FloatArray:
        """T_world_object (4, 4)."""
        return self._world.object_pose(name)

    def set_object_pose(self, name: str, T_world_object: FloatArray) -> None:
        """Teleport an object, at rest."""
        self._world.set_object_pose(name, T_world_object)

    def park_object(self, name: str) -> None:
        """Put an object where neither camera nor robot meets it."""
        self._world.park_object(name)

    def touching(self, name: str) -> bool:
        """Whether the robot touches the object anywhere."""
        return self._world.touching(name)

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
        """Take a image; see the interface."""
        view = place_camera(camera, self._cameras, self._world.link_pose, look_at)
        picture = self._open_camera().render(view, width, height, segmentation, shadows)
        return picture if self._noise is None else self._noise.apply(picture)

    def set_appearance(
        self,
        *,
        table: Material | None = None,
        floor: Material | None = None,
        backdrop: Material | None = None,
        lights: tuple[Light, ...] | None = None,
    ) -> None:
        """Change looks without building the world anew."""
        world, eye = self._world, self._open_camera()
        if table is not None:
            if world.table is None:
                raise SimulationError("this world has no table to change the look of")
            eye.set_surface(world.table, table)
        if floor is not None:
            eye.set_surface(world.floor, floor)
        eye.backdrop = backdrop if backdrop is not None else eye.backdrop
        eye.lights = lights if lights is not None else eye.lights

    def _open_camera(self) -> Camera:
        if self._camera is None:
            self._camera = Camera(self._world)
        return self._camera

    def save_state(self) -> FloatArray:
        """Positions, velocities, commands and time as one vector; what follows it and what follows a restore agree."""
        return self._world.save()

    def restore_state(self, state: FloatArray) -> None:
        """Continue from a saved state."""
        self._world.restore(state)

    def faults(self) -> tuple[Fault, ...]:
        """Faults since the last `reset` or `restore_state`, each once."""
        return self._world.faults()

    def close(self) -> None:
        """Stop the engine; the simulator may be loaded again."""
        if self._loaded is not None:
            self._loaded.close()
        self._loaded = self._camera = None
