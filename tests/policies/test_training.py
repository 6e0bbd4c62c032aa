"""The loop of every learning policy promises: the best evaluated weights, demonstrations in every batch, critics first.

The tiny task has no physics: whole trainings take seconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from icub_core.rollouts import EpisodeResults
from icub_policies import gpayn, training
from icub_policies.gpayn import Gpayn
from icub_policies.resprect import Resprect
from icub_policies.sac import Sac
from icub_testing.tiny.task import TinyTask


@pytest.fixture
def task() -> TinyTask:
    return TinyTask(num_envs=4, fingers=9, fingertips=5)


@pytest.fixture(params=["gpayn", "resprect"])
def policy(request, base_file):
    """A learner of 400 control steps that is evaluated before, after every hundred, and at the end."""
    if request.param == "gpayn":
        made = Gpayn(hidden=16, seconds=None, env_steps=400, demonstrations=4, updates_per_step=0.1)
        warm_up = {"imitation_updates": 3, "warm_up_updates": 4, "critic_updates": 10}
    else:
        made = Resprect(base=str(base_file), seconds=None, env_steps=400, warm_up_steps=80, updates_per_step=0.1)
        warm_up = {"critic_updates": 10}
    made.settings = replace(made.settings, evaluate_every=100, evaluation_episodes=4, **warm_up)
    return made


def scripted(monkeypatch, policy, scores, returns=None) -> list[dict[str, torch.Tensor]]:
    """Let evaluations have these scores; returns the learner's weights at each of them, as they come."""
    kept: list[dict[str, torch.Tensor]] = []

    def evaluated(acting, task, episodes, start_of, **_):
        assert acting is policy
        number = len(kept)
        kept.append({name: value.clone() for name, value in policy.sac.weights().items()})
        won = np.arange(episodes) < round(scores[number] * episodes)
        reward = np.full(episodes, returns[number] if returns else 0.0)
        ones = np.ones(episodes, dtype=np.int64)
        return EpisodeResults(won, reward, ones, ones, ("goal",) * episodes, task.reasons)

    monkeypatch.setattr(training, "run_episodes", evaluated)
    return kept


def same(one, two) -> bool:
    return all(torch.equal(value, two[name]) for name, value in one.items())


@pytest.mark.parametrize(
    ("scores", "returns", "best"),
    [
        ([0.25, 0.5, 1.0, 0.5, 0.25], None, 2),  # worse at the end
        ([0.25, 0.5, 0.75, 0.75, 1.0], None, 4),  # better at the end
        ([0.75, 0.5, 0.5, 0.5, 0.25], [5.0, 9.0, 9.0, 9.0, 9.0], 0),  # never better than what it began with
        ([0.5, 0.5, 0.5, 0.5, 0.5], [1.0, 2.0, 7.0, 3.0, 4.0], 2),  # the return decides among equals
    ],
)
def test_the_best_evaluated_weights_are_returned_not_the_last(monkeypatch, task, policy, scores, returns, best):
    policy.settings = replace(policy.settings, critic_updates=0)
    kept = scripted(monkeypatch, policy, scores, returns)
    report = policy.learn(task)
    assert len(kept) == len(scores)
    assert not any(same(kept[best], other) for number, other in enumerate(kept) if number != best)
    assert same(kept[best], policy.sac.weights())
    assert report.metrics["best_success"] == scores[best]
    assert report.metrics["first_success"] == scores[0]
    assert report.metrics["last_success"] == scores[-1]
    assert report.metrics["best_env_steps"] == 100 * best


def test_while_the_actor_is_frozen_the_newest_critics_are_kept(monkeypatch, task, policy):
    """The scores of one actor differ by nothing: its later critics know more."""
    policy.settings = replace(policy.settings, critic_updates=10**6)
    kept = scripted(monkeypatch, policy, [0.75, 0.5, 0.5, 0.25, 0.25])
    policy.learn(task)
    assert same(kept[-1], policy.sac.weights())


def spied(monkeypatch):
    """Return what every update was given and whether it changed the actor, as they come."""
    seen = []
    update = Sac.update

    def watched(self, batch, shown=0, imitation=0.0, actor=True):
        before = [p.clone() for p in self.actor.parameters()]
        number = self.updates
        update(self, batch, shown, imitation, actor)
        moved = any(not torch.equal(a, b) for a, b in zip(before, self.actor.parameters(), strict=True))
        seen.append((number, batch, shown, moved))

    monkeypatch.setattr(Sac, "update", watched)
    return seen


def test_the_actor_stays_as_it_is_until_the_critics_had_their_head_start(monkeypatch, task, policy):
    seen = spied(monkeypatch)
    policy.learn(task)
    early = [moved for number, _, _, moved in seen if number < 10]
    late = [moved for number, _, _, moved in seen if number >= 10]
    assert len(early) == 10
    assert not any(early)
    assert sum(late) >= len(late) // policy.sac.settings.actor_every > 5


def test_half_of_every_batch_of_gpayn_are_demonstrations_for_ever(monkeypatch, task):
    policy = Gpayn(hidden=16, seconds=None, env_steps=200, demonstrations=4)
    policy.settings = replace(
        policy.settings, evaluate_every=1000, evaluation_episodes=1,
        imitation_updates=2, warm_up_updates=2, critic_updates=4,
    )  # fmt: skip
    memories = []
    demonstrate = gpayn.demonstrate

    def watched(task, teacher, inputs, replay, *rest):
        memories.append(replay)
        return demonstrate(task, teacher, inputs, replay, *rest)

    monkeypatch.setattr(gpayn, "demonstrate", watched)
    seen = spied(monkeypatch)
    policy.learn(task)
    (memory,) = memories
    rows = memory.state[: len(memory)].reshape(-1, memory.state.shape[-1])
    known = {row.numpy().tobytes() for row in rows}
    size = policy.sac.settings.batch
    assert len(seen) > 20
    for number, batch, shown, _ in seen:
        demonstrated = [row.numpy().tobytes() in known for row in batch.state]
        if number < 2:  # the warm-up knows nothing else
            assert all(demonstrated)
            continue
        assert shown == size // 2
        assert all(demonstrated[:shown])
        assert not any(demonstrated[shown:])


def test_learning_keeps_to_the_seconds_it_is_given(task, policy):
    policy.settings = replace(policy.settings, env_steps=None, evaluation_episodes=1, evaluate_every=10**9)
    report = policy.learn(task, seconds=0.5)
    assert 0.5 <= report.seconds < 3
    assert report.env_steps > 0
