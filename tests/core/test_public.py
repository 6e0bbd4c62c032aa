"""What a user imports: light, lazy, registered with Gymnasium in either order, and under its old names."""

import os
import subprocess
import sys
from importlib import import_module

import pytest

import icub_core as icub

HEAVY = ("numpy", "torch", "hydra", "omegaconf", "gymnasium", "mujoco", "pluggy")


def python(code: str, **environment: str) -> str:
    variables = {**os.environ, **environment}
    command = [sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, env=variables, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_package_imports_nothing_heavy():
    code = f"import icub_core, sys; dir(icub_core); print(sorted(set({HEAVY!r}) & set(sys.modules)))"
    assert python(code) == "[]\n"


@pytest.mark.parametrize("name", icub.__all__)
def test_every_public_name_is_there(name):
    assert getattr(icub, name) is not None
    assert name in dir(icub)


def test_a_name_that_is_not_public_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'icub_core' has no attribute 'makee_env'"):
        icub.makee_env  # noqa: B018


def test_plugins_and_composition_are_one_line(tmp_path):
    policy = icub.load("policy", "demonstrations", rate=50.0)
    assert policy._rate == 50.0
    segmenter = icub.load("segmenter", "falkon", overrides=["online_head.sigma=20"])
    assert isinstance(segmenter, icub.Segmenter)
    with pytest.raises(icub.ConfigError, match="has no parameter 'rte'. Did you mean 'rate'"):
        icub.load("policy", "demonstrations", rte=50.0)
    with pytest.raises(icub.ConfigError, match="no policy plugin named 'demonstration'. Did you mean"):
        icub.load("policy", "demonstration")


OLD = [
    ("icub_core.grasping.spaces", "icub_tasks.grasping.spaces", "hand_layout"),
    ("icub_core.grasping.evaluation", "icub_core.rollouts", "evaluate"),
    ("icub_core.grasping.governor", "icub_core.governor", "SafetyGovernor"),
    ("icub_core.evaluation.trial", "icub_benchmarks.segmentation.trial", "run_trial"),
    ("icub_core.pipeline.tabletop", "icub_pipelines.tabletop", "Tabletop"),
]


@pytest.mark.parametrize(("old", "new", "name"), OLD)
def test_an_old_module_name_gives_the_new_module_and_warns_once(old, new, name):
    code = f"""
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    import {old}
    from {old} import {name}
    import {old}
said = [str(w.message) for w in caught if "the old name goes" in str(w.message)]
import {new}
assert {name} is {new}.{name}
assert said.count("{old} is now {new}; the old name goes with the next release") == 1, said
assert len(set(said)) == len(said), said
print("well")
"""
    assert python(code) == "well\n"


def test_the_warning_points_at_the_line_that_imports(tmp_path):
    script = tmp_path / "old_user.py"
    script.write_text("x = 1\nfrom icub_core.evaluation.trial import run_trial\n")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"{script}:2: DeprecationWarning: icub_core.evaluation.trial is now" in done.stderr


def test_an_old_module_name_that_stays_is_silent():
    code = """
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from icub_core.testing.tiny.perception import TinySegmenter
    from icub_core.testing.contracts import SegmenterContract
from icub_testing.tiny import perception
assert TinySegmenter is perception.TinySegmenter
print([str(w.message) for w in caught if "icub_core" in str(w.message)])
"""
    assert python(code) == "[]\n"


def test_a_module_that_never_was_is_the_ordinary_error():
    for name in ("icub_core.nothing", "icub_core.grasping.nothing"):
        with pytest.raises(ModuleNotFoundError, match="nothing"):
            import_module(name)


EPISODE = """
env = gymnasium.make("icub/Grasp-v0", objects=["004_sugar_box"])
observation, info = env.reset(seed=3)
assert info["object"] == "004_sugar_box"
assert env.observation_space.contains(observation)
observation, reward, terminated, truncated, info = env.step(env.action_space.sample() * 0)
assert env.observation_space.contains(observation)
assert (terminated, truncated, info["reason"]) == (False, False, "running")
env.close()
print("well")
"""


@pytest.mark.parametrize(
    "order", [pytest.param("import gymnasium, icub_core", marks=pytest.mark.slow), "import icub_core, gymnasium"]
)
def test_gymnasium_makes_the_task_in_either_import_order(order):
    assert python(f"{order}\n{EPISODE}") == "well\n"


def test_gymnasium_s_registry_knows_the_task_without_building_anything():
    code = "import icub_core, gymnasium, sys; print('icub/Grasp-v0' in gymnasium.registry, 'torch' in sys.modules)"
    assert python(code) == "True False\n"


@pytest.mark.parametrize("order", ["gymnasium, icub_core", "icub_core, gymnasium"])
def test_registering_again_changes_nothing(order):
    code = f"import {order}\nfrom icub_core.gymnasium_ids import register\nregister(); register()\nprint('well')"
    assert python(code) == "well\n"


VECTOR = """
import gymnasium, icub_core, numpy
if __name__ == "__main__":
    envs = gymnasium.make_vec(
        "icub/Grasp-v0", num_envs=2, vectorization_mode="{mode}", objects=["004_sugar_box"], max_steps=3, **{options}
    )
    observation, info = envs.reset(seed=3)
    assert observation["hand_pose"].shape == (2, 6)
    for _ in range(3):
        observation, reward, terminated, truncated, info = envs.step(numpy.zeros(envs.action_space.shape, "float32"))
    assert truncated.tolist() == [True, True]
    assert reward.shape == (2,)
    envs.close()
    print("well")
"""


@pytest.mark.parametrize(
    ("mode", "options"),
    [
        pytest.param("sync", "{}", marks=pytest.mark.slow),
        pytest.param("async", '{"vector_kwargs": {"context": "spawn"}}', marks=pytest.mark.slow),
    ],
)
def test_gymnasium_makes_vectors_of_it_also_in_spawned_workers(tmp_path, mode, options):
    script = tmp_path / "vector.py"
    script.write_text(VECTOR.format(mode=mode, options=options))
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "well\n"


CHECKED = """
import gymnasium, icub_core
from gymnasium.utils.env_checker import check_env
env = gymnasium.make("icub/Grasp-v0", objects=["004_sugar_box"], render_mode="rgb_array")
check_env(env.unwrapped)
env.reset(seed=1)
image = env.render()
assert image.shape == (240, 320, 3) and image.dtype == "uint8" and image.std() > 5
env.close()
dark = gymnasium.make("icub/Grasp-v0", objects=["004_sugar_box"])
assert dark.unwrapped.render() is None
print("well")
"""


@pytest.mark.slow
def test_gymnasium_s_own_check_passes_and_the_robot_s_camera_is_shown():
    assert python(CHECKED).endswith("well\n")


def test_a_vector_of_worlds_is_a_task_of_many_worlds():
    env = icub.make_env("grasp", objects=["004_sugar_box"], num_envs=2)
    assert env.batch_size[0] == 2
    assert env.objects == ("004_sugar_box",)
    assert env.reset()["hand_pose"].shape == (2, 6)
    env.close()
    with pytest.raises(icub.ConfigError, match="004_sugar_box"):
        icub.make_env("grasp", objects=["004_sugar_bx"])


QUICK_START = """
import icub_core as icub
env = icub.make_env("grasp", objects=["004_sugar_box"], num_envs=4)
script = icub.load("policy", "demonstrations")
first = icub.evaluate(script, env, episodes=20).success_rate
policy = icub.load("policy", "resprect")
policy.learn(env, seconds=5)
second = icub.evaluate(policy, env, episodes=20).success_rate
assert first >= 0.8 and second >= 0.8, (first, second)

segmenter = icub.load("segmenter", "falkon")                          # with its default extractor and heads
for frame, instances in icub.load("dataset", "rendered_tabletop", frames=24):
    segmenter.observe(frame, instances)
segmenter.update()
assert segmenter.segment(frame)
print("well")
"""


@pytest.mark.slow
def test_the_quick_start_runs_as_it_stands():
    assert python(QUICK_START).endswith("well\n")
