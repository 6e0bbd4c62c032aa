"""From grasp trials to what the network learns from: fields, voxels and labels, drawn anew every time.

Each draw takes one view or several, puts the table in or leaves it out, moves the cube a little, and for a gripper
turns the scene about the vertical; for a hand too, but less, as the arm reaches from one side only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from icub_core.data import PointCloud
from icub_core.errors import DataError
from icub_core.geometry import FloatArray, make_transform, rotation_about
from icub_grasp_generators.clouds import center_of, thin
from icub_grasp_generators.vgn.network import GRIPPER
from icub_grasp_generators.vgn.palm import YAW
from icub_grasp_generators.vgn.trials import TriedScene
from icub_grasp_generators.vgn.volume import RESOLUTION, VOXEL, Volume

SHIFT = 0.03
"""Meters; half range of the cube's place around the object, so that no place in it is special."""
NOISE = 0.001
"""Meters; standard deviation of the points."""
MAX_OF_SCENE = 12
"""Held trials of one scene that one step uses."""
HAND_TURN = np.radians(50.0)
"""Largest turn of a scene about the vertical where trials are a hand's."""
MAX_POINTS = 4000
"""Of a view; more than the field resolves."""
BORDER = 2
"""Voxels at the cube's faces that no grasp is learned at."""


@dataclass(frozen=True, eq=False)
class Batch:
    """What one step of training sees.

    Attributes:
        tsdf: (B, 1, 40, 40, 40) float32.
        scene: (G,) which of the B fields a trial belongs to.
        index: (G, 3) its voxel.
        label: (G,) float32, 1 where the object was held.
        quaternion: (G, 4) xyzw.
        width: (G,) voxels.
    """

    tsdf: torch.Tensor
    scene: torch.Tensor
    index: torch.Tensor
    label: torch.Tensor
    quaternion: torch.Tensor
    width: torch.Tensor


@dataclass(frozen=True, eq=False)
class Draw:
    """One field of one scene and the trials that lie in it; arrays as in `Batch`, without its first axis."""

    tsdf: NDArray[np.float16]
    index: NDArray[np.intp]
    label: NDArray[np.bool_]
    quaternion: FloatArray
    width: FloatArray

    def balanced(self, rng: np.random.Generator) -> Draw:
        """Return the trials that held and as many that did not, at least two; each at most `MOST_OF_SCENE`."""
        held, missed = np.flatnonzero(self.label), np.flatnonzero(~self.label)
        held = rng.permutation(held)[:MAX_OF_SCENE]
        part = np.concatenate([held, rng.permutation(missed)[: max(len(held), 2)]])
        return Draw(self.tsdf, self.index[part], self.label[part], self.quaternion[part], self.width[part])


def draw(scene: TriedScene, pose: str, rng: np.random.Generator) -> Draw | None:
    """Draw a field of one scene; None when the views show next to nothing or no trial lies in it.

    Args:
        scene: The trials.
        pose: ``"gripper"`` scenes are turned about the vertical by any angle. ``"hand"`` scenes are turned less, and
            trials that then lie outside of the angles that the hand is tried at are left out.
        rng: Decides everything.
    """
    count = int(rng.integers(1, len(scene.views) + 1)) if pose == GRIPPER else 1
    chosen = rng.choice(len(scene.views), count, replace=False)
    turn = rng.uniform(0, 2 * np.pi) if pose == GRIPPER else rng.uniform(-HAND_TURN, HAND_TURN)
    T = make_transform(rotation_about("z", turn))
    views = tuple(_moved(scene.views[v], T, rng) for v in chosen)
    shift = rng.uniform(-SHIFT, SHIFT, 3)
    try:
        center = center_of(views[0].points, scene.table_top)
        volume = Volume.around(center + [shift[0], shift[1], 0.0], scene.table_top + min(shift[2], 0.0))
        tsdf = volume.tsdf(views, scene.table_top if rng.integers(2) else None)
    except DataError:
        return None
    poses = T @ scene.poses
    index = volume.index_of(poses[:, :3, 3])
    inside = np.all((index >= BORDER) & (index < RESOLUTION - BORDER), axis=1)
    if pose != GRIPPER:
        yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0]) % (2 * np.pi)
        inside &= (yaw >= YAW[0]) & (yaw <= YAW[1])
    if not inside.any():
        return None
    quaternion = Rotation.from_matrix(poses[inside, :3, :3]).as_quat()
    field = tsdf.astype(np.float16)
    return Draw(field, index[inside], scene.success[inside], quaternion, scene.widths[inside] / VOXEL)


def _moved(view: PointCloud, T: FloatArray, rng: np.random.Generator) -> PointCloud:
    assert view.viewpoint is not None
    points = thin(view.points, MAX_POINTS)
    points = points @ T[:3, :3].T + rng.normal(0.0, NOISE, points.shape)
    return PointCloud(points, viewpoint=T[:3, :3] @ view.viewpoint)


def collate(draws: list[Draw]) -> Batch:
    """Put draws into one batch."""
    return Batch(
        torch.from_numpy(np.stack([d.tsdf for d in draws]).astype(np.float32))[:, None],
        torch.from_numpy(np.repeat(np.arange(len(draws)), [len(d.index) for d in draws])),
        torch.from_numpy(np.concatenate([d.index for d in draws])),
        torch.from_numpy(np.concatenate([d.label for d in draws]).astype(np.float32)),
        torch.from_numpy(np.concatenate([d.quaternion for d in draws]).astype(np.float32)),
        torch.from_numpy(np.concatenate([d.width for d in draws]).astype(np.float32)),
    )
