"""Without PyBullet, what needs it stops before it starts, in one line that says what to install."""

import sys
from pathlib import Path

import pytest

from icub_core.errors import DataError, SimulationError
from icub_datasets.feature_task.objects import feature_task_objects
from icub_datasets.feature_task.task import FeatureTask
from icub_grasp_generators.vgn.gripper_trials import GripperTrials
from icub_grasp_generators.vgn.hand_trials import HandTrials
from icub_policies.pretraining import pretrain
from icub_simulators.objects.random1000 import Random1000
from icub_simulators.pybullet.simulator import PyBullet


@pytest.fixture(autouse=True)
def no_bullet(monkeypatch):
    for name in ("pybullet", "pybullet_data"):
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(
    ("start", "error"),
    [
        (PyBullet, SimulationError),
        (Random1000, DataError),
        (feature_task_objects, DataError),
        (lambda: GripperTrials(0), DataError),
        (lambda: HandTrials(0), DataError),
        (lambda: pretrain(Path("nowhere"), 0), DataError),
    ],
    ids=["simulator", "random1000", "feature_task", "gripper_trials", "hand_trials", "pretraining"],
)
def test_what_needs_it_names_the_extra(start, error):
    with pytest.raises(error, match=r"needs .*package pybullet.*pip install 'icub-kit\[pybullet\]'") as caught:
        start()
    assert "\n" not in str(caught.value)


def test_no_frame_is_rendered_without_the_meshes(tmp_path):
    with pytest.raises(DataError, match="feature_task"):
        FeatureTask(tmp_path / "frames", frames=100).prepare()
    assert not list(tmp_path.rglob("*.npz"))
