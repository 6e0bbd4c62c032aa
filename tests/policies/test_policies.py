"""What each policy promises: bounds, the zero residual, files, resuming."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from icub_core.errors import CheckpointError, ConfigError, WeightsError
from icub_policies import checkpoint
from icub_policies.demonstrations import Demonstrations
from icub_policies.gpayn import Gpayn
from icub_policies.inputs import VERSION_0_1, Inputs
from icub_policies.resprect import Resprect
from icub_support import weights
from icub_testing.tiny.task import TinyTask

SIZES = {
    "hand_pose": 6, "fingers": 9, "touch": 5, "object_center": 3,
    "plan_start": 3, "plan_grasp": 3, "plan_opened": 9, "plan_closed": 9, "step": 1,
}  # fmt: skip


def observations(count: int, seed: int, size: float = 1.0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    entries = {name: size * torch.randn(count, width, generator=generator) for name, width in SIZES.items()}
    return TensorDict(entries, [count])


def bound(policy, task):
    policy.bind(task)
    return policy


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 100))
def test_actions_are_finite_and_within_bounds_for_any_observation(like_the_icub, seed, size):
    seen = observations(8, seed, size)
    for policy in (bound(Gpayn(hidden=16), like_the_icub), bound(Demonstrations(), like_the_icub)):
        before = seen.clone()
        action = policy.act(seen)
        assert action.shape == (8, 15)
        assert action.dtype == torch.float32
        assert torch.isfinite(action).all()
        assert action.abs().max() <= 1
        assert (seen == before).all()


def test_zero_residual_is_exactly_the_base_policy(base_file):
    base, residual = Gpayn(weights=str(base_file), hidden=16), Resprect(base=str(base_file))
    seen = observations(64, 1)
    assert torch.equal(residual.act(seen), base.act(seen))


def test_a_residual_starts_from_the_base_policy_s_critics(base_file):
    base, residual = Gpayn(weights=str(base_file), hidden=16), Resprect(base=str(base_file))
    for name, value in base.sac.critics.state_dict().items():
        assert torch.equal(residual.sac.critics.state_dict()[name], value)
        assert torch.equal(residual.sac.targets.state_dict()[name], base.sac.targets.state_dict()[name])
    assert residual.sac.log_alpha.exp().item() == pytest.approx(0.01 * residual.sac.settings.reward_scale)


def test_a_frozen_base_has_no_gradient(base_file):
    residual = Resprect(base=str(base_file))
    assert not any(p.requires_grad for p in residual.base.parameters())


def test_inputs_do_not_jump_where_angles_do():
    near, far = observations(1, 0), observations(1, 0)
    near["hand_pose"][0, 3], far["hand_pose"][0, 3] = 1e-4, 2 * torch.pi - 1e-4
    inputs = VERSION_0_1
    assert inputs(near).shape == (1, inputs.size) == (1, 29)
    torch.testing.assert_close(inputs(near), inputs(far), atol=1e-2, rtol=0)


@pytest.mark.parametrize("kind", ["gpayn", "resprect"])
def test_what_is_saved_is_restored_exactly(kind, base_file, like_the_icub, tmp_path):
    def build(seed: int):
        return (
            bound(Gpayn(hidden=16, seed=seed), like_the_icub)
            if kind == "gpayn"
            else Resprect(base=str(base_file), seed=seed)
        )

    first, second = build(1), build(2)
    with torch.no_grad():
        for parameter in first.sac.actor.parameters():
            parameter.add_(0.1)
    first.save(tmp_path / "w.safetensors")
    second.load(tmp_path / "w.safetensors")
    seen = observations(16, 3)
    assert torch.equal(first.act(seen), second.act(seen))


def test_weights_of_another_size_are_refused_and_named(base_file):
    with pytest.raises(WeightsError, match=r"actor in .*layer1.weight.*\(16, 29\), expected \(32, 29\)"):
        Gpayn(weights=str(base_file), hidden=32)


def test_unknown_weights_name_what_is_shipped():
    with pytest.raises(ConfigError, match="base_gpayn"):
        Resprect(base="no_such_file")


def test_a_truncated_file_is_one_clear_error(base_file):
    base_file.write_bytes(base_file.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="truncated or not a safetensors file"):
        Resprect(base=str(base_file))


def test_a_full_disk_leaves_the_earlier_file(base_file, like_the_icub, monkeypatch):
    before = base_file.read_bytes()

    def full(tensors, path, metadata):
        Path(path).write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(weights, "save_file", full)
    with pytest.raises(CheckpointError, match="No space left on device"):
        bound(Gpayn(hidden=16), like_the_icub).save(base_file)
    assert base_file.read_bytes() == before
    assert list(base_file.parent.iterdir()) == [base_file]


def nothing(share: float, text: str) -> None:
    pass


def test_an_interrupted_training_goes_on_bit_for_bit(make_env, tmp_path, monkeypatch):
    monkeypatch.setattr("icub_policies.gpayn.IMITATION_UPDATES", 5)
    monkeypatch.setattr("icub_policies.gpayn.WARM_UP_UPDATES", 5)
    monkeypatch.setattr("icub_policies.gpayn.CRITIC_UPDATES", 2)

    def build() -> Gpayn:
        policy = Gpayn(seconds=None, env_steps=40, demonstrations=2, updates_per_step=1.0, hidden=16)
        policy.settings = replace(policy.settings, evaluate_every=1000, evaluation_episodes=1)
        return policy

    straight = build()
    straight.learn(make_env(), tmp_path / "straight", nothing)

    class Stop:
        def __init__(self) -> None:
            self.calls = 0

        def __call__(self, share: float, text: str) -> None:
            if share > 0.5 and "updates" in text:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build().learn(make_env(), tmp_path / "halves", Stop())
    resumed = build()
    report = resumed.learn(make_env(), tmp_path / "halves", nothing)
    assert report.env_steps == 40
    last, again = (
        checkpoint.read_tensors(tmp_path / folder / "training.safetensors")[0] for folder in ("straight", "halves")
    )
    assert last.keys() == again.keys()
    assert [name for name, value in last.items() if not torch.equal(value, again[name])] == []


def test_resprect_learns_in_real_worlds(make_env, base_file, tmp_path):
    policy = Resprect(base=str(base_file), seconds=None, env_steps=60, updates_per_step=0.5, warm_up_steps=15)
    policy.settings = replace(policy.settings, evaluate_every=30, evaluation_episodes=1)
    report = policy.learn(make_env(), tmp_path, nothing)
    assert report.env_steps == 60
    assert report.updates > 0
    assert report.metrics["best_success"] >= report.metrics["first_success"]


@pytest.mark.parametrize("size", [(4, 3), (2, 2)])
def test_weights_are_of_one_hand_and_another_hand_is_refused_in_one_line(base_file, size):
    fingers, fingertips = size
    for policy in (Gpayn(weights=str(base_file), hidden=16), Resprect(base=str(base_file))):
        with pytest.raises(ConfigError) as refusal:
            policy.bind(TinyTask(fingers=fingers, fingertips=fingertips))
        assert f"9 actuators and 5 fingertips (15 actions); the task's has {fingers} and {fingertips}" in str(
            refusal.value
        )
        assert "\n" not in str(refusal.value)


def test_a_policy_without_weights_takes_its_sizes_from_any_hand():
    task = TinyTask(fingers=4, fingertips=3)
    policy = Gpayn(hidden=16)
    with pytest.raises(ConfigError, match="neither weights nor a task"):
        policy.act(task.reset())
    policy.bind(task)
    assert policy.act(task.reset()).shape == (2, 10)
    assert policy.sac.states == Inputs.of(task).size == 15 + 4 + 3


def test_a_script_needs_a_plan_and_steps_that_an_action_can_make(like_the_icub):
    class WithoutAPlan(TinyTask):
        def __init__(self):
            super().__init__()
            del self.observation_spec["plan_grasp"]

    with pytest.raises(ConfigError, match="the task does not observe 'plan_grasp'"):
        Demonstrations().bind(WithoutAPlan())
    with pytest.raises(ConfigError, match=r"approach_step=0\.03 is more than .*; expected at most 0\.02 m"):
        Demonstrations(approach_step=0.03).bind(like_the_icub)
    with pytest.raises(ConfigError, match="must be bound to a task"):
        Demonstrations().act(like_the_icub.reset())
