"""Replay memory that stores every observation once: rows are time, columns are worlds."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from icub_policies.inputs import STACK
from icub_support.flare import HISTORY, flare

RUNNING, TERMINAL, CUT = 0, 1, 2
"""How a stored step went on: normally; into a terminal state; or not to be learned from (a truncation or a fault), then
its observation still serves as the state that the steps before it bootstrap from."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Transitions over up to n steps.

    Attributes:
        state, next_state: (B, d).
        action, base, next_base: (B, a); the bases are empty unless a base policy's actions are kept.
        reward: (B,) discounted sum.
        discount: (B,) what the value of `next_state` is multiplied by; 0 after a terminal state.
        weight: (B,) 1, or 0 where nothing may be learned.
    """

    state: torch.Tensor
    action: torch.Tensor
    base: torch.Tensor
    reward: torch.Tensor
    next_state: torch.Tensor
    next_base: torch.Tensor
    discount: torch.Tensor
    weight: torch.Tensor


class Replay:
    """Ring of the last rows of N worlds.

    Of a visual part only the newest image of a step is kept; the stack of three is made again when a step is drawn,
    a fifth of the memory.

    Args:
        rows: Steps kept of every world.
        worlds: N.
        state, action: Sizes.
        base: Whether to keep the base policy's action beside the learned one.
        visual: F when the last 5 F entries of a state are the stacked features of three images.
    """

    def __init__(self, rows: int, worlds: int, state: int, action: int, base: bool = False, visual: int = 0) -> None:
        self._rows, self._worlds, self._visual = rows, worlds, visual
        self.state = torch.zeros(rows, worlds, state - (STACK - 1) * visual)
        self.action = torch.zeros(rows, worlds, action)
        self.base = torch.zeros(rows, worlds, action if base else 0)
        self.reward = torch.zeros(rows, worlds)
        self.end = torch.zeros(rows, worlds, dtype=torch.uint8)
        self.added = 0

    def __len__(self) -> int:
        return min(self.added, self._rows) * self._worlds

    def add(
        self,
        state: torch.Tensor,
        action: torch.Tensor,
        reward: torch.Tensor,
        end: torch.Tensor,
        base: torch.Tensor | None = None,
    ) -> None:
        """Append one step of all worlds: (N, d), (N, a), (N,), (N,) codes, (N, a)."""
        row = self.added % self._rows
        usable = (end != CUT)[:, None]
        self.state[row] = self._newest(state)
        self.action[row] = action * usable
        self.reward[row] = reward * usable[:, 0]
        self.end[row] = end
        if base is not None:
            self.base[row] = base
        self.added += 1

    def ready(self, steps: int) -> bool:
        """Return True if windows of `steps` steps can be drawn."""
        return self.added > steps + (HISTORY if self._visual else 0)

    def sample(self, count: int, steps: int, gamma: float, generator: torch.Generator) -> Batch:
        """Draw `count` windows of up to `steps` steps uniformly."""
        oldest = max(0, self.added - self._rows)
        if self._visual and oldest:
            oldest += HISTORY - 1  # the images before these steps are overwritten
        starts = torch.randint(oldest, self.added - steps, (count,), generator=generator)
        worlds = torch.randint(self._worlds, (count,), generator=generator)
        return self.windows(starts, worlds, steps, gamma)

    def windows(self, starts: torch.Tensor, worlds: torch.Tensor, steps: int, gamma: float) -> Batch:
        """Return the windows that begin at rows `starts` (counted from the first ever added) of `worlds`."""
        offsets = torch.arange(steps)
        rows = (starts[:, None] + offsets) % self._rows  # (B, n)
        ends = self.end[rows, worlds[:, None]]
        running = ends == RUNNING
        before = torch.cat([torch.ones_like(running[:, :1]), running[:, :-1].cumprod(1).bool()], dim=1)
        discounts = gamma**offsets
        reward = (self.reward[rows, worlds[:, None]] * before * discounts).sum(1)
        length = (before & (ends != CUT)).sum(1)  # steps whose reward counts
        terminal = (before & (ends == TERMINAL)).any(1)
        first, last = rows[:, 0], (starts + length) % self._rows
        return Batch(
            state=self._states(starts, worlds),
            action=self.action[first, worlds],
            base=self.base[first, worlds],
            reward=reward,
            next_state=self._states(starts + length, worlds),
            next_base=self.base[last, worlds],
            discount=torch.where(terminal, 0.0, gamma**length),
            weight=(length > 0).float(),
        )

    def _newest(self, state: torch.Tensor) -> torch.Tensor:
        """Leave out of states (N, d) what older rows know."""
        if not self._visual:
            return state
        return torch.cat([state[:, : -STACK * self._visual], state[:, -self._visual :]], dim=1)

    def _states(self, times: torch.Tensor, worlds: torch.Tensor) -> torch.Tensor:
        """Return the states (B, d) at `times`, counted in rows from the first ever added."""
        now = self.state[times % self._rows, worlds]
        if not self._visual:
            return now
        older = self._before(times, worlds)
        oldest = self._before(older, worlds)
        images = [self.state[t % self._rows, worlds, -self._visual :] for t in (oldest, older, times)]
        return torch.cat([now[:, : -self._visual], flare(torch.stack(images, dim=1))], dim=1)

    def _before(self, times: torch.Tensor, worlds: torch.Tensor) -> torch.Tensor:
        """Return the step before each within its episode; an episode's first step is its own."""
        running = self.end[(times - 1) % self._rows, worlds] == RUNNING
        return torch.where(running & (times > 0), times - 1, times)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return the filled rows and the count."""
        filled = min(self.added, self._rows)
        names = ("state", "action", "base", "reward", "end")
        return {**{n: getattr(self, n)[:filled].clone() for n in names}, "added": torch.tensor(self.added)}

    def load_state_dict(self, arrays: dict[str, torch.Tensor]) -> None:
        """Restore what `state_dict` returned."""
        self.added = int(arrays["added"])
        filled = min(self.added, self._rows)
        for name in ("state", "action", "base", "reward", "end"):
            getattr(self, name)[:filled] = arrays[name]


def concatenate(parts: list[Batch]) -> Batch:
    """Put batches after one another."""
    if len(parts) == 1:
        return parts[0]
    return Batch(*(torch.cat([getattr(p, name) for p in parts]) for name in Batch.__dataclass_fields__))
