"""LHManip: teleoperated, long-horizon manipulation episodes of a Franka Panda, each with an instruction in words."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from icub_core.errors import DataError
from icub_core.geometry import FloatArray
from icub_core.interfaces.episodes import Episode, Episodes, Step
from icub_datasets.reading import read_channel, read_rgb, require_folder
from icub_datasets.unpickle import load_plain_pickle

CAMERAS = {"main": "", "left": "_left", "wrist": "_wrist"}
"""Camera to suffix of its folders ``images`` and ``depth``; also the order of the depth scales."""
STATE_SIZE, ACTION_SIZE = 23, 8
_WXYZ = [3, 0, 1, 2]  # the files hold xyzw


class PandaEpisode(Episode):
    """One demonstration. States and actions are read at first use, images step by step.

    Steps have the cameras ``main``, ``left`` (both fixed) and ``wrist``: color 640 x 480, depth 848 x 480, not aligned.
    Their state is ``position`` (3,) and ``quat_wxyz`` (4,) of the gripper in the robot's base, ``joint_positions`` (7,)
    and ``joint_velocities`` (7,), ``gripper`` (2,) finger positions. The action (8,) is the change of position (3), of
    orientation as quaternion wxyz (4) and of the gripper's opening (1). Every episode ends with success.
    """

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

    def __getitem__(self, index: int) -> Step:
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
        measured = {
            "position": state[:3],
            "quat_wxyz": state[3:7][_WXYZ],
            "joint_positions": state[7:14],
            "gripper": state[14:16],
            "joint_velocities": state[16:23],
        }
        return Step(rgb, depth, measured, np.concatenate([action[:3], action[3:7][_WXYZ], action[7:]]))

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
                f"{file}: expected observations.states, actions, depth_scales (3 per step) and language_instruction"
            ) from error
        expected = {"states": (steps, STATE_SIZE), "actions": (steps, ACTION_SIZE), "depth_scales": (steps, 3)}
        for (name, shape), found in zip(expected.items(), (states, actions, scales), strict=True):
            if found.shape != shape:
                raise DataError(f"{file}: {name} is {found.shape}; expected {shape} for the {steps} images in images")
        return states, actions, scales, instruction


class LHManip(Episodes):
    """20 long-horizon tasks of a Franka Panda, ten demonstrations each, with instructions.

    Layout: ``TASK/NUMBER/`` with ``data.pkl`` and the folders ``images``, ``images_left``, ``images_wrist``, ``depth``,
    ``depth_left``, ``depth_wrist`` (30 steps per second). Other files and folders are passed over. The pickles are read
    without running anything.

    Args:
        path: Folder of the data set.

    Raises:
        DataError: Not a folder, or no episode in it.

    Source: thesis chapter 14.
    """

    def __init__(self, path: Path) -> None:
        root = require_folder(path, "LHManip", [])
        folders = [f for f in root.glob("*/*") if f.name.isdigit() and (f / "data.pkl").is_file()]
        if not folders:
            raise DataError(f"{root} holds no episode; expected the folder of LHManip with TASK/NUMBER/data.pkl")
        folders.sort(key=lambda f: (f.parent.name, int(f.name)))
        self._episodes = tuple(PandaEpisode(folder) for folder in folders)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Names of the tasks, sorted."""
        return tuple(dict.fromkeys(episode.task for episode in self._episodes))

    def __len__(self) -> int:
        return len(self._episodes)

    def __getitem__(self, index: int) -> PandaEpisode:
        return self._episodes[index]
