"""What was written for version 0.1 keeps working with a warning, or stops with one line that names the version."""

import json

import pytest
import torch

from icub_core.cli import main
from icub_core.construct import build
from icub_core.errors import PluginError
from icub_testing.checks import run_checks

SCRIPTED_POLICY = """
from icub_core.grasping.spaces import ACTION_SIZE, PLAN
from icub_core.interfaces.policy import Policy

class Old(Policy):
    def act(self, observation):
        return observation[PLAN][:, :ACTION_SIZE]
"""
LISTENING_POLICY = """
import torch
from icub_core.interfaces.policy import LearnReport, Policy

class Old(Policy):
    def act(self, observation):
        action = torch.zeros(len(observation["touch"]), 15)
        action[:, 6:] = 0.5
        return action

    def learn(self, env, run_dir, progress):
        return LearnReport(env_steps=1)
"""
PLAN_READER = """
from icub_core.interfaces.policy import Policy

class Old(Policy):
    def act(self, observation):
        return observation["plan"][:, :10]
"""
ROBOT = """
from pathlib import Path
import numpy as np
from icub_core.interfaces.robot import Robot
from icub_core.robot_description import RobotDescription

class Old(Robot):
    def __init__(self):
        self._description = RobotDescription(
            name="old", urdf=Path("old.urdf"), T_world_root=np.eye(4), joint_names=("a",), lower=np.zeros(1),
            upper=np.ones(1), groups={"right_reach": ("a",)}, actuators=(), home={}, fingertips={"right": ()},
            hand_frames={"right": "hand"}, hand_actuators={"right": ()},
        )

    description = forward_kinematics = jacobian = inverse_kinematics = None
"""
HEAD = """
import torch
from icub_core.errors import DataError, NotFittedError
from icub_core.testing.tiny.perception import TinyHead

class Old(TinyHead):
    '''A head of version 0.1 knows nothing of what scores mean.'''
"""
OBJECTS = """
from icub_core.testing.tiny.things import TinyObjects

class Old(TinyObjects):
    pass
"""


@pytest.fixture
def old(install):
    """Install one old plugin."""

    def _old(kind, code):
        install(f"old-{kind}", {f"icub.{kind}": {"old": f"old_{kind}:Old"}}, {f"old_{kind}.py": code})

    return _old


def test_a_policy_that_imports_what_is_gone_stops_with_the_version(old):
    old("policy", SCRIPTED_POLICY)
    with pytest.warns(DeprecationWarning, match="icub_tasks"), pytest.raises(PluginError) as caught:
        build("policy", "old")
    assert "interface 'policy' has version 2" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_policy_that_reads_what_is_gone_stops_with_the_version(old):
    from icub_core.rollouts import evaluate
    from icub_testing.tiny.task import TinyTask

    old("policy", PLAN_READER)
    with pytest.raises(PluginError, match=r"'plan'.*version 1 of the interface\? this is version 2") as caught:
        evaluate(build("policy", "old"), TinyTask(), episodes=1)
    assert "\n" not in str(caught.value)


def test_a_policy_that_needs_nothing_old_still_acts(old):
    from icub_core.rollouts import evaluate
    from icub_testing.tiny.task import TinyTask

    old("policy", LISTENING_POLICY)
    policy, task = build("policy", "old"), TinyTask(fingers=9, fingertips=5)
    assert evaluate(policy, task, episodes=2).steps.min() >= 1
    assert torch.equal(policy.act(task.observe())[:, 6:], torch.full((2, 9), 0.5))


def test_a_robot_described_the_old_way_stops_with_the_version(old):
    old("robot", ROBOT)
    with pytest.raises(PluginError, match=r"hand_frames|fingertips") as caught:
        build("robot", "old")
    assert "'robot' has version 2 here" in str(caught.value) or "version 2" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("kind", "code"), [("online_head", HEAD), ("objects", OBJECTS)])
def test_an_old_plugin_of_an_unchanged_kind_keeps_its_contract(old, kind, code):
    old(kind, code)
    problems = [result.problem for result in run_checks(kind, lambda: build(kind, "old")) if result.problem]
    assert problems == []


def test_the_run_folder_of_another_version_is_refused(tmp_path, capsys):
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "overrides.yaml").write_text("- policy=demonstrations\n")
    (tmp_path / "provenance.json").write_text(json.dumps({"versions": {"icub-kit": "0.1.0"}}))
    assert main(["run", "--resume", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "was begun by icub-kit 0.1.0, this is" in error
    assert error.count("\n") == 1
