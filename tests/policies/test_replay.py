"""The replay memory: windows by hand, ends, the ring, and that it can be written and read back."""

from __future__ import annotations

import pytest
import torch

from icub_policies.replay import CUT, RUNNING, TERMINAL, Replay

GAMMA = 0.9


def filled(ends: list[int], rows: int = 20) -> Replay:
    """One world; state, action and reward of row t are t."""
    replay = Replay(rows, 1, 1, 1)
    for t, end in enumerate(ends):
        value = torch.full((1, 1), float(t))
        replay.add(value, value, value[0], torch.tensor([end], dtype=torch.uint8))
    return replay


def window(replay: Replay, start: int, steps: int = 3):
    return replay.windows(torch.tensor([start]), torch.tensor([0]), steps, GAMMA)


def test_a_window_sums_discounted_rewards_and_bootstraps_from_the_state_after_it():
    batch = window(filled([RUNNING] * 8), 2)
    assert batch.reward.item() == pytest.approx(2 + 0.9 * 3 + 0.81 * 4)
    assert batch.next_state.item() == 5
    assert batch.discount.item() == pytest.approx(0.9**3)
    assert batch.weight.item() == 1


def test_a_terminal_step_counts_and_nothing_after_it_does():
    batch = window(filled([RUNNING, RUNNING, RUNNING, TERMINAL, RUNNING, RUNNING]), 2)
    assert batch.reward.item() == pytest.approx(2 + 0.9 * 3)
    assert batch.discount.item() == 0


def test_a_cut_step_is_not_learned_from_but_what_came_before_bootstraps_from_it():
    replay = filled([RUNNING, RUNNING, RUNNING, CUT, RUNNING, RUNNING, RUNNING])
    before = window(replay, 2)
    assert before.reward.item() == pytest.approx(2)
    assert before.next_state.item() == 3
    assert before.discount.item() == pytest.approx(0.9)
    assert window(replay, 3).weight.item() == 0
    assert replay.reward[3].item() == 0
    assert replay.action[3].item() == 0


def test_the_ring_forgets_the_oldest_rows_and_never_reaches_over_its_end():
    replay = filled([RUNNING] * 25, rows=10)
    generator = torch.Generator().manual_seed(0)
    batch = replay.sample(500, 3, GAMMA, generator)
    assert len(replay) == 10
    assert batch.state.min() == 15
    assert batch.state.max() == 21
    torch.testing.assert_close(batch.next_state, batch.state + 3)


def test_one_observation_is_stored_once():
    replay = Replay(100, 4, 29, 15)
    assert replay.state.numel() == 100 * 4 * 29


def test_it_can_be_written_and_read_back():
    replay = filled([RUNNING, CUT, RUNNING, TERMINAL, RUNNING])
    other = Replay(20, 1, 1, 1)
    other.load_state_dict(replay.state_dict())
    first, second = window(replay, 2), window(other, 2)
    assert first.reward == second.reward
    assert len(other) == len(replay)
