"""Simulator plugin: MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from icub_core.data import RobotState
from icub_core.errors import SimulationError
from icub_core.interfaces.simulator import Fault, Rendering, Simulator
from icub_core.robot_description import RobotCamera, RobotDescription
from icub_core.scene import CameraView, Light, Material, Scene
from icub_simulators.depth_noise import DepthNoise
from icub_simulators.mujoco.physics import Physics
from icub_simulators.mujoco.renderer import Renderer
from icub_simulators.views import place_camera

FloatArray = NDArray[np.float64]


class Mujoco(Simulator):
    """A world in MuJoCo.

    Solver: Newton, elliptic friction cones, friction 20 times stiffer than the normal direction. With the engine's
    defaults (pyramidal cones, ratio 1) fingers creep round what they hold and nearly every grasp fails.

    Args:
        depth_noise: Give the depth of a stereo camera (noise, steps, holes at edges) instead of the true one.
    """

    def __init__(self, depth_noise: bool = False) -> None:
        self._noise = DepthNoise() if depth_noise else None
        self._physics: Physics | None = None
        self._renderer: Renderer | None = None
        self._cameras: dict[str, RobotCamera] = {}

    @property
    def _world(self) -> Physics:
        if self._physics is None:
            raise SimulationError("no world is loaded; call load first")
        return self._physics

    @property
    def model(self) -> mujoco.MjModel:
        """The engine's model, for experiments; changing it changes the world."""
        return self._world.model

    @property
    def data(self) -> mujoco.MjData:
        """The engine's data, for experiments."""
        return self._world.data

    def load(self, robot: RobotDescription | None, scene: Scene) -> None:
        """Build the world."""
        physics = Physics(robot, scene)
        self.close()
        self._physics = physics
        self._cameras = {camera.name: camera for camera in (robot.cameras if robot is not None else ())}

    @property
    def scene(self) -> Scene:
        """The scene that was loaded."""
        return self._world.scene

    @property
    def time(self) -> float:
        """Simulated seconds since reset."""
        return self._world.data.time

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
        return self._world.robot_state(self.fingertip_contacts())

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

    def hand_and_object(
        self, frame: str, hand: str, name: str
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]:
        """T_world_frame (4, 4), actuator lengths (m,), fingertip contacts (t,), object position (3,)."""
        return (self._physics or self._world).hand_and_object(frame, hand, name)

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
        world = self._world
        renderer = self._open_renderer()
        view = place_camera(camera, self._cameras, world.link_pose, look_at)
        picture = renderer.render(
            world.data.qpos, world.parked, view, width, height, segmentation, shadows, world.data.time
        )
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
        scene = self._world.scene
        if table is not None and scene.table is None:
            raise SimulationError("this world has no table to change the look of")
        self._open_renderer().set_appearance(table, floor, backdrop, lights)

    def _open_renderer(self) -> Renderer:
        """Return the renderer; physics alone never needs a graphics library."""
        if self._renderer is None:
            world = self._world
            self._renderer = Renderer(world.robot, world.scene)
        return self._renderer

    def save_state(self) -> FloatArray:
        """Everything that decides the future, as one vector; restoring it is bit exact."""
        return self._world.save()

    def restore_state(self, state: FloatArray) -> None:
        """Continue from a saved state."""
        self._world.restore(state)

    def faults(self) -> tuple[Fault, ...]:
        """Faults since the last `reset` or `restore_state`, each once."""
        return self._world.faults()

    def close(self) -> None:
        """Free the engine; the simulator may be loaded again."""
        if self._renderer is not None:
            self._renderer.close()
        self._physics = self._renderer = None
