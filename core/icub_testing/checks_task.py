"""Contract of tasks: a batch of worlds in which episodes begin, are stepped and end."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import check_env_specs

from icub_core.interfaces.task import RUNNING, Task
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_same, expect_tensor

STEPS = 5
FLAGS = ("success", "fault", "done", "terminated", "truncated")


def _begun(make: Make, seed: int = 0) -> Task:
    task: Task = make()
    for world in range(task.batch_size[0]):
        task.begin(world, task.draw(world, np.random.default_rng([seed, world])))
    return task


def _actions(task: Task, step: int, seed: int = 0) -> TensorDictBase:
    generator = torch.Generator().manual_seed(1000 * seed + step)
    action = 2 * torch.rand(task.action_spec.shape, generator=generator) - 1
    return TensorDict({"action": action}, batch_size=task.batch_size)


def _episode(task: Task, steps: int = STEPS, seed: int = 0) -> list[TensorDictBase]:
    return [task.advance(_actions(task, step, seed)).clone() for step in range(steps)]


def _expect_alike(first: TensorDictBase, second: TensorDictBase, what: str) -> None:
    for name in first.keys():  # noqa: SIM118  # a TensorDict iterates over rows
        expect_same(first[name], second[name], f"'{name}' {what}")


def check_specs(make: Make) -> None:
    """Observations, rewards and ends are as the specifications say (TorchRL's own check)."""
    task = make()
    try:
        check_env_specs(task)
    finally:
        task.close()


def check_names(make: Make) -> None:
    """Ends begin with 'running' and 'success', objects are named, and one scale belongs to each action."""
    task = make()
    expect_same(tuple(task.reasons[:2]), ("running", "success"), "the first two ends")
    expect(len(set(task.reasons)) == len(task.reasons), "ends with different names", task.reasons)
    expect(len(task.objects) > 0, "at least one object", task.objects)
    expect_tensor(task.action_scale, (task.action_spec.shape[-1],), "scales of the actions")
    expect(bool((task.action_scale > 0).all()), "scales above 0", task.action_scale.tolist())
    task.close()


def check_observation_after_begin(make: Make) -> None:
    """A world that has begun is not done, and its start names one of the objects."""
    task = make()
    for world in range(task.batch_size[0]):
        start = task.draw(world, np.random.default_rng(world))
        expect(start.target in task.objects, "a start about one of the objects", start.target)
        task.begin(world, start)
    observation = task.observe()
    for name in FLAGS:
        expect(
            not bool(observation[name].any()), f"'{name}' false at the start", observation[name].reshape(-1).tolist()
        )
    expect(bool((observation["reason"] == RUNNING).all()), "episodes that run", observation["reason"].tolist())
    task.close()


def check_repeatable(make: Make) -> None:
    """The same start and actions give the same episode."""
    first, second = _begun(make), _begun(make)
    for step, (one, two) in enumerate(zip(_episode(first), _episode(second), strict=True)):
        _expect_alike(one, two, f"of step {step} of two tasks made alike")
    first.close()
    second.close()


def check_draws(make: Make) -> None:
    """A start that is drawn with a random generator depends on nothing else."""
    task = make()
    start = task.draw(0, np.random.default_rng(7))
    task.draw(0)
    task.begin(0, start)
    first = task.observe()[0].clone()
    task.begin(0, task.draw(0, np.random.default_rng(7)))
    _expect_alike(first, task.observe()[0], "after the same start was drawn twice")
    task.close()


def check_worlds_apart(make: Make) -> None:
    """What is done in one world does not change another, and one that is not active stays as it is."""
    task = _begun(make)
    if task.batch_size[0] < 2:
        task.close()
        return
    before = task.observe()[1].clone()
    task.advance(_actions(task, 0), [world == 0 for world in range(task.batch_size[0])])
    task.begin(0, task.draw(0, np.random.default_rng(3)))
    after = task.observe()[1]
    for name in before.keys():  # noqa: SIM118  # a TensorDict iterates over rows
        if name != "step":
            expect_same(before[name], after[name], f"'{name}' of a world that was not active")
    task.close()


def check_faults(make: Make) -> None:
    """An action that is not finite is a fault: a truncation without reward, counted, and the world can begin again."""
    task = _begun(make)
    actions = _actions(task, 0)
    actions["action"][0] = float("nan")
    after = task.advance(actions)
    expect(bool(after["fault"][0]) and bool(after["truncated"][0]), "a truncation by a fault", "none")
    expect(not bool(after["terminated"][0]), "no termination by a fault", "one")
    expect_same(float(after["reward"][0]), 0.0, "reward of a faulty transition")
    name = task.reasons[int(after["reason"][0])]
    expect(task.fault_counts().get(name, 0) == 1, f"one end counted as '{name}'", dict(task.fault_counts()))
    task.begin(0, task.draw(0, np.random.default_rng(1)))
    expect(not bool(task.observe()["done"][0]), "a world that begins again", "done")
    task.close()


def check_privileged(make: Make) -> None:
    """The privileged observation has every entry of the ordinary one, which hides what is privileged."""
    task = _begun(make)
    ordinary, privileged = set(task.observe().keys()), set(task.privileged().keys())
    expect(ordinary <= privileged, "every observation among the privileged", sorted(ordinary - privileged))
    task.close()


def check_state(make: Make) -> None:
    """After `load_state_dict` the future is that of the task whose state it was."""
    task = _begun(make)
    _episode(task, 2, seed=1)
    state = {name: value.clone() for name, value in task.state_dict().items()}
    first = _episode(task)
    drawn = task.draw(0).target
    _episode(task, 1, seed=2)
    other = _begun(make, seed=5)
    other.load_state_dict(state)
    for step, (one, two) in enumerate(zip(first, _episode(other), strict=True)):
        _expect_alike(one, two, f"of step {step} after the state was restored")
    expect_same(drawn, other.draw(0).target, "the next start that is drawn")
    expect(all(isinstance(value, torch.Tensor) for value in state.values()), "a state of tensors", "others")
    task.close()
    other.close()


def check_images(make: Make) -> None:
    """An image of a world is (height, width, 3) uint8."""
    task = _begun(make)
    image = task.render_world(0, width=64, height=48)
    expect_same((image.shape, image.dtype), ((48, 64, 3), np.dtype(np.uint8)), "shape and type of an image")
    task.close()


def check_close_twice(make: Make) -> None:
    """Closing twice is allowed."""
    task = make()
    task.close()
    task.close()
