"""World: a robot and what surrounds it, as simulators and real robots both offer it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from icub_core.data import RgbdFrame, RobotState


class Fault(Enum):
    """What went wrong since the last reset; such transitions never reach a replay buffer."""

    HIDDEN_RESET = "the engine reset the world by itself"
    NOT_A_NUMBER = "a position, velocity or command is not finite"
    DROPPED_CONTACTS = "contacts or constraints were dropped for lack of space"
    EXPLODING_VELOCITY = "a velocity is beyond anything physical"
    STALE_DATA = "a sensor has sent nothing for longer than its period permits"
    HARDWARE = "a motor or board of the robot reports a fault"


class World(ABC):
    """One robot that is read, commanded and waited for.

    Contract:

    - the order of joints and of commands is the robot description's; lengths are radians, or meters of sliding joints;
    - reading never moves the robot, and two readings between two ticks agree;
    - faults are reported by `faults`, never raised from `tick` and never hidden;
    - `close` may be called twice.
    """

    @property
    @abstractmethod
    def time(self) -> float:
        """Seconds since the world's clock started."""

    @abstractmethod
    def set_targets(self, targets: NDArray[np.float64]) -> None:
        """Command every actuator: (m,) lengths, clipped to the actuators' ranges."""

    @abstractmethod
    def tick(self, seconds: float) -> None:
        """Wait until `seconds` have passed since the tick before; a simulator advances its physics by as much."""

    @abstractmethod
    def robot_state(self) -> RobotState:
        """Joint positions and velocities, actuator lengths, fingertip contacts of the robot's first hand."""

    def joint_positions(self) -> NDArray[np.float64]:
        """Joint positions (n,), rad: `robot_state().q` for those who need nothing else."""
        return self.robot_state().q

    def actuator_positions(self) -> NDArray[np.float64]:
        """Actuated lengths (m,), rad: `robot_state().actuator_positions` for those who need nothing else."""
        return self.robot_state().actuator_positions

    @abstractmethod
    def fingertip_contacts(self, hand: str | None = None) -> NDArray[np.bool_]:
        """Return which fingertips of a hand touch an object: (t,) bool in the order of the hand's description."""

    @abstractmethod
    def link_pose(self, link: str) -> NDArray[np.float64]:
        """Return T_world_link (4, 4). Raises ConfigError for an unknown link."""

    @abstractmethod
    def image(self, camera: str, width: int = 320, height: int = 240) -> RgbdFrame:
        """Return what a camera of the robot sees now. Raises ConfigError for an unknown camera."""

    @abstractmethod
    def faults(self) -> tuple[Fault, ...]:
        """Return the faults since the last reset, each once."""

    @abstractmethod
    def close(self) -> None:
        """Free the connection, or the engine and its renderers."""
