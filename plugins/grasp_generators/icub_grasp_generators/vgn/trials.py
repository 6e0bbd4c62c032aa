"""What grasp trials leave behind: the views of a scene and the poses tried in it, in files of many scenes.

A file is an NPZ of plain arrays, written in one step; `read_trials` gives back what `write_trials` took.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from icub_core.data import PointCloud
from icub_core.errors import DataError
from icub_core.files import write_atomically
from icub_core.geometry import FloatArray

HELD_OUT = 10
"""Every tenth object is never trained on."""


@dataclass(frozen=True, eq=False)
class TriedScene:
    """One object where it stood, and the grasps that were tried on it.

    Attributes:
        object_index: Place of the object in its set; decides whether the scene is held out.
        table_top: World height, meters.
        views: Clouds of the object, one a camera, each with its viewpoint.
        poses: (G, 4, 4) poses whose origin is what a voxel stands for: a gripper's, or a hand's palm point.
        widths: (G,) opening at the grasp, meters; 0 where a hand has none.
        success: (G,) bool.
    """

    object_index: int
    table_top: float
    views: tuple[PointCloud, ...]
    poses: FloatArray
    widths: FloatArray
    success: NDArray[np.bool_]

    @property
    def held_out(self) -> bool:
        """Whether the object belongs to those that are never trained on."""
        return is_held_out(self.object_index)


def is_held_out(object_index: int) -> bool:
    """Return True if an object, by its place in its set, is never trained on."""
    return object_index % HELD_OUT == HELD_OUT - 1


def write_trials(path: Path, scenes: Sequence[TriedScene]) -> None:
    """Write scenes to one file in one step. Raises CheckpointError when the file cannot be written."""
    arrays: dict[str, NDArray[np.generic]] = {
        "object_index": np.array([s.object_index for s in scenes], dtype=np.int64),
        "table_top": np.array([s.table_top for s in scenes]),
        "views": np.array([len(s.views) for s in scenes], dtype=np.int64),
        "grasps": np.array([len(s.poses) for s in scenes], dtype=np.int64),
        "points_of_view": np.array([len(v) for s in scenes for v in s.views], dtype=np.int64),
        "viewpoints": np.array([_viewpoint(v) for s in scenes for v in s.views]).reshape(-1, 3),
        "points": np.concatenate([np.zeros((0, 3)), *(v.points for s in scenes for v in s.views)]).astype(np.float32),
        "poses": np.concatenate([np.zeros((0, 4, 4)), *(s.poses for s in scenes)]),
        "widths": np.concatenate([np.zeros(0), *(s.widths for s in scenes)]),
        "success": np.concatenate([np.zeros(0, dtype=bool), *(s.success for s in scenes)]),
    }

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_atomically(path, write)


def _viewpoint(view: PointCloud) -> FloatArray:
    if view.viewpoint is None:
        raise DataError("a view without its viewpoint cannot be kept: the signed distance needs the camera's place")
    return view.viewpoint


def read_trials(path: Path) -> Iterator[TriedScene]:
    """Read the scenes of one file, in their order. Raises DataError for a file that is not of this kind."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        clouds = np.split(arrays["points"].astype(np.float64), np.cumsum(arrays["points_of_view"])[:-1])
        ends = np.cumsum(arrays["grasps"])[:-1]
        poses, widths, success = (np.split(arrays[k], ends) for k in ("poses", "widths", "success"))
        firsts = np.concatenate([[0], np.cumsum(arrays["views"])])
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"{path} is not a readable file of grasp trials: {error}") from error
    for i in range(len(arrays["object_index"])):
        views = tuple(PointCloud(clouds[v], viewpoint=arrays["viewpoints"][v]) for v in range(firsts[i], firsts[i + 1]))
        yield TriedScene(
            int(arrays["object_index"][i]), float(arrays["table_top"][i]), views, poses[i], widths[i], success[i]
        )
