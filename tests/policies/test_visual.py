"""Policies that see: the memory rebuilds what it was given, new inputs change nothing until they teach something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from icub_core.construct import build
from icub_core.errors import ConfigError
from icub_policies.gpayn import Gpayn
from icub_policies.inputs import STACK
from icub_policies.learner import seeing
from icub_policies.replay import CUT, RUNNING, TERMINAL, Replay
from icub_policies.resprect import Resprect
from icub_support.flare import flare
from icub_tasks.grasping.visual import ImageEncoder
from icub_testing.tiny.perception import TinyFeatureExtractor

F = 2


VISUAL = "visual"
WITHOUT_IMAGES = 29


class Brightness(TinyFeatureExtractor):
    """Two numbers an image."""

    region_dim = F

    def extract(self, rgb):
        self.rgb = rgb
        return super().extract(rgb)

    def region_features(self, features, boxes):
        return torch.tensor([[self.rgb[::2].mean(), self.rgb[1::2].mean()]], dtype=torch.float32) / 128


def observations(count: int, visual: int = F) -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    sizes = {"hand_pose": 6, "fingers": 9, "touch": 5, "object_center": 3, VISUAL: STACK * visual}
    entries = {n: torch.randn(count, s, generator=generator) for n, s in sizes.items() if s}
    return TensorDict(entries, [count])


@settings(max_examples=40, deadline=None)
@given(
    ends=st.lists(st.sampled_from([RUNNING, RUNNING, RUNNING, TERMINAL, CUT]), min_size=8, max_size=40),
    rows=st.integers(7, 50),
    seed=st.integers(0, 100),
)
def test_the_memory_keeps_one_image_a_step_and_gives_back_the_stack_of_three(ends, rows, seed):
    rng = torch.Generator().manual_seed(seed)
    replay = Replay(rows, 1, 1 + STACK * F, 1, visual=F)
    given_states, history = [], None
    for end in ends:
        image = torch.randn(F, generator=rng)
        history = torch.stack([image] * 3) if history is None else torch.cat([history[1:], image[None]])
        state = torch.cat([torch.randn(1, generator=rng), flare(history)])[None]
        given_states.append(state[0])
        replay.add(state, torch.zeros(1, 1), torch.zeros(1), torch.tensor([end], dtype=torch.uint8))
        history = None if end != RUNNING else history
    assert replay.state.shape[-1] == 1 + F
    batch = replay.sample(64, 2, 0.9, rng)
    for state, after, weight, discount in zip(batch.state, batch.next_state, batch.weight, batch.discount, strict=True):
        (time,) = [t for t, g in enumerate(given_states) if torch.allclose(g, state)]
        if weight and discount:
            assert any(torch.allclose(g, after) for g in given_states[time + 1 : time + 3])


def test_new_inputs_change_nothing_until_something_is_learned_from_them(make_env, base_file):
    shown = make_env(visual=True, feature_extractor=Brightness)
    seen = observations(16)
    for policy in (Gpayn(weights=str(base_file), hidden=16), Resprect(base=str(base_file))):
        before = policy.act(seen)
        sac, inputs = policy._ready() if isinstance(policy, Gpayn) else (policy.sac, policy.inputs)
        critics = sac.critics(inputs(seen), before)
        wider, with_images = seeing(sac, inputs, shown)
        if isinstance(policy, Gpayn):
            policy._learner = wider, with_images
        else:
            policy.sac, policy.inputs = wider, with_images
        assert wider.states == with_images.size == WITHOUT_IMAGES + STACK * F
        torch.testing.assert_close(policy.act(seen), before)
        torch.testing.assert_close(wider.critics(with_images(seen), before), critics)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gpayn", "resprect"])
def test_a_policy_learns_with_images_and_is_read_back(make_env, base_file, tmp_path, kind):
    env = make_env(visual=True, feature_extractor=Brightness)

    def make():
        if kind == "gpayn":
            return Gpayn(weights=str(base_file), hidden=16, env_steps=40, demonstrations=1, updates_per_step=1.0)
        return Resprect(base=str(base_file), env_steps=40, warm_up_steps=16, updates_per_step=1.0)

    policy = make()
    if kind == "gpayn":
        policy.settings = replace(policy.settings, imitation_updates=2, warm_up_updates=2, critic_updates=4)
    report = policy.learn(env, tmp_path, lambda share, text: None)
    assert report.env_steps >= 40
    seen = observations(4)
    policy.save(tmp_path / "kept.safetensors")
    again = make()
    again.load(tmp_path / "kept.safetensors")
    torch.testing.assert_close(again.act(seen), policy.act(seen))
    with pytest.raises(ConfigError, match="task.visual"):
        again.act(seen.exclude(VISUAL))
    with pytest.raises(ConfigError, match="task.visual"):
        again.learn(make_env(), tmp_path / "other", lambda share, text: None)


def test_any_feature_extractor_can_describe_the_image():
    encoder = ImageEncoder(build("feature_extractor", "compact"))
    rgb = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
    described = encoder.encode(rgb)
    assert described.shape == (encoder.size,)
    assert described.square().mean().item() == pytest.approx(1.0, abs=1e-3)
    torch.testing.assert_close(encoder.encode(rgb), described)
