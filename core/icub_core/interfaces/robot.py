"""Robot: a description and its kinematics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.robot_description import RobotDescription


@dataclass(frozen=True, eq=False)
class IkSolution:
    """Answer of an inverse-kinematics solver, also when it fails.

    Attributes:
        q: (n,) full joint vector, rad, always within the limits; joints outside the solved group keep their start.
        reached: Whether both errors are within the tolerances asked for.
        position_error: Meters.
        orientation_error: Radians.
        limits_hit: Names of the joints that ended on a limit.
    """

    q: NDArray[np.float64]
    reached: bool
    position_error: float
    orientation_error: float
    limits_hit: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class GazeSolution:
    """Joint angles that point a camera at a target.

    Attributes:
        q: (n,) full joint vector, rad, within the limits; only the neck differs from the start.
        reached: Whether the point lies within the tolerance of the optical axis.
        angle: Between the optical axis and the line to the point, rad.
    """

    q: NDArray[np.float64]
    reached: bool
    angle: float


class Robot(ABC):
    """One robot: data (`description`) and kinematics that need no simulator.

    Contract: `home_q` lies within the limits; FK is a pure function of q; IK never raises for an unreachable pose
    and never returns joints outside their limits.
    """

    @property
    @abstractmethod
    def description(self) -> RobotDescription:
        """The robot as data. The same object at every call."""

    @abstractmethod
    def forward_kinematics(self, q: NDArray[np.float64], frame: str) -> NDArray[np.float64]:
        """Return T_world_frame (4, 4) at the joint vector `q` (n,). Raises ConfigError for an unknown frame."""

    @abstractmethod
    def jacobian(self, q: NDArray[np.float64], frame: str) -> NDArray[np.float64]:
        """Return the (6, n) Jacobian of `frame`: linear then angular velocity, in world axes at the frame's origin."""

    def pose_and_jacobian(self, q: NDArray[np.float64], frame: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return `forward_kinematics` and `jacobian` of one `q` (n,); a robot may answer both at once, faster."""
        return self.forward_kinematics(q, frame), self.jacobian(q, frame)

    @abstractmethod
    def inverse_kinematics(
        self,
        T_world_frame: NDArray[np.float64],
        q_start: NDArray[np.float64],
        frame: str,
        *,
        group: str | None = None,
        max_iterations: int = 100,
        position_tolerance: float = 1e-3,
        orientation_tolerance: float = 1e-2,
    ) -> IkSolution:
        """Move the joints of `group` so that `frame` takes the pose `T_world_frame` (4, 4).

        A solver may start again from elsewhere when more than a few iterations are allowed; with up to 10 it only
        follows from `q_start`. A pose that is not finite is an unreachable pose.

        Args:
            T_world_frame: Wanted pose.
            q_start: (n,) start, also the posture that the solution stays near.
            frame: Name of the frame to place.
            group: Joints that may move; None moves those that carry the hand whose frame it is.
            max_iterations: Of one descent; 1 or 2 suffice to track a target that moves by millimeters.
            position_tolerance: Meters.
            orientation_tolerance: Radians.
        """

    def inverse_kinematics_batch(
        self,
        T_world_frames: NDArray[np.float64] | Sequence[NDArray[np.float64]],
        q_start: NDArray[np.float64],
        frame: str,
        *,
        group: str | None = None,
        max_iterations: int = 100,
        position_tolerance: float = 1e-3,
        orientation_tolerance: float = 1e-2,
    ) -> list[IkSolution]:
        """Solve many targets from one start, to rank candidates: as one by one, but a solver may leave restarts out.

        Args:
            T_world_frames: (k, 4, 4) wanted poses; k may be 0.
            q_start: (n,) start of all.
            frame: As for one target, like the rest.
            group: Joints that may move.
            max_iterations: Of one descent.
            position_tolerance: Meters.
            orientation_tolerance: Radians.
        """
        return [
            self.inverse_kinematics(
                T,
                q_start,
                frame,
                group=group,
                max_iterations=max_iterations,
                position_tolerance=position_tolerance,
                orientation_tolerance=orientation_tolerance,
            )
            for T in T_world_frames
        ]
