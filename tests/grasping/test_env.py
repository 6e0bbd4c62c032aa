"""The environment: specs, starts, steps, ends, and that everything can be repeated and taken back."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.gym_adapter import GymGraspEnv
from torchrl.envs.utils import check_env_specs

from icub_core.errors import ConfigError, SimulationError
from icub_core.interfaces.policy import Policy
from icub_core.interfaces.simulator import Fault
from icub_core.rollouts import evaluate
from icub_policies.demonstrations import Demonstrations
from icub_tasks.grasping.spaces import ACTION_SIZE, OBSERVATION_SIZES
from icub_tasks.grasping.task import GraspTask
from icub_tasks.grasping.termination import EndReason
from icub_tasks.grasping.visual import VisualEncoder, flare


class Still(Policy):
    def act(self, observation):
        return torch.zeros(len(observation["hand_pose"]), ACTION_SIZE)


@pytest.fixture(scope="module")
def env(tasks) -> GraspEnv:
    return GraspEnv(tasks, pool_size=2)


def test_it_keeps_torchrl_s_contract(env):
    check_env_specs(env)


def test_it_keeps_gymnasium_s_contract(tasks):
    gym_env = GymGraspEnv(tasks[0])
    check_env(gym_env, skip_render_check=True)
    assert isinstance(gym_env.action_space, gymnasium.spaces.Box)
    assert gym_env.render().shape == (240, 320, 3)


def test_a_scripted_grasp_planned_from_the_camera_lifts_the_object(tasks):
    results = evaluate(Demonstrations(), GraspEnv(tasks), episodes=2, seed=3)
    assert results.success_rate > 0
    won = int(np.argmax(results.success))
    assert results.returns[won] > 200  # 100 mm times at least two fingers
    assert 150 < results.steps[won] < 250


def test_the_hand_stands_before_the_object_at_the_start(env):
    start = env.reset()
    away = (start["hand_pose"][:, :3] - start["object_center"]).norm(dim=1)
    planned = start["plan"][:, :3]
    assert ((start["hand_pose"][:, :3] - planned).norm(dim=1) < 0.005).all()
    assert (away < 0.25).all()
    assert not start["touch"].any()
    assert {name: start[name].shape[1] for name in OBSERVATION_SIZES} == OBSERVATION_SIZES


def test_translation_and_rotation_actions_do_what_they_say(env):
    before = env.reset()
    action = torch.zeros(2, ACTION_SIZE)
    action[:, 2] = 1.0
    action[:, 3] = 0.5  # yaw
    now = before.clone()
    for _ in range(10):
        now["action"] = action
        now = env.advance(now)
    moved = now["hand_pose"] - before["hand_pose"]
    assert moved[:, 2].numpy() == pytest.approx(0.02, abs=5e-3)  # 10 steps of 2 mm, minus the servo's lag
    assert moved[:, 3].numpy() == pytest.approx(0.05, abs=2e-2)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_action_that_is_not_finite_ends_the_episode_as_a_fault_and_the_robot_stays(env, bad):
    before = env.reset()
    action = torch.zeros(2, ACTION_SIZE)
    action[0, 4] = bad
    before["action"] = action
    after = env.advance(before)
    assert after["fault"][:, 0].tolist() == [True, False]
    assert after["truncated"][:, 0].tolist() == [True, False]
    assert after["terminated"].sum() == 0
    assert after["reason"][0] == EndReason.ACTION_NOT_FINITE
    assert after["reward"][0] == 0
    assert (after["hand_pose"][0, :3] - before["hand_pose"][0, :3]).norm() < 1e-3


@pytest.mark.parametrize("fault", list(Fault))
def test_every_simulator_fault_becomes_a_typed_truncation_and_is_counted(make_tasks, monkeypatch, fault):
    (task,) = make_tasks()
    env = GraspEnv([task])
    now = env.reset()
    monkeypatch.setattr(task.simulator, "faults", lambda: (fault,))
    now["action"] = torch.zeros(1, ACTION_SIZE)
    after = env.advance(now)
    assert after["fault"].item()
    assert after["truncated"].item()
    assert EndReason(after["reason"].item()).name == fault.name
    assert env.batch.fault_filter.report() == {fault.name.lower(): 1}


def test_the_commanded_hand_waits_at_the_edge_of_its_reach(make_tasks):
    env = GraspEnv(make_tasks())
    now = env.reset()
    for _ in range(240):
        now["action"] = torch.tensor([[1.0, 1, 1] + [0.0] * 12])
        now = env.advance(now)
        assert now["reason"].item() != EndReason.IK_FAILURE
        if now["done"].item():
            break
    lead = env.batch.state()["target"][0, :3] - now["hand_pose"][0, :3].numpy()
    assert np.linalg.norm(lead) < 0.03


def test_inverse_kinematics_that_fails_is_a_fault(make_tasks, monkeypatch):
    env = GraspEnv(make_tasks())
    now = env.reset()
    monkeypatch.setattr(env.batch._tracker, "follow", lambda q, targets: np.array([[0.04, 0.0]]))
    now["action"] = torch.zeros(1, ACTION_SIZE)
    after = env.advance(now)
    assert after["reason"].item() == EndReason.IK_FAILURE
    assert after["fault"].item()
    assert after["reward"].item() == 0


def test_one_seed_gives_one_episode(make_tasks):
    def run() -> list[torch.Tensor]:
        env = GraspEnv(make_tasks(), seed=5)
        now, teacher, seen = env.reset(), Demonstrations(), []
        for _ in range(30):
            now["action"] = teacher.act(now)
            now = env.advance(now)
            seen.append(torch.cat([now["hand_pose"], now["fingers"], now["reward"]], dim=1))
        return seen

    assert all(torch.equal(a, b) for a, b in zip(run(), run(), strict=True))


def test_worlds_do_not_depend_on_how_many_threads_step_them(tasks):
    def run(threads: int) -> torch.Tensor:
        env = GraspEnv(tasks, threads=threads, seed=1)
        now = env.reset()
        for _ in range(10):
            now["action"] = torch.full((2, ACTION_SIZE), 0.3)
            now = env.advance(now)
        return torch.cat([now["hand_pose"], now["fingers"]], dim=1)

    assert torch.equal(run(1), run(2))


def test_a_saved_environment_goes_on_as_if_nothing_had_happened(tasks):
    env = GraspEnv(tasks, pool_size=2, seed=2)
    now, teacher = env.reset(), Demonstrations()
    for _ in range(20):
        now["action"] = teacher.act(now)
        now = env.advance(now)
    arrays, texts = env.save()

    def go_on(now) -> torch.Tensor:
        rows = []
        for _ in range(15):
            now["action"] = teacher.act(now)
            now = env.advance(now)
            rows.append(torch.cat([now["hand_pose"], now["fingers"], now["reward"]], dim=1))
        rows.append(env.reset()["hand_pose"].repeat(1, 3)[:, :16])
        return torch.stack(rows)

    first = go_on(now)
    other = GraspEnv(tasks, pool_size=2, seed=77)
    other.restore(arrays, texts)
    env = other
    assert torch.equal(first, go_on(other.observe()))


def test_the_time_limit_is_a_truncation_and_costs_one(make_tasks):
    from icub_tasks.grasping.task import TaskSettings

    results = evaluate(Still(), GraspEnv(make_tasks(settings=TaskSettings(max_steps=5))), episodes=1)
    assert results.ends() == {"time_limit": 1}
    assert results.steps[0] == 5
    assert results.returns[0] == pytest.approx(-1, abs=0.1)


class Stripes(VisualEncoder):
    @property
    def size(self) -> int:
        return 2

    def encode(self, rgb):
        return torch.tensor([rgb[::2].mean(), rgb[1::2].mean()], dtype=torch.float32)


def test_the_visual_part_stacks_three_pictures(make_tasks):
    env = GraspEnv(make_tasks(), encoder=Stripes())
    now = env.reset()
    f = now["visual"][0, :2]
    torch.testing.assert_close(now["visual"][0], torch.cat([f, 0 * f, f, 0 * f, f]))
    now["action"] = torch.ones(1, ACTION_SIZE)
    after = env.advance(now)["visual"][0]
    torch.testing.assert_close(after[:6], torch.cat([f, 0 * f, f]))
    torch.testing.assert_close(after[6:8], f - after[8:10])


def test_flare_orders_and_signs():
    features = torch.tensor([[1.0], [3.0], [7.0]])
    assert flare(features).tolist() == [1.0, -2.0, 3.0, -4.0, 7.0]


def test_unknown_objects_and_cameras_are_named(make_tasks):
    (task,) = make_tasks()
    with pytest.raises(ConfigError, match="Did you mean '010_potted_meat_can'"):
        GraspTask(task.simulator, task.robot, task.generator, ["potted_meat_can"])


def test_an_object_without_any_plan_is_one_clear_error(make_tasks):
    (task,) = make_tasks(masks=lambda frame, name: None)
    with pytest.raises(SimulationError, match="camera does not see the object"):
        task.prepare()


def test_a_world_that_is_not_active_stays_and_leaves_the_others_alone(env):
    env.reset()
    arrays, texts = env.save()
    time = env.batch.tasks[0].simulator.time
    actions = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (12, 2, ACTION_SIZE)).astype(np.float32))
    ends = []
    for active in ([True, True], [False, True]):
        env.restore(arrays, texts)
        now = env.observe()
        for action in actions:
            now["action"] = action
            now = env.advance(now, active)
        ends.append(now)
    assert env.batch.tasks[0].simulator.time == time
    for name in ("hand_pose", "fingers", "reward"):
        torch.testing.assert_close(ends[0][name][1], ends[1][name][1], rtol=0, atol=1e-6)
