"""Contract of policies, on made-up observations; learning is proven where the grasping task is."""

from __future__ import annotations

import tempfile
from pathlib import Path

import torch
from tensordict import TensorDict

from icub_tasks.grasping.spaces import ACTION_SIZE, OBSERVATION_SIZES, PLAN, PLAN_SIZE
from icub_testing.checks import Make
from icub_testing.checks_segmenter import PICKLE_BEGINNINGS
from icub_testing.expect import expect, expect_close, expect_same, expect_tensor

ROW_TOLERANCE = 1e-5
"""An action may differ by rounding between batch sizes."""


def _observations(batch: int = 4, seed: int = 0) -> TensorDict:
    """Draw plausible observations: a hand above the table, fingers half closed, the object near."""
    generator = torch.Generator().manual_seed(seed)

    def around(center: list[float], spread: float) -> torch.Tensor:
        return torch.tensor(center) + spread * (torch.rand((batch, len(center)), generator=generator) - 0.5)

    center = around([-0.35, 0.0, 1.03], 0.05)
    touch = (torch.rand((batch, OBSERVATION_SIZES["touch"]), generator=generator) > 0.5).float()
    touch[0] = 0.0  # a hand that feels nothing is always among them
    values = {
        "hand_pose": torch.cat([center + around([0.05, 0.0, 0.08], 0.02), around([3.1, 0.0, 3.1], 0.3)], dim=1),
        "fingers": around([0.5] * OBSERVATION_SIZES["fingers"], 0.5),
        "touch": touch,
        "object_center": center,
        PLAN: torch.cat(
            [
                center + torch.tensor([0.08, 0.0, 0.10]),  # pre-grasp
                center + torch.tensor([0.05, 0.0, 0.06]),  # grasp
                torch.randint(0, 200, (batch, 1), generator=generator).float(),
                torch.zeros((batch, 9)),
                torch.ones((batch, 9)),
                torch.full((batch, PLAN_SIZE - 25), 0.2),
            ],
            dim=1,
        ),
    }
    return TensorDict(values, batch_size=[batch])


def check_actions(make: Make) -> None:
    """Actions are float32 (B, 15), finite, within [-1, 1]."""
    for batch in (1, 5):
        action = make().act(_observations(batch))
        expect_tensor(action, (batch, ACTION_SIZE), "actions")
        expect(bool((action.abs() <= 1).all()), "actions within [-1, 1]", f"{float(action.abs().max()):.3g}")


def check_extreme_observations(make: Make) -> None:
    """Actions stay within [-1, 1] for observations far from anything that was learned."""
    observations = _observations().apply(lambda entry: 100.0 * entry)
    action = make().act(observations)
    expect(bool(torch.isfinite(action).all()), "finite actions", "NaN or infinite numbers")
    expect(bool((action.abs() <= 1).all()), "actions within [-1, 1]", f"{float(action.abs().max()):.3g}")


def check_repeatable(make: Make) -> None:
    """The same observation gives the same action, whatever was asked in between."""
    policy = make()
    first = policy.act(_observations())
    policy.act(_observations(seed=1).apply(lambda entry: 2.0 * entry))
    expect_same(first, policy.act(_observations()), "actions for the same observations")


def check_rows_apart(make: Make) -> None:
    """Each row of a batch is answered by itself."""
    policy = make()
    together, alone = policy.act(_observations()), policy.act(_observations()[2:3])
    expect_close(together[2:3], alone, ROW_TOLERANCE, "the action for one row, alone and in a batch")


def check_two_alike(make: Make) -> None:
    """Two policies made alike act alike."""
    expect_same(make().act(_observations()), make().act(_observations()), "actions of two policies made alike")


def check_inputs_unchanged(make: Make) -> None:
    """Observations are not changed, and gain no entries."""
    observations = _observations()
    make().act(observations)
    fresh = _observations()
    expect_same(sorted(observations.keys()), sorted(fresh.keys()), "entries before and after")
    for name in fresh.keys():  # noqa: SIM118  # a TensorDict iterates over rows
        expect_same(observations[name], fresh[name], f"'{name}' before and after")


def check_save_and_load(make: Make) -> None:
    """A policy that loads what another one saved acts alike, and the file holds no pickle."""
    policy, other = make(), make()
    before = policy.act(_observations())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "policy")
        policy.save(path)
        for file in [f for f in Path(folder).rglob("*") if f.is_file()]:
            with file.open("rb") as stream:
                beginning = stream.read(4)
            expect(not beginning.startswith(PICKLE_BEGINNINGS), f"{file.name} without pickle", beginning)
        if any(Path(folder).rglob("*")):
            other.load(path)
    expect_same(before, other.act(_observations()), "actions after loading")
    expect_same(before, policy.act(_observations()), "actions before and after saving")
