"""What the simulators share: one engine's physics behind the interface, named cameras, noise of the depth camera."""

from __future__ import annotations

from abc import abstractmethod
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from icub_core.data import RobotState
from icub_core.errors import SimulationError
from icub_core.geometry import FloatArray
from icub_core.interfaces.simulator import Fault, Rendering, Simulator
from icub_core.robot_description import RobotCamera, RobotDescription
from icub_core.scene import CameraView, Scene
from icub_simulators.depth_noise import DepthNoise
from icub_simulators.views import place_camera


class _Engine(Protocol):
    """The physics of one world. Methods that are named like the simulator's do what the simulator's do."""

    robot: RobotDescription | None
    scene: Scene

    @property
    def time(self) -> float: ...
    def reset(self) -> None: ...
    def step(self, n: int, /) -> None: ...
    def joint_positions(self) -> FloatArray: ...
    def joint_velocities(self) -> FloatArray: ...
    def actuator_positions(self) -> FloatArray: ...
    def set_joint_positions(self, q: FloatArray, /) -> None: ...
    def set_targets(self, targets: FloatArray, /) -> None: ...
    def fingertip_contacts(self, hand: str, /) -> NDArray[np.bool_]: ...
    def link_pose(self, link: str, /) -> FloatArray: ...
    def object_pose(self, name: str, /) -> FloatArray: ...
    def set_object_pose(self, name: str, T_world_object: FloatArray, /) -> None: ...
    def park_object(self, name: str, /) -> None: ...
    def touching(self, name: str, /) -> bool: ...
    def save(self) -> FloatArray: ...
    def restore(self, state: FloatArray, /) -> None: ...
    def faults(self) -> tuple[Fault, ...]: ...


E = TypeVar("E", bound=_Engine)


class EngineSimulator(Simulator, Generic[E]):
    """A simulator whose physics is one engine object per loaded world.

    A subclass builds the engine, draws what a camera sees, and frees both.

    Args:
        depth_noise: Give the depth of a stereo camera (noise, steps, holes at edges) instead of the true one.
    """

    def __init__(self, depth_noise: bool = False) -> None:
        self._noise = DepthNoise() if depth_noise else None
        self._engine: E | None = None
        self._cameras: dict[str, RobotCamera] = {}

    @abstractmethod
    def _build(self, robot: RobotDescription | None, scene: Scene) -> E:
        """Build a world; what is loaded stays as it is."""

    @abstractmethod
    def _draw(self, view: CameraView, width: int, height: int, segmentation: bool, shadows: bool) -> Rendering:
        """Draw the loaded world."""

    @abstractmethod
    def _free(self) -> None:
        """Free the engine and its renderer, if there are any."""

    @property
    def _world(self) -> E:
        if self._engine is None:
            raise SimulationError("no world is loaded; call load first")
        return self._engine

    def load(self, robot: RobotDescription | None, scene: Scene) -> None:
        """Build the world; when that fails, the world before stays loaded."""
        engine = self._build(robot, scene)
        self.close()
        self._engine = engine
        self._cameras = {camera.name: camera for camera in (robot.cameras if robot is not None else ())}

    def close(self) -> None:
        """Free the engine; the simulator may be loaded again."""
        self._free()
        self._engine = None

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
        return RobotState(
            world.joint_positions(), world.joint_velocities(), world.actuator_positions(), self.fingertip_contacts()
        )

    def fingertip_contacts(self, hand: str | None = None) -> NDArray[np.bool_]:
        """Return which fingertips of a hand touch any object; the first hand where none is named."""
        world = self._world
        if hand is None:
            if world.robot is None or not world.robot.hands:
                return np.zeros(0, dtype=np.bool_)
            hand = world.robot.hand().name
        return world.fingertip_contacts(hand)

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
        """Return True if the robot touches the object anywhere."""
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
        """Take an image; see the interface."""
        view = place_camera(camera, self._cameras, self._world.link_pose, look_at)
        rendering = self._draw(view, width, height, segmentation, shadows)
        return rendering if self._noise is None else self._noise.apply(rendering)

    def save_state(self) -> FloatArray:
        """Everything that decides the future, as one vector."""
        return self._world.save()

    def restore_state(self, state: FloatArray) -> None:
        """Continue from a saved state."""
        self._world.restore(state)

    def faults(self) -> tuple[Fault, ...]:
        """Faults since the last `reset` or `restore_state`, each once."""
        return self._world.faults()
