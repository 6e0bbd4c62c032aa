"""Simulator: a world of a robot, a table and objects that can be built, set and repeated."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame
from icub_core.interfaces.world import Fault, World
from icub_core.robot_description import RobotDescription
from icub_core.scene import CameraView, Scene


@dataclass(frozen=True, eq=False)
class Rendering:
    """An image and what each of its pixels shows.

    Attributes:
        frame: Color, depth, camera.
        segmentation: (H, W) int32: index into `scene.objects`; -1 anything else. None unless asked for.
    """

    frame: RgbdFrame
    segmentation: NDArray[np.int32] | None = None


class Simulator(World):
    """A world that can be built, set and repeated.

    Contract, beside that of `World`:

    - only `load` and `close` work before `load`; `load` again replaces the world;
    - `reset` restores time 0, the home pose at rest, every object at its rest pose on its given place or parked away;
    - two runs with the same calls are identical; `step(n)` advances time by exactly n timesteps;
    - pixel (row, column) looks along ((column - cx) / fx, (row - cy) / fy, 1), cx = (width - 1) / 2: whole numbers are
      pixel centers; depth 0 is where nothing was hit;
    - `faults` covers the time since the last `reset` or `restore_state`.
    """

    @abstractmethod
    def load(self, robot: RobotDescription | None, scene: Scene) -> None:
        """Build the world. `robot` None builds objects and table only. Raises SimulationError with one clear line."""

    @property
    @abstractmethod
    def scene(self) -> Scene:
        """The scene that was loaded."""

    @abstractmethod
    def reset(self) -> None:
        """Home pose, zero velocity, time 0, targets at home; all objects parked out of sight; faults cleared."""

    @abstractmethod
    def set_joint_positions(self, q: NDArray[np.float64]) -> None:
        """Teleport the robot to `q` (n,), at rest, with targets that hold it there."""

    @abstractmethod
    def step(self, n: int = 1) -> None:
        """Advance physics by n timesteps."""

    def tick(self, seconds: float) -> None:
        """Advance physics by the whole number of timesteps nearest to `seconds`, at least one."""
        self.step(max(1, round(seconds / self.scene.timestep)))

    def image(self, camera: str, width: int = 320, height: int = 240) -> RgbdFrame:
        """Return what a camera of the robot sees now."""
        return self.render(camera, width, height).frame

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
            `link_pose(frame)` (4, 4), `actuator_positions()` (m,), `fingertip_contacts(hand)` (t,), and the position
            (3,) of `object_pose(name)`; the caller copies what it keeps.
        """
        position = self.object_pose(name)[:3, 3]
        return self.link_pose(frame), self.actuator_positions(), self.fingertip_contacts(hand), position

    @abstractmethod
    def touching(self, name: str) -> bool:
        """Return True if the robot touches the object anywhere."""

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
        """Take an image.

        Args:
            camera: Name of a camera of the robot, or a free camera.
            width: Pixels.
            height: Pixels.
            look_at: (3,) world point; the camera keeps its place but turns to it (the thesis's tracking camera).
            segmentation: Also return which object each pixel shows.
            shadows: Draw shadows and smooth edges, which takes about ten times as long.
        """

    @abstractmethod
    def save_state(self) -> NDArray[np.float64]:
        """Everything that decides the future, as one vector."""

    @abstractmethod
    def restore_state(self, state: NDArray[np.float64]) -> None:
        """Continue from a saved state as if nothing had happened in between."""


__all__ = ["Fault", "Rendering", "Simulator"]
