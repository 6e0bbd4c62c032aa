"""What a plugin may offer beyond its contract: protocols that are asked for with `isinstance`, and in no other way.

A plugin offers an ability by having its methods; there is nothing to register::

    if isinstance(robot, HasGaze):
        solution = robot.gaze(point, q)
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, Self, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray

from icub_core.data import Grasp
from icub_core.interfaces.closable import Closable
from icub_core.interfaces.feature_extractor import ImageFeatures, RpnCells
from icub_core.interfaces.policy import LearnReport, Progress
from icub_core.interfaces.robot import GazeSolution
from icub_core.interfaces.segmenter import UpdateReport
from icub_core.interfaces.simulator import Simulator
from icub_core.interfaces.task import Start, Task
from icub_core.scene import Light, Material, Table


@runtime_checkable
class Learns(Protocol):
    """A policy that learns in a task."""

    def learn(
        self,
        task: Task,
        run_dir: Path | None = None,
        progress: Progress | None = None,
        *,
        seconds: float | None = None,
    ) -> LearnReport:
        """Learn within the policy's own budget.

        Args:
            task: Worlds to learn in.
            run_dir: Folder of the resumable checkpoints; None keeps none.
            progress: Told about the finished share.
            seconds: Wall-clock budget instead of the policy's own.
        """


@runtime_checkable
class HasWeights(Protocol):
    """A policy whose weights can be kept: what `save` writes, `load` restores exactly."""

    def save(self, path: Path) -> None:
        """Write the weights, without pickle, atomically."""

    def load(self, path: Path) -> None:
        """Read what `save` wrote; CheckpointError for anything else, and the policy stays as it was."""


@runtime_checkable
class AddsClasses(Protocol):
    """A segmenter that trains new classes alone and leaves the old ones as they are."""

    def add_classes(self) -> UpdateReport:
        """Train the classes that were first shown since the last training.

        Raises:
            NotFittedError: Before the first `update`.
            DataError: No class was shown for the first time since the last training.
        """


@runtime_checkable
class ProposesCells(Protocol):
    """A feature extractor from which an on-line region proposal network can learn."""

    def rpn_cells(self, features: ImageFeatures) -> RpnCells:
        """Return the features and anchors of every feature-map location."""


@runtime_checkable
class HasMaskBranch(Protocol):
    """A feature extractor with a pre-trained, class-agnostic mask branch."""

    def mask_probabilities(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Return (N, mask_size, mask_size) probabilities that a pixel of a box (N, 4) belongs to the box's object."""


@runtime_checkable
class HasGaze(Protocol):
    """A robot that can turn a camera."""

    def gaze(self, point: NDArray[np.float64], q_start: NDArray[np.float64], camera: str | None = None) -> GazeSolution:
        """Turn the neck so that `camera` (the first by default) looks at `point` (3,), world, meters.

        All other joints stay at `q_start` (n,).
        """


@runtime_checkable
class ChecksCollisions(Protocol):
    """A robot that knows its collision shapes."""

    def collisions(
        self, q: NDArray[np.float64], table: Table | None = None, margin: float = 0.0
    ) -> tuple[tuple[str, str], ...]:
        """Return what touches at `q` (n,): pairs of links, or of a link and ``"table"``; none is an empty tuple.

        Args:
            q: Joint vector, rad.
            table: Also check the arms and hands with this table.
            margin: Meters; closer than this counts as touching.
        """


@runtime_checkable
class ChangesAppearance(Protocol):
    """A simulator that can change the looks of a loaded world."""

    def set_appearance(
        self,
        *,
        table: Material | None = None,
        floor: Material | None = None,
        backdrop: Material | None = None,
        lights: Sequence[Light] | None = None,
    ) -> None:
        """Change materials and lights until the next `load`; None leaves as it is.

        Raises:
            SimulationError: The world has no such part.
        """


@runtime_checkable
class TriesGrasps(Protocol):
    """A task whose worlds can be set up for one grasp: planning is measured with it, and grasp generators learn."""

    def place(self, world: int, target: str, rng: np.random.Generator) -> None:
        """Reset one world and put a target at random where it can be grasped; it rests there."""

    def plan(self, world: int, target: str) -> Grasp | str:
        """Look at a target where it stands and plan its grasp; the reason in words where there is none."""

    def start_before(self, world: int, grasp: Grasp, distance: float, object_rest: NDArray[np.float64]) -> Start | None:
        """Return a start of the present world with the hand `distance` meters before a grasp.

        None where it is not reached. `object_rest` (3,) is where the object stood before the hand came.
        """

    def simulator(self, world: int) -> Simulator:
        """Return the simulator of one world."""


class KernelSystem(Protocol):
    """The linear system of a kernel head with fixed centers, to which samples can be added at any time."""

    def add(self, X: torch.Tensor, Y: torch.Tensor) -> None:
        """Add samples X (n, d) with targets Y (n, t)."""

    def rows(self, X: torch.Tensor) -> torch.Tensor:
        """Return the kernel rows (n, M) between samples X (n, d) and the centers."""

    def scores(self, K: torch.Tensor) -> torch.Tensor:
        """Return the scores (n, t) of samples with kernel rows K (n, M), from all samples added so far."""

    def add_rows(self, K: torch.Tensor, Y: torch.Tensor) -> None:
        """Add samples whose kernel rows K (n, M) are known; K may be overwritten."""


@runtime_checkable
class SharesKernel(Protocol):
    """An on-line head that regresses targets by a kernel on centers, and lets the caller add samples step by step.

    All problems share the centers and the kernel rows. `fit(X, Y)` gives the scores of these steps: take
    ``X[choose_centers(Y)]`` as centers, make a system, add all samples, adopt it. Targets may be any real numbers.
    """

    def choose_centers(self, Y: torch.Tensor) -> torch.Tensor:
        """Return distinct row numbers (M,) of the samples that become centers, for targets Y (n, t) of all samples."""

    def kernel_system(self, centers: torch.Tensor, problems: int) -> KernelSystem:
        """Return a system without samples, for centers (M, d) and `problems` targets."""

    def adopt(self, system: KernelSystem) -> None:
        """Become the fitted head whose scores are those of a system that `kernel_system` made."""

    def with_at_most(self, centers: int) -> Self:
        """Return an untrained head of the same configuration that chooses at most so many centers."""


__all__ = [
    "AddsClasses",
    "ChangesAppearance",
    "ChecksCollisions",
    "Closable",
    "HasGaze",
    "HasMaskBranch",
    "HasWeights",
    "KernelSystem",
    "Learns",
    "ProposesCells",
    "SharesKernel",
    "TriesGrasps",
]
