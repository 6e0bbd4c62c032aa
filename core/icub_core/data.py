"""The data that travels between plugins: frozen, checked at construction, numpy throughout.

`T_a_b` is the 4 x 4 rigid transform that maps coordinates of frame b into frame a. World: z up, meters.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import is_rigid

FloatArray = NDArray[np.float64]


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise DataError(message)


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """One aligned color and depth image with the pose of its camera.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32, meters along the optical axis, 0 where nothing was measured.
        intrinsics: (3, 3) float64, pinhole matrix in pixels.
        T_world_camera: (4, 4) float64; camera z forward, y down, x right.
        stamp: Seconds.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: FloatArray
    T_world_camera: FloatArray
    stamp: float = 0.0

    def __post_init__(self) -> None:
        _require(
            self.rgb.ndim == 3 and self.rgb.shape[2] == 3 and self.rgb.dtype == np.uint8,
            f"RgbdFrame.rgb is {self.rgb.shape} {self.rgb.dtype}; expected (H, W, 3) uint8",
        )
        _require(
            self.depth.shape == self.rgb.shape[:2] and self.depth.dtype == np.float32,
            f"RgbdFrame.depth is {self.depth.shape} {self.depth.dtype}; expected {self.rgb.shape[:2]} float32 meters",
        )
        _require(self.intrinsics.shape == (3, 3), f"RgbdFrame.intrinsics is {self.intrinsics.shape}; expected (3, 3)")
        _require(is_rigid(self.T_world_camera), "RgbdFrame.T_world_camera is not a rigid (4, 4) transform")

    def to_cloud(self, mask: NDArray[np.bool_] | None = None) -> PointCloud:
        """Back-project the measured pixels (of `mask`, (H, W) bool, when given) into the world frame."""
        valid = np.isfinite(self.depth) & (self.depth > 0)
        if mask is not None:
            _require(mask.shape == self.depth.shape, f"mask is {mask.shape}; expected {self.depth.shape}")
            valid = valid & mask
        rows, columns = np.nonzero(valid)
        z = self.depth[rows, columns].astype(np.float64)
        x = (columns - self.intrinsics[0, 2]) / self.intrinsics[0, 0] * z
        y = (rows - self.intrinsics[1, 2]) / self.intrinsics[1, 1] * z
        points = np.stack([x, y, z], axis=1) @ self.T_world_camera[:3, :3].T + self.T_world_camera[:3, 3]
        viewpoint = self.T_world_camera[:3, 3].astype(np.float64)
        return PointCloud(points, frame="world", rgb=self.rgb[rows, columns], viewpoint=viewpoint)


def tight_boxes(masks: NDArray[np.bool_]) -> FloatArray:
    """Return the smallest boxes (N, 4) around masks (N, H, W), x1 and y1 exclusive; zeros for an empty mask."""
    sides: list[NDArray[np.bool_]] = [np.any(masks, axis=1), np.any(masks, axis=2)]  # occupied columns, occupied rows
    first = [side.argmax(axis=1) for side in sides]
    last = [(side.shape[1] - side[:, ::-1].argmax(axis=1)) * side.max(axis=1) for side in sides]
    return np.stack([*first, *last], axis=1).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Instance:
    """One object seen in an image.

    Attributes:
        label: Class name.
        score: Confidence; only its order within a class is meaningful.
        box: (4,) float64, x0 y0 x1 y1 in pixels, x1 and y1 exclusive.
        mask: (H, W) bool.
    """

    label: str
    score: float
    box: FloatArray
    mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        _require(self.box.shape == (4,), f"Instance.box is {self.box.shape}; expected (4,) x0 y0 x1 y1")
        _require(
            self.mask.ndim == 2 and self.mask.dtype == np.bool_,
            f"Instance.mask is {self.mask.shape} {self.mask.dtype}; expected (H, W) bool",
        )

    @classmethod
    def from_mask(cls, label: str, mask: NDArray[np.bool_], score: float = 1.0) -> Instance:
        """Make an instance whose box is the tight box of `mask`; raises DataError for an empty mask."""
        if not mask.any():
            raise DataError(f"the mask of '{label}' is empty; expected at least one pixel")
        return cls(label, score, tight_boxes(mask[None])[0], mask)


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points in a named frame.

    Attributes:
        points: (N, 3) float64, meters.
        frame: Name of the frame, usually ``"world"``.
        rgb: (N, 3) uint8, or None.
        viewpoint: (3,) optical center of the camera that saw all of them, in the same frame; None when there is none.
    """

    points: FloatArray
    frame: str = "world"
    rgb: NDArray[np.uint8] | None = None
    viewpoint: FloatArray | None = None

    def __post_init__(self) -> None:
        _require(
            self.points.ndim == 2 and self.points.shape[1] == 3,
            f"PointCloud.points is {self.points.shape}; expected (N, 3) meters",
        )
        if self.rgb is not None:
            _require(
                self.rgb.shape == self.points.shape, f"PointCloud.rgb is {self.rgb.shape}; expected {self.points.shape}"
            )
        if self.viewpoint is not None:
            _require(self.viewpoint.shape == (3,), f"PointCloud.viewpoint is {self.viewpoint.shape}; expected (3,)")

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Grasp:
    """One hand pose from which closing the fingers should hold the object.

    Attributes:
        T_world_hand: (4, 4) pose of the hand's frame (`HandDescription.frame`) at the grasp.
        object_center: (3,) estimate of the object's center, world, meters.
        score: Higher is better; comparable only within one generator.
        generator: Registry name of the generator.
        hand: Name of the hand in the robot's description.
    """

    T_world_hand: FloatArray
    object_center: FloatArray
    score: float
    generator: str
    hand: str = "right"

    def __post_init__(self) -> None:
        _require(is_rigid(self.T_world_hand), "Grasp.T_world_hand is not a rigid (4, 4) transform")
        _require(self.object_center.shape == (3,), f"Grasp.object_center is {self.object_center.shape}; expected (3,)")
        _require(bool(self.hand), "Grasp.hand is empty; expected the name of a hand")

    def backed_off(self, distance: float) -> FloatArray:
        """Return the (4, 4) hand pose `distance` meters further out on the line from object center to hand.

        Source: thesis 12.3.1 (pre-grasp 5 cm before the grasp, reached through a pose at 10 cm).
        """
        T = self.T_world_hand.copy()
        offset = T[:3, 3] - self.object_center
        norm = float(np.linalg.norm(offset))
        if norm < 1e-6:  # the hand frame sits on the center: the palm's outward normal is the only way out
            offset, norm = -T[:3, 2], 1.0
        T[:3, 3] += distance / norm * offset
        return T


@dataclass(frozen=True, eq=False)
class GraspProposals:
    """What a grasp generator answers: grasps best first, or none and the reason in one line."""

    grasps: tuple[Grasp, ...]
    object_center: FloatArray | None = None
    reason: str = ""

    def __bool__(self) -> bool:
        return bool(self.grasps)


@dataclass(frozen=True, eq=False)
class RobotState:
    """What the robot measures.

    Attributes:
        q: (n,) joint positions, rad, ordered as `robot.joint_names`.
        dq: (n,) joint velocities, rad/s.
        actuator_positions: (m,) actuated lengths sum(coef * q) + offset, rad, ordered as the description's actuators.
        fingertip_contacts: (t,) bool, which fingertips of the first hand touch an object.
    """

    q: FloatArray
    dq: FloatArray
    actuator_positions: FloatArray
    fingertip_contacts: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
