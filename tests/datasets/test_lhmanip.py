"""LHManip's reader promises: steps as recorded, in SI units and wxyz, and no trust in pickles."""

from __future__ import annotations

import importlib.util
import pickle
from pathlib import Path

import numpy as np
import pytest

from icub_core.errors import DataError
from icub_datasets.lhmanip import LHManip
from icub_testing.contracts import EpisodesContract

_spec = importlib.util.spec_from_file_location("dataset_layouts", Path(__file__).parent / "layouts.py")
layouts = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(layouts)

STEPS = 3


def write_episode(folder: Path, instruction: str, seed: int) -> dict:
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(STEPS, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    states = rng.normal(size=(STEPS, 25))  # longer than documented: the first 23 count
    states[:, 3:7] = quat
    content = {
        "observations": {"states": list(states)},
        "actions": list(rng.normal(size=(STEPS, 8))),
        "language_instruction": [instruction] * STEPS,
        "depth_scales": [0.001, 0.0005, 0.0001] * STEPS,
    }
    for suffix in ("", "_left", "_wrist"):
        for i in range(STEPS):
            layouts.write_png(folder / f"images{suffix}" / f"{i}.png", layouts.random_image(i, (12, 16)))
            layouts.write_png(folder / f"depth{suffix}" / f"{i}.png", np.full((12, 21), 1000 + i, np.uint16))
    (folder / "data.pkl").write_bytes(pickle.dumps(content, protocol=2))
    return content


@pytest.fixture
def lhmanip(tmp_path):
    for task in ("stack the cups", "open the drawer"):
        for number in (0, 1, 10):
            write_episode(tmp_path / task / str(number), task.capitalize(), number)
    (tmp_path / "README.md").write_text("a stray file")
    (tmp_path / "stack the cups" / "notes").mkdir()
    return tmp_path


class TestContract(EpisodesContract):
    @pytest.fixture
    def make_plugin(self, lhmanip):
        return lambda: LHManip(path=lhmanip)


def test_episodes_are_found_in_order_among_stray_files(lhmanip):
    dataset = LHManip(lhmanip)
    assert dataset.tasks == ("open the drawer", "stack the cups")
    assert [(e.task, e.folder.name) for e in dataset] == [(t, n) for t in dataset.tasks for n in ("0", "1", "10")]
    assert dataset[3].instruction == "Stack the cups"


def test_a_step_is_in_metres_and_wxyz(lhmanip):
    content = write_episode(lhmanip / "stack the cups" / "0", "Stack the cups", 7)
    episode = LHManip(lhmanip)[3]
    steps = list(episode)
    assert len(steps) == len(episode) == STEPS
    state, action = content["observations"]["states"][1], content["actions"][1]
    step = steps[1]
    np.testing.assert_array_equal(step.state["position"], state[:3])
    np.testing.assert_array_equal(step.state["quat_wxyz"], state[[6, 3, 4, 5]])
    np.testing.assert_array_equal(step.state["joint_positions"], state[7:14])
    np.testing.assert_array_equal(step.state["gripper"], state[14:16])
    np.testing.assert_array_equal(step.state["joint_velocities"], state[16:23])
    np.testing.assert_array_equal(step.action, action[[0, 1, 2, 6, 3, 4, 5, 7]])
    assert [step.depth[c][0, 0] for c in ("main", "left", "wrist")] == pytest.approx([1.001, 0.5005, 0.1001])
    np.testing.assert_array_equal(step.rgb["wrist"], layouts.random_image(1, (12, 16))[..., ::-1])
    with pytest.raises(IndexError):
        episode[STEPS]


def test_damaged_episodes_are_named_and_spare_the_others(lhmanip):
    broken = lhmanip / "open the drawer" / "0"
    (broken / "images" / "2.png").unlink()
    dataset = LHManip(lhmanip)
    with pytest.raises(DataError, match=r"states is \(3, 23\); expected \(2, 23\)"):
        dataset[0][0]
    assert len(dataset[1]) == STEPS
    (broken / "data.pkl").write_bytes(pickle.dumps({"actions": []}))
    with pytest.raises(DataError, match="language_instruction"):
        len(LHManip(lhmanip)[0])
    (broken / "data.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(DataError, match="names os.system"):
        len(LHManip(lhmanip)[0])
    (lhmanip / "open the drawer" / "1" / "depth_wrist" / "0.png").write_bytes(b"")
    with pytest.raises(DataError, match="depth_wrist/0.png"):
        dataset[1][0]


def test_a_foreign_folder_is_named(tmp_path):
    with pytest.raises(DataError, match="TASK/NUMBER/data.pkl"):
        LHManip(tmp_path)
    with pytest.raises(DataError, match="not a folder; expected the folder of LHManip$"):
        LHManip(tmp_path / "absent")
