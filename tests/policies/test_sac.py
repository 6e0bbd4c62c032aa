"""The learner: its losses are TorchRL's, its residual form is the thesis's, its state can be taken back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss

from icub_policies.networks import Critics
from icub_policies.replay import Batch
from icub_policies.sac import Sac, SacSettings

STATES, ACTIONS, SIZE = 6, 3, 32
SETTINGS = SacSettings(hidden=16, batch=SIZE, reward_scale=1.0, target_entropy=-2.0, alpha=0.3, steps=1)


def batch(seed: int = 0, base: bool = False) -> Batch:
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    width = ACTIONS if base else 0
    return Batch(
        state=draw(SIZE, STATES),
        action=draw(SIZE, ACTIONS).tanh(),
        base=draw(SIZE, width).tanh(),
        reward=draw(SIZE),
        next_state=draw(SIZE, STATES),
        next_base=draw(SIZE, width).tanh(),
        discount=torch.full((SIZE,), 0.9) * (draw(SIZE) > -1),
        weight=torch.ones(SIZE),
    )


class OneCritic(nn.Module):
    """Member `index` of an ensemble as a network of its own, the way TorchRL wants them."""

    def __init__(self, critics: Critics, index: int) -> None:
        super().__init__()
        hidden = SETTINGS.hidden
        self.own = Critics(STATES, ACTIONS, hidden, count=1)
        columns = slice(index * hidden, (index + 1) * hidden)
        with torch.no_grad():
            self.own.weight1.copy_(critics.weight1[:, columns])
            self.own.bias1.copy_(critics.bias1[columns])
            for name in ("weight2", "bias2", "weight3", "bias3"):
                getattr(self.own, name).copy_(getattr(critics, name)[index : index + 1])

    def forward(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return self.own(state, action)[0][:, None]


def torchrl_losses(sac: Sac, data: Batch, seed: int, monkeypatch) -> tuple[TensorDict, list[torch.Tensor]]:
    """Return TorchRL's losses on the same networks, and the noise that it drew, in order."""
    actor = ProbabilisticActor(
        TensorDictModule(sac.actor, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    values = [
        ValueOperator(OneCritic(sac.critics, i), in_keys=["observation", "action"]) for i in range(SETTINGS.critics)
    ]
    loss = SACLoss(
        actor, values, num_qvalue_nets=SETTINGS.critics, loss_function="l2", alpha_init=sac.settings.alpha,
        target_entropy=sac.settings.target_entropy, delay_qvalue=False, deactivate_vmap=True,
    )  # fmt: skip
    loss.make_value_estimator(loss.default_value_estimator, gamma=0.9)
    terminated = (data.discount == 0)[:, None]
    td = TensorDict(
        {
            "observation": data.state,
            "action": data.action,
            "next": TensorDict(
                {
                    "observation": data.next_state,
                    "reward": data.reward[:, None],
                    "done": terminated,
                    "terminated": terminated,
                },
                [SIZE],
            ),
        },
        [SIZE],
    )
    drawn: list[torch.Tensor] = []

    def recorded(shape, dtype, device) -> torch.Tensor:
        drawn.append(torch.randn(shape, dtype=dtype, device=device))
        return drawn[-1]

    monkeypatch.setattr("torch.distributions.normal._standard_normal", recorded)
    torch.manual_seed(seed)
    return loss(td), drawn


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_losses_equal_torchrl_s_sac(seed, monkeypatch):
    sac, data = Sac(STATES, ACTIONS, SETTINGS, seed=seed), batch(seed)
    reference, noise = torchrl_losses(sac, data, seed, monkeypatch)
    next_noise, actor_noise = noise
    torch.testing.assert_close(sac.critic_loss(data, next_noise), reference["loss_qvalue"], rtol=1e-4, atol=1e-5)
    actor_loss, log_prob = sac.actor_loss(data, actor_noise)
    torch.testing.assert_close(actor_loss, reference["loss_actor"], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(sac.alpha_loss(log_prob), reference["loss_alpha"], rtol=1e-4, atol=1e-5)


def test_critics_of_a_residual_judge_the_clipped_sum_and_the_actor_sees_the_base_action():
    sac, data = Sac(STATES, ACTIONS, SETTINGS, residual=True), batch(base=True)
    seen = []
    sac.critics.register_forward_hook(lambda module, inputs, output: seen.append(inputs))
    sac.targets.register_forward_hook(lambda module, inputs, output: seen.append(inputs))
    sac.critic_loss(data, torch.zeros(SIZE, ACTIONS))
    (target_state, target_action), (state, action) = seen
    torch.testing.assert_close(state, data.state)
    torch.testing.assert_close(action, (data.base + data.action).clamp(-1, 1))
    torch.testing.assert_close(target_state, data.next_state)
    torch.testing.assert_close(target_action, data.next_base)  # the residual's mean starts at 0
    assert sac.actor.layer1.in_features == STATES + ACTIONS


def test_a_batch_without_weight_teaches_nothing():
    sac, data = Sac(STATES, ACTIONS, SETTINGS), batch()
    assert sac.critic_loss(replace(data, weight=torch.zeros(SIZE)), torch.zeros(SIZE, ACTIONS)) == 0


def test_it_learns_the_best_action_of_a_bandit():
    sac = Sac(1, 1, SacSettings(hidden=32, reward_scale=1.0, target_entropy=-4.0, alpha=0.01, actor_every=1))
    generator = torch.Generator().manual_seed(0)
    for _ in range(600):
        action = torch.rand(128, 1, generator=generator) * 2 - 1
        reward = -(action[:, 0] - 0.5).square()
        state, none = torch.ones(128, 1), torch.zeros(128, 0)
        sac.update(Batch(state, action, none, reward, state, none, torch.zeros(128), torch.ones(128)))
    assert sac.actor.best(torch.ones(1, 1)).item() == pytest.approx(0.5, abs=0.1)


def test_updates_go_on_identically_from_a_saved_state():
    sac = Sac(STATES, ACTIONS, SETTINGS)
    for seed in range(4):
        sac.update(batch(seed))
    kept = {name: value.clone() for name, value in sac.state_dict().items()}
    other = Sac(STATES, ACTIONS, SETTINGS, seed=9)
    other.load_state_dict(kept, Path("memory"))
    for learner in (sac, other):
        for seed in range(4, 8):
            learner.update(batch(seed))
    for name, value in sac.state_dict().items():
        assert torch.equal(value, other.state_dict()[name]), name
