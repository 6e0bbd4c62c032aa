"""Contract of policies, in a tiny task; what is learned is proven where the policies are."""

from __future__ import annotations

import tempfile
from pathlib import Path

import torch
from tensordict import TensorDict, TensorDictBase

from icub_core.errors import ConfigError
from icub_core.interfaces.abilities import HasWeights, Learns
from icub_core.interfaces.policy import LearnReport, Policy
from icub_core.interfaces.task import Task
from icub_testing.checks import Make
from icub_testing.checks_segmenter import PICKLE_BEGINNINGS
from icub_testing.expect import expect, expect_close, expect_same, expect_tensor
from icub_testing.tiny.task import TinyTask

ROW_TOLERANCE = 1e-5
"""An action may differ by rounding between batch sizes."""
HANDS = ((4, 3), (9, 5))
"""Actuators and fingertips of the hands that are tried: a policy whose weights are made for one refuses the other."""


def _bound(make: Make) -> tuple[Policy, Task]:
    """Return a policy and a task that it can act in; ContractError with its own words where there is none."""
    refusals = []
    for fingers, fingertips in HANDS:
        policy, task = make(), TinyTask(num_envs=4, fingers=fingers, fingertips=fingertips)
        try:
            policy.bind(task)
        except ConfigError as refusal:
            refusals.append(str(refusal))
            continue
        return policy, task
    expect(False, "a policy that binds to a task with one of the hands tried", " / ".join(refusals))
    raise AssertionError


def _observations(task: Task, seed: int = 0) -> TensorDictBase:
    """Draw plausible observations: a hand above the table, fingers half closed, the object near."""
    generator = torch.Generator().manual_seed(seed)
    for world in range(task.batch_size[0]):
        task.begin(world, task.draw(world))
    drawn = task.observe()
    touch = (torch.rand(drawn["touch"].shape, generator=generator) > 0.5).float()
    touch[0] = 0.0  # a hand that feels nothing is always among them
    drawn["touch"] = touch
    drawn["fingers"] = 0.25 + 0.5 * torch.rand(drawn["fingers"].shape, generator=generator)
    drawn["step"] = torch.randint(0, 200, drawn["step"].shape, generator=generator).float()
    return drawn


def _far(observations: TensorDictBase, factor: float) -> TensorDictBase:
    floats = {key: factor * value for key, value in observations.items() if value.is_floating_point()}
    return TensorDict({**dict(observations.items()), **floats}, batch_size=observations.batch_size)


def check_actions(make: Make) -> None:
    """Actions are float32 (B, a) as the task's specification says, finite, within [-1, 1]."""
    policy, task = _bound(make)
    observations = _observations(task)
    for batch in (1, 4):
        action = policy.act(observations[:batch])
        expect_tensor(action, (batch, task.action_spec.shape[-1]), "actions")
        expect(bool((action.abs() <= 1).all()), "actions within [-1, 1]", f"{float(action.abs().max()):.3g}")


def check_extreme_observations(make: Make) -> None:
    """Actions stay within [-1, 1] for observations far from anything that was learned."""
    policy, task = _bound(make)
    action = policy.act(_far(_observations(task), 100.0))
    expect(bool(torch.isfinite(action).all()), "finite actions", "NaN or infinite numbers")
    expect(bool((action.abs() <= 1).all()), "actions within [-1, 1]", f"{float(action.abs().max()):.3g}")


def check_repeatable(make: Make) -> None:
    """The same observation gives the same action, whatever was asked in between."""
    policy, task = _bound(make)
    observations = _observations(task)
    first = policy.act(observations.clone())
    policy.act(_far(_observations(task, seed=1), 2.0))
    expect_same(first, policy.act(observations.clone()), "actions for the same observations")


def check_rows_apart(make: Make) -> None:
    """Each row of a batch is answered by itself."""
    policy, task = _bound(make)
    observations = _observations(task)
    together, alone = policy.act(observations.clone()), policy.act(observations[2:3].clone())
    expect_close(together[2:3], alone, ROW_TOLERANCE, "the action for one row, alone and in a batch")


def check_two_alike(make: Make) -> None:
    """Two policies made alike act alike."""
    (policy, task), (other, _) = _bound(make), _bound(make)
    observations = _observations(task)
    expect_same(policy.act(observations.clone()), other.act(observations.clone()), "actions of two policies made alike")


def check_inputs_unchanged(make: Make) -> None:
    """Observations are not changed, and gain no entries."""
    policy, task = _bound(make)
    observations = _observations(task)
    before = observations.clone()
    policy.act(observations)
    expect_same(sorted(observations.keys()), sorted(before.keys()), "entries before and after")
    for name in before.keys():  # noqa: SIM118  # a TensorDict iterates over rows
        expect_same(observations[name], before[name], f"'{name}' before and after")


def check_save_and_load(make: Make) -> None:
    """A policy with weights that loads what another one saved acts alike, and the file holds no pickle."""
    (policy, task), (other, _) = _bound(make), _bound(make)
    if not isinstance(policy, HasWeights):
        return
    assert isinstance(other, HasWeights)
    observations = _observations(task)
    before = policy.act(observations.clone())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "policy")
        policy.save(path)
        files = [f for f in Path(folder).rglob("*") if f.is_file()]
        expect(bool(files), "a file written by save", "none")
        for file in files:
            with file.open("rb") as stream:
                beginning = stream.read(4)
            expect(not beginning.startswith(PICKLE_BEGINNINGS), f"{file.name} without pickle", beginning)
        other.load(path)
    expect_same(before, other.act(observations.clone()), "actions after loading")
    expect_same(before, policy.act(observations.clone()), "actions before and after saving")


def check_learning(make: Make) -> None:
    """A policy that learns does so for about the seconds it is given, and answers with a report."""
    policy, task = _bound(make)
    if not isinstance(policy, Learns):
        return
    report = policy.learn(task, seconds=0.2)
    expect(isinstance(report, LearnReport), "a LearnReport", type(report).__name__)
    expect(report.env_steps > 0, "control steps done while learning", report.env_steps)
    action = policy.act(_observations(task))
    expect(bool(torch.isfinite(action).all()), "finite actions after learning", "NaN or infinite numbers")
