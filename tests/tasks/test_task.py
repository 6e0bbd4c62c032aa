"""The grasping task: specs, starts, steps, ends, and that everything can be repeated and taken back."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchrl.envs.utils import check_env_specs

from icub_core.errors import CheckpointError, ConfigError, SimulationError
from icub_core.interfaces.policy import Policy
from icub_core.interfaces.world import Fault
from icub_core.rollouts import evaluate
from icub_policies.demonstrations import Demonstrations
from icub_support.flare import flare
from icub_support.gym_adapter import GymTask
from icub_tasks.grasping.termination import EndReason
from icub_tasks.grasping.world import GraspWorld
from icub_testing.tiny.perception import TinyFeatureExtractor

ACTIONS = 15
SIZES = {
    "hand_pose": 6, "fingers": 9, "touch": 5, "object_center": 3,
    "plan_start": 3, "plan_grasp": 3, "plan_opened": 9, "plan_closed": 9, "step": 1,
}  # fmt: skip


class Still(Policy):
    def act(self, observation):
        return torch.zeros(len(observation["hand_pose"]), ACTIONS)


def teacher_of(task) -> Demonstrations:
    teacher = Demonstrations()
    teacher.bind(task)
    return teacher


def test_it_keeps_torchrl_s_contract(env):
    check_env_specs(env)


def test_it_keeps_gymnasium_s_contract(make_task):
    gym_env = GymTask(make_task(), render_mode="rgb_array")
    check_env(gym_env, skip_render_check=True)
    assert isinstance(gym_env.action_space, gymnasium.spaces.Box)
    assert gym_env.render().shape == (240, 320, 3)


def test_a_scripted_grasp_planned_from_the_camera_lifts_the_object(env):
    results = evaluate(Demonstrations(), env, episodes=2, seed=3)
    assert results.success_rate > 0
    won = int(np.argmax(results.success))
    assert results.returns[won] > 200  # 100 mm times at least two fingers
    assert 150 < results.steps[won] < 250


def test_the_hand_stands_before_the_object_at_the_start(env):
    start = env.reset()
    away = (start["hand_pose"][:, :3] - start["object_center"]).norm(dim=1)
    planned = start["plan_start"]
    assert ((start["hand_pose"][:, :3] - planned).norm(dim=1) < 0.005).all()
    assert (away < 0.25).all()
    assert not start["touch"].any()
    assert {name: start[name].shape[1] for name in SIZES} == SIZES


def test_translation_and_rotation_actions_do_what_they_say(env):
    before = env.reset()
    action = torch.zeros(2, ACTIONS)
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
    action = torch.zeros(2, ACTIONS)
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
def test_every_simulator_fault_becomes_a_typed_truncation_and_is_counted(make_task, monkeypatch, fault):
    env = make_task()
    now = env.reset()
    monkeypatch.setattr(env.worlds[0].simulator, "faults", lambda: (fault,))
    now["action"] = torch.zeros(1, ACTIONS)
    after = env.advance(now)
    assert after["fault"].item()
    assert after["truncated"].item()
    assert EndReason(after["reason"].item()).name == fault.name
    assert env.fault_counts() == {fault.name.lower(): 1}


def test_the_commanded_hand_waits_at_the_edge_of_its_reach(make_task):
    env = make_task()
    now = env.reset()
    for _ in range(240):
        now["action"] = torch.tensor([[1.0, 1, 1] + [0.0] * 12])
        now = env.advance(now)
        assert now["reason"].item() != EndReason.IK_FAILURE
        if now["done"].item():
            break
    lead = env.batch.state_dict()["target"][0, :3] - now["hand_pose"][0, :3].numpy()
    assert np.linalg.norm(lead) < 0.03


def test_inverse_kinematics_that_fails_is_a_fault(make_task, monkeypatch):
    env = make_task()
    now = env.reset()
    monkeypatch.setattr(env.batch._tracker, "follow", lambda q, targets: np.array([[0.04, 0.0]]))
    now["action"] = torch.zeros(1, ACTIONS)
    after = env.advance(now)
    assert after["reason"].item() == EndReason.IK_FAILURE
    assert after["fault"].item()
    assert after["reward"].item() == 0


def test_one_seed_gives_one_episode(make_task):
    def run() -> list[torch.Tensor]:
        env = make_task(seed=5)
        now, teacher, seen = env.reset(), teacher_of(env), []
        for _ in range(30):
            now["action"] = teacher.act(now)
            now = env.advance(now)
            seen.append(torch.cat([now["hand_pose"], now["fingers"], now["reward"]], dim=1))
        return seen

    assert all(torch.equal(a, b) for a, b in zip(run(), run(), strict=True))


def test_worlds_do_not_depend_on_how_many_threads_step_them(make_task):
    def run(threads: int) -> torch.Tensor:
        env = make_task(num_envs=2, threads=threads, seed=1)
        now = env.reset()
        for _ in range(10):
            now["action"] = torch.full((2, ACTIONS), 0.3)
            now = env.advance(now)
        return torch.cat([now["hand_pose"], now["fingers"]], dim=1)

    assert torch.equal(run(1), run(2))


def test_a_saved_task_goes_on_as_if_nothing_had_happened(make_task):
    env = make_task(num_envs=2, starts=2, seed=2)
    now, teacher = env.reset(), teacher_of(env)
    for _ in range(20):
        now["action"] = teacher.act(now)
        now = env.advance(now)
    state = env.state_dict()

    def go_on(now) -> torch.Tensor:
        rows = []
        for _ in range(15):
            now["action"] = teacher.act(now)
            now = env.advance(now)
            rows.append(torch.cat([now["hand_pose"], now["fingers"], now["reward"]], dim=1))
        rows.append(env.reset()["hand_pose"].repeat(1, 3)[:, :16])
        return torch.stack(rows)

    first = go_on(now)
    other = make_task(num_envs=2, starts=2, seed=77)
    other.load_state_dict(state)
    env = other
    assert torch.equal(first, go_on(other.observe()))


def test_the_time_limit_is_a_truncation_and_costs_one(make_task):
    results = evaluate(Still(), make_task(max_steps=5), episodes=1)
    assert results.ends() == {"time_limit": 1}
    assert results.steps[0] == 5
    assert results.returns[0] == pytest.approx(-1, abs=0.1)


class Stripes(TinyFeatureExtractor):
    """Describes an image by the brightness of its even and of its odd rows."""

    region_dim = 2

    def extract(self, rgb):
        self.rgb = rgb
        return super().extract(rgb)

    def region_features(self, features, boxes):
        return torch.tensor([[self.rgb[::2].mean(), 2 * self.rgb[1::2, ::3].mean()]], dtype=torch.float32)


def test_the_visual_part_stacks_three_images(make_task):
    env = make_task(visual=True, feature_extractor=Stripes)
    now = env.reset()
    f = now["visual"][0, :2]
    torch.testing.assert_close(now["visual"][0], torch.cat([f, 0 * f, f, 0 * f, f]))
    now["action"] = torch.ones(1, ACTIONS)
    after = env.advance(now)["visual"][0]
    torch.testing.assert_close(after[:6], torch.cat([f, 0 * f, f]))
    torch.testing.assert_close(after[6:8], f - after[8:10])


def test_flare_orders_and_signs():
    features = torch.tensor([[1.0], [3.0], [7.0]])
    assert flare(features).tolist() == [1.0, -2.0, 3.0, -4.0, 7.0]


def test_unknown_objects_and_cameras_are_named(make_task):
    (world,) = make_task().worlds
    with pytest.raises(ConfigError, match="Did you mean '010_potted_meat_can'"):
        GraspWorld(world.simulator, world.robot, world.generator, ["potted_meat_can"])
    with pytest.raises(ConfigError, match="Did you mean '010_potted_meat_can'"):
        make_task("potted_meat_can")
    with pytest.raises(ConfigError, match="no camera of robot 'icub' named"):
        make_task(camera="head_camra")


def test_an_object_without_any_plan_is_one_clear_error(make_task):
    env = make_task(masks=lambda frame, name: None)
    with pytest.raises(SimulationError, match="camera does not see the object"):
        env.draw(0)


def test_a_world_that_is_not_active_stays_and_leaves_the_others_alone(env):
    env.reset()
    state = env.state_dict()
    time = env.worlds[0].simulator.time
    actions = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (12, 2, ACTIONS)).astype(np.float32))
    ends = []
    for active in ([True, True], [False, True]):
        env.load_state_dict(state)
        now = env.observe()
        for action in actions:
            now["action"] = action
            now = env.advance(now, active)
        ends.append(now)
    assert env.worlds[0].simulator.time == time
    for name in ("hand_pose", "fingers", "reward"):
        torch.testing.assert_close(ends[0][name][1], ends[1][name][1], rtol=0, atol=1e-6)


def test_an_object_that_was_moved_away_ends_the_episode_for_good_and_costs_one(make_task):
    """It is a termination: what comes after is worth nothing, unlike after a time limit."""
    env = make_task()
    now = env.reset()
    (world,) = env.worlds
    pose = world.simulator.object_pose("010_potted_meat_can")
    pose[1, 3] += 0.15
    world.simulator.set_object_pose("010_potted_meat_can", pose)
    now["action"] = torch.zeros(1, ACTIONS)
    after = env.advance(now)
    assert EndReason(after["reason"].item()) == EndReason.MOVED
    assert after["terminated"].item()
    assert after["done"].item()
    assert not after["truncated"].item()
    assert not after["success"].item()
    assert not after["fault"].item()
    assert after["reward"].item() == pytest.approx(-1, abs=0.1)


def test_the_state_of_another_task_is_refused_and_changes_nothing(make_task):
    one, two = make_task(), make_task(num_envs=2)
    one.reset()
    before = one.state_dict()
    with pytest.raises(CheckpointError, match="of 2 worlds without images; this one has 1 without"):
        one.load_state_dict(two.state_dict())
    shorter = {**before, "batch.simulation.0": before["batch.simulation.0"][:-1], "batch.q": before["batch.q"] + 1}
    with pytest.raises(CheckpointError, match=r"the state is of another grasping task: 'simulation\.0' has shape \("):
        one.load_state_dict(shorter)
    after = one.state_dict()
    assert [name for name, value in before.items() if not torch.equal(value, after[name])] == []


def test_a_task_that_has_not_begun_has_a_state_too(make_task):
    one, two = make_task(seed=4), make_task(seed=5)
    state = one.state_dict()
    first = one.reset()
    two.reset()
    two.load_state_dict(state)
    assert torch.equal(two.reset()["hand_pose"], first["hand_pose"])


@pytest.mark.parametrize("signals", ["object", "hand"])
def test_the_card_says_where_reward_and_end_come_from(make_task, signals):
    card = make_task(signals=signals).card()
    assert card["signals"] == signals
    assert (card["task"], card["robot"], card["hand"], card["observation"]) == ("grasp", "icub", "right", "state")


def test_a_hand_that_feels_and_rises_is_enough_to_know_a_grasp(make_task):
    """A robot has no object sensor: height of its hand and two fingers say the same as the object's position."""
    results = {}
    for signals in ("object", "hand"):
        results[signals] = evaluate(Demonstrations(), make_task(signals=signals), episodes=3, seed=3)
    assert results["object"].success.tolist() == results["hand"].success.tolist()
    assert results["hand"].success.any()


def test_worlds_with_one_object_each_pass_over_what_is_seldom_planned(make_task):
    env = make_task(num_envs=1, one_object_each=True)
    assert env.worlds[0].objects == ("010_potted_meat_can",)
    assert len(env.pools[0].starts) >= 3
    with pytest.raises(ConfigError, match="0 of 1 objects are planned often enough; expected 1"):
        make_task(num_envs=1, one_object_each=True, masks=lambda frame, name: None)
