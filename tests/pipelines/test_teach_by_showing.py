"""Teaching by showing, as a user meets it: the terminal mode, the script, and what counts as a mistake."""

import json
import subprocess
import sys

import numpy as np
import pytest

from icub_core.cli import main
from icub_core.data import Instance
from icub_pipelines.teaching_session import identities, mistakes, recognized


def instance(label, rows, score=1.0):
    mask = np.zeros((20, 20), bool)
    mask[rows] = True
    return Instance.from_mask(label, mask, score)


def test_a_mistake_is_an_object_that_is_called_by_anothers_name():
    truth = [instance("cup", slice(0, 8)), instance("can", slice(10, 18))]
    found = [
        instance("can", slice(0, 8), 0.9),  # the cup is called can
        instance("can", slice(10, 18), 0.5),  # right, but a user is shown the best can only
        instance("box", slice(8, 10), 0.8),  # nothing is there: no object's name was mistaken
        instance("jug", slice(10, 18), -0.1),  # below zero is not shown
    ]
    (mistake,) = mistakes(found, truth)
    assert (mistake.shown, mistake.taken_for, mistake.score) == ("cup", "can", 0.9)
    assert [(i.label, name) for i, name in identities(found, truth)] == [("can", "cup"), ("box", None)]
    assert recognized(found, truth, "can") is False
    assert recognized(found, truth, "jug") is None
    assert mistakes([], truth) == [] == mistakes(found, [])


def run(folder, *words, stdin=""):
    command = [sys.executable, "-m", "icub_core.cli", "run", "pipeline=teach_by_showing", *words]
    return subprocess.run(command, cwd=folder, input=stdin, capture_output=True, text=True)


@pytest.mark.slow
def test_a_conversation_answers_every_line_and_goes_on_after_wrong_ones(tmp_path):
    words = ("+segmenter=falkon", "pipeline.interactive=true", "pipeline.frames=14", "pipeline.distractors=2")
    talk = (
        "look\nteach 005_tomato_soup\nteach 005_tomato_soup_can\nknown\nlok\nlook 005_tomato_soup_can\n\nobjects now\n"
    )
    done = run(tmp_path, *words, stdin=talk)
    assert done.returncode == 0, done.stderr
    answers = " ".join(done.stdout.split())
    assert "nothing is known yet" in answers
    assert "Did you mean '005_tomato_soup_can'?" in answers
    assert "learned 005_tomato_soup_can" in answers
    assert "no command named 'lok'. Did you mean 'look'?" in answers
    assert "objects takes no names" in answers
    (metrics,) = (tmp_path / "runs").rglob("metrics.json")
    assert json.loads(metrics.read_text())["showing.objects"] == 1
    assert (metrics.parent / "look_01.png").exists()
    again = run(tmp_path, "--resume", str(metrics.parent), stdin="known\n")
    assert again.returncode == 0, again.stderr
    assert "icub> 005_tomato_soup_can" in again.stdout, "what was learned is there when the conversation goes on"


def test_without_a_segmenter_there_is_nobody_to_teach(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "pipeline=teach_by_showing"]) != 0
    assert "choose +segmenter=falkon" in capsys.readouterr().err


@pytest.mark.slow
def test_a_mistaken_object_is_taught_and_mistaken_less(tmp_path):
    done = run(tmp_path, "+segmenter=falkon", "pipeline.frames=30", "pipeline.looks=16")
    assert done.returncode == 0, done.stderr
    (path,) = (tmp_path / "runs").rglob("metrics.json")
    metrics = json.loads(path.read_text())
    assert metrics["showing.objects"] == 3
    assert metrics["showing.false_positives_before"] > 0, "among ten unknown objects some are mistaken"
    assert metrics["showing.false_positives_after"] < metrics["showing.false_positives_before"]
    assert metrics["showing.corrected_recall"] > 0
    assert metrics["showing.map50_segm_after"] > metrics["showing.map50_segm_before"] - 0.05, "old objects are kept"
    assert {"before.png", "after.png", "correction.png", "taught.png"} <= {p.name for p in path.parent.iterdir()}
