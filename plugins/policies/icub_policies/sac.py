"""Soft actor-critic, written for small networks on a CPU; its losses equal TorchRL's `SACLoss` (a test compares them).

Differences from the thesis's SAC (Stable-Baselines3), each because short wall-clock budgets need it:
layer-normalized critics, returns over n steps, demonstrations kept for ever at a fixed share of every batch, rewards
scaled so that values stay near 10, a lower target entropy. Sources: Haarnoja et al. 2018; Ball et al. 2023.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import torch

from icub_policies.networks import Actor, Critics
from icub_policies.replay import Batch
from icub_support.weights import adam_state, fill, load_adam_state, part, with_prefix


@dataclass(frozen=True)
class SacSettings:
    """Numbers of the learner.

    Attributes:
        gamma: Discount of one control step.
        steps: n of the n-step returns.
        tau: Share of the way that target critics move at each update.
        learning_rate: Of actor and entropy coefficient (thesis 3e-4).
        critic_learning_rate: Of the critics (thesis 3e-4).
        batch: Transitions in an update.
        target_entropy: Nats; None is minus the number of actions (thesis: -15 for 15).
        alpha: Entropy coefficient at the start.
        actor_every: Critic updates between two actor updates.
        reward_scale: Rewards are multiplied by it.
        log_std: Start of the actor's log standard deviation.
        hidden: Units of a layer.
        critics: Size of the ensemble, of which the least value counts (thesis 2): more doubt about new actions.
        caution: Weight of the squared residual in a residual actor's loss, relative to the size of the values.
    """

    gamma: float = 0.99
    steps: int = 10
    tau: float = 0.01
    learning_rate: float = 3e-4
    critic_learning_rate: float = 1e-3
    batch: int = 256
    target_entropy: float | None = None
    alpha: float = 0.002
    actor_every: int = 2
    reward_scale: float = 0.05
    log_std: float = -2.0
    hidden: int = 128
    critics: int = 4
    caution: float = 0.0


def widened_weights(tensors: dict[str, torch.Tensor], old: int, new: int) -> dict[str, torch.Tensor]:
    """Return the weights of networks of `old` state entries for `new` ones: rows of zeros behind the old ones' rows."""
    wider = dict(tensors)
    for name in ("critics.weight1", "targets.weight1"):
        if name in tensors:
            wider[name] = _with_zero_rows(tensors[name], old, new - old)
    if "actor.layer1.weight" in tensors:
        wider["actor.layer1.weight"] = _with_zero_rows(tensors["actor.layer1.weight"].T, old, new - old).T.contiguous()
    return wider


def _with_zero_rows(weight: torch.Tensor, position: int, count: int) -> torch.Tensor:
    """Insert rows of zeros: what follows the state (a base policy's or the judged action) stays behind it."""
    return torch.cat([weight[:position], weight.new_zeros(count, weight.shape[1]), weight[position:]])


class Sac:
    """Networks, optimizers and one update.

    With `residual` the action that critics judge is clip(base + learned, -1, 1) and the actor also sees the base's
    action; entropy is that of the learned part (thesis 13.3.2).

    Args:
        states, actions: Sizes.
        settings: Numbers.
        residual: Learn what to add to a base policy.
        seed: Of the initial weights and of everything sampled later.
    """

    def __init__(self, states: int, actions: int, settings: SacSettings, residual: bool = False, seed: int = 0) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            inputs = states + actions if residual else states
            self.actor = Actor(inputs, actions, settings.hidden, log_std=settings.log_std, zero_mean=residual)
            self.critics = Critics(states, actions, settings.hidden, settings.critics)
        self.targets = copy.deepcopy(self.critics).requires_grad_(False)
        self.log_alpha = torch.tensor(settings.alpha).log().requires_grad_()
        self.generator = torch.Generator().manual_seed(seed)
        self.settings, self.residual, self.actions = settings, residual, actions
        self.states, self.seed = states, seed
        self.target_entropy = -float(actions) if settings.target_entropy is None else settings.target_entropy
        rate, critic_rate = settings.learning_rate, settings.critic_learning_rate
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), lr=rate, fused=True)
        self.critic_optimizer = torch.optim.Adam(self.critics.parameters(), lr=critic_rate, fused=True)
        self.alpha_optimizer = torch.optim.Adam([self.log_alpha], lr=rate)
        self.updates = 0

    def widened(self, states: int, path: Path) -> Sac:
        """Return a learner that sees `states` entries, the new ones behind the old, and that computes the same.

        Weights of new entries start at 0: what they say counts once something was learned from them. `path` is named
        if the learner cannot be widened.
        """
        wider = Sac(states, self.actions, self.settings, self.residual, self.seed)
        wider.load_weights(widened_weights(self.weights(), self.states, states), path)
        return wider

    def resized(self, states: int) -> Sac:
        """Return a fresh learner that sees `states` entries."""
        return Sac(states, self.actions, self.settings, self.residual, self.seed)

    def noise(self, count: int) -> torch.Tensor:
        """Draw (count, a) standard normal numbers from the learner's own stream."""
        return torch.randn(count, self.actions, generator=self.generator)

    def actor_input(self, state: torch.Tensor, base: torch.Tensor) -> torch.Tensor:
        """Return what the actor sees: the state, and for a residual the base policy's action."""
        return torch.cat([state, base], dim=1) if self.residual else state

    def total(self, action: torch.Tensor, base: torch.Tensor) -> torch.Tensor:
        """Return what is executed and judged: the action, or clip(base + residual, -1, 1)."""
        return (base + action).clamp(-1.0, 1.0) if self.residual else action

    def explore(self, state: torch.Tensor, base: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        """Return the learned part (B, a) made from standard normal `noise` (B, a)."""
        with torch.no_grad():
            return self.actor.sample(self.actor_input(state, base), noise)[0]

    def critic_loss(self, batch: Batch, noise: torch.Tensor) -> torch.Tensor:
        """Sum over critics of the mean squared error to r + discount (min Q_target(s', a') - alpha log pi(a'))."""
        with torch.no_grad():
            action, log_prob = self.actor.sample(self.actor_input(batch.next_state, batch.next_base), noise)
            values = self.targets(batch.next_state, self.total(action, batch.next_base)).amin(0)
            target = batch.reward * self.settings.reward_scale
            target = target + batch.discount * (values - self.log_alpha.exp() * log_prob)
        error = (self.critics(batch.state, self.total(batch.action, batch.base)) - target).square()
        return (error * batch.weight).sum() / batch.weight.sum().clamp_min(1.0)

    def actor_loss(self, batch: Batch, noise: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean of alpha log pi(a) - min Q(s, a), and the log-probabilities (B,) without gradient."""
        action, log_prob = self.actor.sample(self.actor_input(batch.state, batch.base), noise)
        values = self.critics(batch.state, self.total(action, batch.base)).amin(0)
        return (self.log_alpha.exp().detach() * log_prob - values).mean(), log_prob.detach()

    def alpha_loss(self, log_prob: torch.Tensor) -> torch.Tensor:
        """-log alpha (log pi + target entropy), averaged."""
        return -(self.log_alpha * (log_prob + self.target_entropy)).mean()

    def imitation_loss(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Mean squared distance of the most likely action from a demonstrated one."""
        return (self.actor.best(state) - action).square().sum(1).mean()

    def imitate(self, batch: Batch) -> None:
        """Do one step of the actor towards demonstrated actions alone."""
        self.actor_optimizer.zero_grad(set_to_none=True)
        self.imitation_loss(batch.state, batch.action).backward()
        self.actor_optimizer.step()

    def update(self, batch: Batch, shown: int = 0, imitation: float = 0.0, actor: bool = True) -> None:
        """Do one step of the critics and, every few, one of actor and entropy coefficient.

        Args:
            batch: Transitions; the first `shown` are demonstrations.
            shown: How many of them the actor also imitates.
            imitation: Weight of that, relative to the size of the values.
            actor: Whether the actor may learn at all.
        """
        self.critic_optimizer.zero_grad(set_to_none=True)
        self.critic_loss(batch, self.noise(len(batch.reward))).backward()
        self.critic_optimizer.step()
        with torch.no_grad():
            torch._foreach_lerp_(list(self.targets.parameters()), list(self.critics.parameters()), self.settings.tau)
        self.updates += 1
        if not actor or self.updates % self.settings.actor_every:
            return
        self.critics.requires_grad_(False)
        self.actor_optimizer.zero_grad(set_to_none=True)
        loss, log_prob = self.actor_loss(batch, self.noise(len(batch.reward)))
        size = loss.detach().abs().clamp_min(1.0)
        if shown and imitation:
            loss = loss + imitation * size * self.imitation_loss(batch.state[:shown], batch.action[:shown])
        if self.settings.caution:
            residual = self.actor.best(self.actor_input(batch.state, batch.base))
            loss = loss + self.settings.caution * size * residual.square().sum(1).mean()
        loss.backward()
        self.actor_optimizer.step()
        self.critics.requires_grad_(True)
        self.alpha_optimizer.zero_grad(set_to_none=True)
        self.alpha_loss(log_prob).backward()
        self.alpha_optimizer.step()

    def weights(self) -> dict[str, torch.Tensor]:
        """Return the weights of actor, critics and target critics."""
        nets = {"actor.": self.actor, "critics.": self.critics, "targets.": self.targets}
        return {prefix + name: value for prefix, net in nets.items() for name, value in net.state_dict().items()}

    def load_weights(self, tensors: dict[str, torch.Tensor], path: Path) -> None:
        """Restore what `weights` returned; WeightsError names the first tensor that does not fit."""
        fill(self.actor, part(tensors, "actor"), f"actor in {path}")
        self.load_critics(tensors, path)

    def load_critics(self, tensors: dict[str, torch.Tensor], path: Path) -> None:
        """Take the critics and target critics alone."""
        fill(self.critics, part(tensors, "critics"), f"critics in {path}")
        fill(self.targets, part(tensors, "targets"), f"targets in {path}")

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return everything that decides later updates."""
        return {
            **self.weights(),
            **with_prefix("adam.actor", adam_state(self.actor_optimizer)),
            **with_prefix("adam.critics", adam_state(self.critic_optimizer)),
            **with_prefix("adam.alpha", adam_state(self.alpha_optimizer)),
            "log_alpha": self.log_alpha.detach(),
            "generator": self.generator.get_state(),
            "updates": torch.tensor(self.updates),
        }

    def load_state_dict(self, tensors: dict[str, torch.Tensor], path: Path) -> None:
        """Restore what `state_dict` returned."""
        self.load_weights(tensors, path)
        load_adam_state(self.actor_optimizer, part(tensors, "adam.actor"))
        load_adam_state(self.critic_optimizer, part(tensors, "adam.critics"))
        load_adam_state(self.alpha_optimizer, part(tensors, "adam.alpha"))
        with torch.no_grad():
            self.log_alpha.copy_(tensors["log_alpha"])
        self.generator.set_state(tensors["generator"])
        self.updates = int(tensors["updates"])
