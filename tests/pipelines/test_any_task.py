"""The main job on tiny plugins: any task, any hand, and no setting that is ignored."""

import json
from pathlib import Path

import pytest

from icub_core.cli import main

FEW = ["pipeline.grasp.episodes=3", "pipeline.grasp.worlds=2", "pipeline.grasp.video_episodes=1", "run_dir=here"]


def figures() -> dict:
    return json.loads(Path("here/metrics.json").read_text())


def test_the_grasping_task_runs_with_a_claw_of_three_fingers(tiny_world):
    assert main(["run", *tiny_world, *FEW]) == 0
    assert figures()["grasp.episodes"] == 3
    assert figures()["plan.share_with_plan"] == 1
    assert Path("here/grasp.gif").exists()


def test_another_task_runs_in_the_same_pipeline(tiny_world):
    assert main(["run", *tiny_world, "task=tiny", *FEW]) == 0
    assert figures()["grasp.episodes"] == 3
    assert "plan.share_with_plan" not in figures()
    assert "the task 'TinyTask' plans no grasps" in Path("here/report.html").read_text()


@pytest.mark.parametrize(
    ("word", "instead"),
    [
        ("task.num_envs=16", "pipeline.grasp.worlds=16"),
        ("task.starts=3", "pipeline.grasp.starts=3"),
        ("task.threads=2", "pipeline.grasp.threads=2"),
        ("task.visual=true", "pipeline.grasp.visual=True"),
    ],
)
def test_a_setting_that_the_pipeline_decides_is_refused_instead_of_ignored(tiny_world, capsys, word, instead):
    assert main(["run", *tiny_world, word, *FEW]) == 2
    assert f"in this pipeline; type {instead}" in capsys.readouterr().err
    assert not Path("here/metrics.json").exists()


def test_a_policy_without_a_task_is_one_line(tiny_world, capsys):
    assert main(["run", *tiny_world, "~task", *FEW]) == 2
    assert "a policy acts in a task; add task=NAME" in capsys.readouterr().err
