"""The command as a user types it: real physics, real rendering, shipped weights; only the numbers are small."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import trimesh
import yaml

from icub_core.cli import main


def icub(*words, cwd, **options):
    return subprocess.run(
        [sys.executable, "-m", "icub_core.cli", *words], cwd=cwd, capture_output=True, text=True, **options
    )


def the_only_run(folder):
    (metrics,) = (folder / "runs").rglob("metrics.json")
    return metrics.parent


def test_a_scripted_grasp_with_ground_truth_masks(tmp_path):
    done = icub(
        "run", "policy=demonstrations", "pipeline.grasp.episodes=2", "pipeline.grasp.worlds=1",
        "pipeline.grasp.video_episodes=1", "pipeline.grasp.target=005_tomato_soup_can", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    run_dir = the_only_run(tmp_path)
    metrics = json.loads((run_dir / "metrics.json").read_text())
    assert metrics["grasp.episodes"] == 2
    assert metrics["grasp.success_rate"] >= 0.5, "a can on the table is the easiest object there is"
    assert metrics["grasp.success_rate"] * 2 == metrics.get("grasp.ended_success", 0)
    assert 0 < metrics["plan.share_with_plan"] <= 1
    assert yaml.safe_load((run_dir / "config.yaml").read_text())["policy"]["plugin"] == "demonstrations"
    provenance = json.loads((run_dir / "provenance.json").read_text())
    assert provenance["seed"] == 0
    assert {"torch", "mujoco", "python"} <= set(provenance["versions"])
    report = (run_dir / "report.html").read_text()
    assert "ground truth" in report, "a stage without plugin is named"
    assert "data:image/gif" in report
    assert (run_dir / "run.log").exists()


@pytest.mark.pybullet
@pytest.mark.slow
def test_a_folder_of_meshes_is_grasped_without_naming_anything_else(tmp_path):
    trimesh.creation.cylinder(0.03, 0.11).export(tmp_path / "tin.stl")
    trimesh.creation.box((0.05, 0.09, 0.16)).export(tmp_path / "carton.obj")
    done = icub(
        "run", "+grasp_generator=vgn", "simulator=pybullet", "objects=folder", f"objects.path={tmp_path}",
        "pipeline.grasp.episodes=4", "pipeline.grasp.worlds=2", "pipeline.grasp.video_episodes=0", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "carried out by 'demonstrations'" in done.stderr
    metrics = json.loads((the_only_run(tmp_path) / "metrics.json").read_text())
    assert metrics["grasp.episodes"] == 4
    assert metrics["grasp.success_rate"] >= 0.5, "the carton is no harder than those the weights were made for"


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("pipeline.grasp.target=006_mustrad_bottle", "006_mustard_bottle"),
        ("pipeline.grasp.episods=3", "episodes"),
        ("pipeline.grasp.episodes=many", "pipeline.grasp.episodes"),
        ("policy=demonstration", "demonstrations"),
        ("objects=folder", "objects.path"),
    ],
)
def test_a_wrong_word_stops_with_one_line_that_names_the_right_one(tmp_path, monkeypatch, capsys, word, expected):
    monkeypatch.chdir(tmp_path)
    words = ["run", word] if word.startswith("policy") else ["run", "policy=demonstrations", word]
    assert main(words) != 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("icub: error:")]
    assert expected in line


SMALL_TRAINING_IMAGE = ("+segmenter=falkon", "pipeline.teach.objects=[005_tomato_soup_can,010_potted_meat_can]",
                "pipeline.teach.frames=14", "pipeline.see.frames=6")  # fmt: skip


@pytest.fixture(scope="module")
def training_image(tmp_path_factory):
    folder = tmp_path_factory.mktemp("training image")
    done = icub("run", *SMALL_TRAINING_IMAGE, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_two_objects_are_taught_and_found_among_distractors(training_image):
    metrics = json.loads((the_only_run(training_image) / "metrics.json").read_text())
    assert metrics["teach.objects"] == 2
    assert 14 <= metrics["teach.frames"] <= 28
    assert metrics["segmentation.map50_segm"] > 0.3, "14 frames an object are few, but far better than chance"
    assert metrics["segmentation.train_seconds"] < metrics["learn.seconds"] + 0.1
    assert {"segmentation.map70_segm", "segmentation.map50_bbox", "segmentation.map70_bbox"} <= set(metrics)


def test_a_resumed_run_does_not_teach_again(training_image):
    run_dir = the_only_run(training_image)
    before = json.loads((run_dir / "metrics.json").read_text())
    done = icub("run", "--resume", str(run_dir), cwd=training_image)
    assert done.returncode == 0, done.stderr
    after = json.loads((run_dir / "metrics.json").read_text())
    assert after["teach.seconds"] == before["teach.seconds"]
    assert after["segmentation.map50_segm"] == before["segmentation.map50_segm"]


def test_ctrl_c_ends_cleanly_and_says_how_to_resume(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "icub_core.cli", "run", "policy=demonstrations"],
        cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=dict(os.environ),
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background shell ignores it
    )  # fmt: skip
    assert process.stderr is not None
    assert process.stderr.readline().startswith("run folder:")
    time.sleep(2)
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "icub run --resume" in rest
    assert "Traceback" not in rest
