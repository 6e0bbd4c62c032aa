"""LHManip: teleoperated, long-horizon manipulation episodes of a Franka Panda, each with an instruction in words.

Episodes are no annotated images, so this is a reader of its own and no `dataset` plugin::

    for episode in LHManip(Path("LHManip")):
        for step in episode:
            step.rgb["main"], step.action
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import DataError
from icub_core.geometry import FloatArray
from icub_datasets.reading import read_channel, read_rgb, require_folder
from icub_datasets.unpickle import load_plain_pickle

CAMERAS = {"main": "", "left": "_left", "wrist": "_wrist"}
"""Camera to suffix of its folders ``images`` and ``depth``; also the order of the depth scales."""
STATE_SIZE, ACTION_SIZE = 23, 8
_WXYZ = [3, 0, 1, 2]  # the files hold xyzw


@dataclass(frozen=True, eq=False)
class ManipulationStep:
    """What the robot saw, where it was, and what was commanded.

    Attributes:
        rgb: Camera to (480, 640, 3) uint8; cameras ``main``, ``left`` (both fixed), ``wrist``.
        depth: Camera to (480, 848) float32 meters, 0 where nothing was measured; not aligned with the color image.
        position: (3,) of the gripper, robot base, meters.
        quat_wxyz: (4,) of the gripper.
        joint_positions: (7,) rad.
        gripper: (2,) finger positions, meters.
        joint_velocities: (7,) rad/s.
        action: (8,): change of position (3), of orientation as quaternion wxyz (4), of the gripper's opening (1).
        is_first: Whether the episode begins here.
        is_last: Whether it ends here, with success: the reward is 1 here and 0 elsewhere.
    """

    rgb: dict[str, NDArray[np.uint8]]
    depth: dict[str, NDArray[np.float32]]
    position: FloatArray
    quat_wxyz: FloatArray
    joint_positions: FloatArray
    gripper: FloatArray
    joint_velocities: FloatArray
    action: FloatArray
    is_first: bool
    is_last: bool


class Episode:
    """One demonstration. States and actions are read at first use, images step by step."""

    def __init__(self, folder: Path) -> None:
        """Remember the folder of the episode."""
        self.folder = folder

    @property
    def task(self) -> str:
        """Name of the task, as its folder is called."""
        return self.folder.parent.name

    @property
    def instruction(self) -> str:
        """What the robot was told."""
        return self._data[3]

    @property
    def states(self) -> FloatArray:
        """(N, 23): position, quaternion xyzw, joint angles, gripper, joint velocities, as in the file."""
        return self._data[0]

    @property
    def actions(self) -> FloatArray:
        """(N, 8): change of position, of orientation (xyzw), of the gripper's opening, as in the file."""
        return self._data[1]

    def __len__(self) -> int:
        return len(self.states)

    def __getitem__(self, index: int) -> ManipulationStep:
        """Read one step; IndexError past the end, DataError naming a file that cannot be read."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"step {index} of {len(self)}")
        index %= len(self)
        state, action, scales = self.states[index], self.actions[index], self._data[2][index]
        rgb, depth = {}, {}
        for (camera, suffix), scale in zip(CAMERAS.items(), scales, strict=True):
            rgb[camera] = read_rgb(self.folder / f"images{suffix}" / f"{index}.png")
            units = read_channel(self.folder / f"depth{suffix}" / f"{index}.png")
            depth[camera] = (np.asarray(units, dtype=np.float64) * scale).astype(np.float32)
        return ManipulationStep(
            rgb, depth, state[:3], state[3:7][_WXYZ], state[7:14], state[14:16], state[16:23],
            np.concatenate([action[:3], action[3:7][_WXYZ], action[7:]]), index == 0, index == len(self) - 1,
        )  # fmt: skip

    def __iter__(self) -> Iterator[ManipulationStep]:
        return (self[index] for index in range(len(self)))

    @cached_property
    def _data(self) -> tuple[FloatArray, FloatArray, FloatArray, str]:
        file = self.folder / "data.pkl"
        steps = sum(1 for p in (self.folder / "images").glob("*.png") if p.stem.isdigit())
        content: Any = load_plain_pickle(file)
        try:
            observed = content["observations"]["states"]
            states = np.array([np.asarray(s, dtype=np.float64)[:STATE_SIZE] for s in observed])
            actions = np.array(content["actions"], dtype=np.float64)
            scales = np.array(content["depth_scales"], dtype=np.float64).reshape(-1, len(CAMERAS))
            instruction = str(content["language_instruction"][0])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise DataError(
                f"{file}: expected observations.states, actions, depth_scales (3 a step) and language_instruction"
            ) from error
        expected = {"states": (steps, STATE_SIZE), "actions": (steps, ACTION_SIZE), "depth_scales": (steps, 3)}
        for (name, shape), found in zip(expected.items(), (states, actions, scales), strict=True):
            if found.shape != shape:
                raise DataError(f"{file}: {name} is {found.shape}; expected {shape} for the {steps} images in images")
        return states, actions, scales, instruction


class LHManip:
    """All episodes of a copy of the data set, by task and number.

    Layout: ``TASK/NUMBER/`` with ``data.pkl`` and the folders ``images``, ``images_left``, ``images_wrist``, ``depth``,
    ``depth_left``, ``depth_wrist`` (20 tasks of 10 episodes, 30 steps a second). Other files and folders are passed
    over. The pickles are read without running anything.

    Source: thesis chapter 14.
    """

    def __init__(self, path: Path) -> None:
        """Find the episodes; nothing is read yet.

        Args:
            path: Folder of the data set.

        Raises:
            DataError: Not a folder, or no episode in it.
        """
        root = require_folder(path, "LHManip", [])
        folders = [f for f in root.glob("*/*") if f.name.isdigit() and (f / "data.pkl").is_file()]
        if not folders:
            raise DataError(f"{root} holds no episode; expected the folder of LHManip with TASK/NUMBER/data.pkl")
        folders.sort(key=lambda f: (f.parent.name, int(f.name)))
        self._episodes = tuple(Episode(folder) for folder in folders)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Names of the tasks, sorted."""
        return tuple(dict.fromkeys(episode.task for episode in self._episodes))

    def __len__(self) -> int:
        return len(self._episodes)

    def __getitem__(self, index: int) -> Episode:
        return self._episodes[index]
