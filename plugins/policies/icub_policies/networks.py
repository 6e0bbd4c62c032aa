"""Actor and critics: two hidden layers, small and quick on a CPU."""

from __future__ import annotations

import math

import torch
from torch import nn
from torch.nn import functional as F

LOG_STD_MIN, LOG_STD_MAX = -2.3, -1.0
"""The least noise keeps critics informed about the neighborhood of what is done; without it the actor climbs into
values that nothing supports. More than the most makes nearly every grasp fail."""
LOG_2PI = math.log(2 * math.pi)


class Actor(nn.Module):
    """Tanh-squashed Gaussian: input (B, d) to actions in [-1, 1].

    Args:
        inputs: d.
        actions: Number of actions.
        hidden: Units of each of the two layers.
        log_std: What the logarithm of the standard deviation starts at.
        zero_mean: Start with the mean exactly 0 everywhere (a residual that changes nothing).
    """

    def __init__(
        self, inputs: int, actions: int, hidden: int = 128, log_std: float = -2.0, zero_mean: bool = False
    ) -> None:
        super().__init__()
        self.layer1 = nn.Linear(inputs, hidden)
        self.layer2 = nn.Linear(hidden, hidden)
        self.mean = nn.Linear(hidden, actions)
        self.log_std = nn.Linear(hidden, actions)
        nn.init.zeros_(self.log_std.weight)
        nn.init.constant_(self.log_std.bias, log_std)
        nn.init.uniform_(self.mean.weight, -1e-2, 1e-2)
        nn.init.zeros_(self.mean.bias)
        if zero_mean:
            nn.init.zeros_(self.mean.weight)

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and standard deviation (B, a) before squashing."""
        h = F.relu(self.layer2(F.relu(self.layer1(x))))
        return self.mean(h), self.log_std(h).clamp(LOG_STD_MIN, LOG_STD_MAX).exp()

    def best(self, x: torch.Tensor) -> torch.Tensor:
        """Return the squashed mean (B, a)."""
        h = F.relu(self.layer2(F.relu(self.layer1(x))))
        return torch.tanh(self.mean(h))

    def sample(self, x: torch.Tensor, noise: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return actions (B, a) made from standard normal `noise` (B, a), and their log-probabilities (B,)."""
        mean, std = self(x)
        raw = mean + std * noise
        log_normal = (-0.5 * noise.square() - std.log() - 0.5 * LOG_2PI).sum(1)
        squash = 2 * (math.log(2.0) - raw - F.softplus(-2 * raw)).sum(1)  # log(1 - tanh(raw)^2)
        return torch.tanh(raw), log_normal - squash


class Critics(nn.Module):
    """An ensemble of action values with layer normalization, evaluated in one go.

    Layer normalization bounds what the critics say about actions nobody took, which keeps learning from demonstrations
    from diverging (Ball et al., "Efficient online reinforcement learning with offline data", ICML 2023).

    Args:
        inputs: Size of the state.
        actions: Number of actions.
        hidden: Units of each of the two layers.
        count: Number of critics.
    """

    def __init__(self, inputs: int, actions: int, hidden: int = 128, count: int = 2) -> None:
        super().__init__()
        self._count, self._hidden = count, hidden
        self.weight1 = nn.Parameter(_uniform((inputs + actions, count * hidden), inputs + actions))
        self.bias1 = nn.Parameter(torch.zeros(count * hidden))
        self.weight2 = nn.Parameter(_uniform((count, hidden, hidden), hidden))
        self.bias2 = nn.Parameter(torch.zeros(count, 1, hidden))
        self.weight3 = nn.Parameter(_uniform((count, hidden, 1), hidden))
        self.bias3 = nn.Parameter(torch.zeros(count, 1, 1))

    def forward(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Return the values (count, B) of actions (B, a) in states (B, d)."""
        shape = (self._hidden,)
        h = torch.addmm(self.bias1, torch.cat([state, action], dim=1), self.weight1)
        h = h.view(-1, self._count, self._hidden).transpose(0, 1)
        h = F.relu(F.layer_norm(h, shape))
        h = F.relu(F.layer_norm(torch.baddbmm(self.bias2, h, self.weight2), shape))
        return torch.baddbmm(self.bias3, h, self.weight3)[..., 0]


def _uniform(shape: tuple[int, ...], fan_in: int) -> torch.Tensor:
    bound = 1 / math.sqrt(fan_in)
    return torch.empty(shape).uniform_(-bound, bound)
