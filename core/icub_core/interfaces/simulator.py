"""Simulator: one world of a robot, a table and objects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame, RobotState
from icub_core.errors import SimulationError
from icub_core.robot_description import RobotDescription
from icub_core.scene import CameraView, Light, Material, Scene


class Fault(Enum):
    """What went wrong inside the physics since the last reset; such transitions never reach a replay buffer."""

    HIDDEN_RESET = "the engine reset the world by itself"
    NOT_A_NUMBER = "a position, velocity or command is not finite"
    DROPPED_CONTACTS = "contacts or constraints were dropped for lack of space"
    EXPLODING_VELOCITY = "a velocity is beyond anything physical"


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image and what each of its pixels shows.

    Attributes:
        frame: Color, depth, camera.
        segmentation: (H, W) int32: index into `scene.objects`; -1 anything else. None unless asked for.
    """

    frame: RgbdFrame
    segmentation: NDArray[np.int32] | None = None


class Simulator(ABC):
    """One world.

    Contract:

    - nothing but `load` works before `load`; `load` again replaces the world;
    - `reset` restores time 0, the home pose at rest, every object at its rest pose on its given place or parked away;
    - two runs with the same calls are identical; `step(n)` advances time by exactly n timesteps;
    - pixel (row, column) looks along ((column - cx) / fx, (row - cy) / fy, 1), cx = (width - 1) / 2: whole numbers are
      pixel centers; depth 0 is where nothing was hit;
    - the order of joints and of commands is the description's;
    - physics faults are reported by `faults`, never raised from `step` and never hidden;
    - `close` may be called twice.
    """

    @abstractmethod
    def load(self, robot: RobotDescription | None, scene: Scene) -> None:
        """Build the world. `robot` None builds objects and table only. Raises SimulationError with one clear line."""

    @property
    @abstractmethod
    def scene(self) -> Scene:
        """The scene that was loaded."""

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated seconds since reset."""

    @abstractmethod
    def reset(self) -> None:
        """Home pose, zero velocity, targets at home; all objects parked out of sight; faults cleared."""

    @abstractmethod
    def set_joint_positions(self, q: NDArray[np.float64]) -> None:
        """Teleport the robot to `q` (n,), at rest, with targets that hold it there."""

    @abstractmethod
    def set_targets(self, targets: NDArray[np.float64]) -> None:
        """Command every actuator: (m,) lengths, rad, clipped to the actuators' ranges."""

    @abstractmethod
    def step(self, n: int = 1) -> None:
        """Advance physics by n timesteps."""

    @abstractmethod
    def robot_state(self) -> RobotState:
        """Joint positions and velocities, actuator lengths, fingertip contacts of the right hand with any object."""

    def joint_positions(self) -> NDArray[np.float64]:
        """Joint positions (n,), rad: `robot_state().q` for those who need nothing else."""
        return self.robot_state().q

    def actuator_positions(self) -> NDArray[np.float64]:
        """Actuated lengths (m,), rad: `robot_state().actuator_positions` for those who need nothing else."""
        return self.robot_state().actuator_positions

    @abstractmethod
    def fingertip_contacts(self, hand: str = "right") -> NDArray[np.bool_]:
        """Which of the five fingertips touch any object: thumb, index, middle, ring, little."""

    @abstractmethod
    def link_pose(self, link: str) -> NDArray[np.float64]:
        """T_world_link (4, 4). Raises ConfigError for an unknown link."""

    @abstractmethod
    def object_pose(self, name: str) -> NDArray[np.float64]:
        """T_world_object (4, 4). Raises ConfigError for an unknown object."""

    @abstractmethod
    def set_object_pose(self, name: str, T_world_object: NDArray[np.float64]) -> None:
        """Teleport an object, at rest."""

    @abstractmethod
    def park_object(self, name: str) -> None:
        """Put an object where neither camera nor robot meets it."""

    def hand_and_object(
        self, frame: str, hand: str, name: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
        """What a grasping task reads after every step, in one call for engines in which that is faster.

        Returns:
            `link_pose(frame)` (4, 4), `actuator_positions()` (m,), `fingertip_contacts(hand)` (5,), and the position
            (3,) of `object_pose(name)`; the caller copies what it keeps.
        """
        position = self.object_pose(name)[:3, 3]
        return self.link_pose(frame), self.actuator_positions(), self.fingertip_contacts(hand), position

    @abstractmethod
    def touching(self, name: str) -> bool:
        """Whether the robot touches the object anywhere."""

    @abstractmethod
    def render(
        self,
        camera: str | CameraView,
        width: int = 320,
        height: int = 240,
        *,
        look_at: NDArray[np.float64] | None = None,
        segmentation: bool = False,
        shadows: bool = False,
    ) -> Rendering:
        """Take a image.

        Args:
            camera: Name of a camera of the robot, or a free camera.
            width: Pixels.
            height: Pixels.
            look_at: (3,) world point; the camera keeps its place but turns to it (the thesis's tracking camera).
            segmentation: Also say which object each pixel shows.
            shadows: Prettier and about ten times slower.
        """

    def set_appearance(
        self,
        *,
        table: Material | None = None,
        floor: Material | None = None,
        backdrop: Material | None = None,
        lights: tuple[Light, ...] | None = None,
    ) -> None:
        """Change looks of the loaded world; None leaves as it is. Lasts until the next `load`.

        Raises SimulationError for what this world does not have, and in simulators that cannot.
        """
        raise SimulationError(f"{type(self).__name__} cannot change looks; load a scene with other materials")

    @abstractmethod
    def save_state(self) -> NDArray[np.float64]:
        """Everything that decides the future, as one vector."""

    @abstractmethod
    def restore_state(self, state: NDArray[np.float64]) -> None:
        """Continue from a saved state as if nothing had happened in between."""

    @abstractmethod
    def faults(self) -> tuple[Fault, ...]:
        """Faults since the last `reset` or `restore_state`, each once."""

    @abstractmethod
    def close(self) -> None:
        """Free the engine and its renderers."""
