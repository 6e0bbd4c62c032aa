"""From grasp trials to what the network learns from: fields, voxels and labels, drawn anew every time.

Each draw takes one view or several, puts the table in or leaves it out, moves the cube a little, and for a gripper
turns the scene about the vertical (an iCub's hand reaches from one side only).
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
from icub_grasp_generators.clouds import center_of
from icub_grasp_generators.vgn.network import GRIPPER
from icub_grasp_generators.vgn.trials import TriedScene
from icub_grasp_generators.vgn.volume import RESOLUTION, VOXEL, Volume

SHIFT = 0.03
"""Metres; half range of the cube's place around the object, so that no place in it is special."""
NOISE = 0.001
"""Metres; standard deviation of the points."""
MOST_OF_SCENE = 16
"""Trials of one scene that one draw uses, as many held as not where there are."""
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
class _Draw:
    tsdf: NDArray[np.float32]
    index: NDArray[np.intp]
    label: NDArray[np.bool_]
    quaternion: FloatArray
    width: FloatArray


def draw(scene: TriedScene, pose: str, rng: np.random.Generator, balanced: bool = True) -> _Draw | None:
    """Draw a field of one scene with some of its trials; None when the views show next to nothing.

    Args:
        scene: The trials.
        pose: ``"gripper"`` scenes are turned about the vertical, ``"hand"`` scenes are not.
        rng: Decides everything.
        balanced: Take as many held trials as others where there are; otherwise all.
    """
    count = int(rng.integers(1, len(scene.views) + 1)) if pose == GRIPPER else 1
    chosen = rng.choice(len(scene.views), count, replace=False)
    T = make_transform(rotation_about("z", rng.uniform(0, 2 * np.pi)) if pose == GRIPPER else None)
    views = tuple(_moved(scene.views[v], T, rng) for v in chosen)
    try:
        center = center_of(views[0].points, scene.table_top)
    except DataError:
        return None
    shift = rng.uniform(-SHIFT, SHIFT, 3)
    volume = Volume.around(center + [shift[0], shift[1], 0.0], scene.table_top + min(shift[2], 0.0))
    table_in = bool(rng.integers(2))
    try:
        tsdf = volume.tsdf(views, scene.table_top if table_in else None)
    except DataError:
        return None
    poses = T @ scene.poses
    index = volume.index_of(poses[:, :3, 3])
    inside = np.flatnonzero(np.all((index >= BORDER) & (index < RESOLUTION - BORDER), axis=1))
    if balanced:
        held, missed = inside[scene.success[inside]], inside[~scene.success[inside]]
        each = max(min(len(held), len(missed), MOST_OF_SCENE // 2), 2)
        inside = np.concatenate([rng.permutation(held)[:each], rng.permutation(missed)[:each]])
    if len(inside) == 0:
        return None
    quaternion = Rotation.from_matrix(poses[inside, :3, :3]).as_quat()
    return _Draw(tsdf, index[inside], scene.success[inside], quaternion, scene.widths[inside] / VOXEL)


def _moved(view: PointCloud, T: FloatArray, rng: np.random.Generator) -> PointCloud:
    assert view.viewpoint is not None
    points = view.points @ T[:3, :3].T + rng.normal(0.0, NOISE, view.points.shape)
    return PointCloud(points, viewpoint=T[:3, :3] @ view.viewpoint)


def collate(draws: list[_Draw]) -> Batch:
    """Put draws into one batch."""
    return Batch(
        torch.from_numpy(np.stack([d.tsdf for d in draws]))[:, None],
        torch.from_numpy(np.repeat(np.arange(len(draws)), [len(d.index) for d in draws])),
        torch.from_numpy(np.concatenate([d.index for d in draws])),
        torch.from_numpy(np.concatenate([d.label for d in draws]).astype(np.float32)),
        torch.from_numpy(np.concatenate([d.quaternion for d in draws]).astype(np.float32)),
        torch.from_numpy(np.concatenate([d.width for d in draws]).astype(np.float32)),
    )
