"""Bounds and choices stand in a constructor's signature: refused at composition, shown by `icub plugins show`."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest

from icub_core.bounds import above, at_least, between
from icub_core.cli import main
from icub_core.construct import checked_parameters
from icub_core.errors import ConfigError

MODULE = '''
from dataclasses import dataclass
from typing import Annotated, Literal
from icub_core.bounds import above, at_least, between
from icub_testing.tiny.skills import TinyPolicy
@dataclass(frozen=True)
class Budget:
    seconds: Annotated[float, above(0)] = 60.0
class Bounded(TinyPolicy):
    """Does as it is bounded."""
    def __init__(
        self,
        rate: Annotated[float, above(0)] = 0.5,
        count: Annotated[int, at_least(1)] = 3,
        share: Annotated[float, between(0, 1)] = 0.25,
        seconds: Annotated[float | None, above(0)] = None,
        mode: Literal["fast", "exact"] = "fast",
        budget: Budget = Budget(),
    ):
        super().__init__()
'''
WORLD = ["simulator=tiny", "robot=tiny", "objects=tiny", "grasp_generator=tiny"]


@dataclass(frozen=True)
class Budget:
    seconds: Annotated[float, above(0)] = 60.0


@dataclass(frozen=True)
class Plan:
    budget: Budget = Budget()
    mode: Literal["fast", "exact"] = "fast"


class Bounded:
    def __init__(
        self,
        rate: Annotated[float, above(0)] = 0.5,
        count: Annotated[int, at_least(1)] = 3,
        share: Annotated[float, between(0, 1)] = 0.25,
        seconds: Annotated[float | None, above(0)] = None,
        mode: Literal["fast", "exact"] = "fast",
        turns: Literal[1, 2, 4] = 1,
        sizes: Annotated[list[float], above(0)] = [1.0],  # noqa: B006  # a plugin may do this
        pair: tuple[Annotated[float, at_least(0)], Annotated[float, at_least(0)]] = (0.0, 1.0),
        plan: Plan = Plan(),  # noqa: B008
    ): ...


@pytest.mark.parametrize(
    ("values", "arrives"),
    [
        ({"rate": 1e-9}, 1e-9),
        ({"count": 1}, 1),
        ({"share": 0}, 0.0),
        ({"share": 1}, 1.0),
        ({"seconds": None}, None),
        ({"seconds": 2}, 2.0),
        ({"mode": "exact"}, "exact"),
        ({"turns": 4}, 4),
        ({"sizes": [0.5, 2]}, [0.5, 2.0]),
        ({"pair": [0, 3]}, (0.0, 3.0)),
        ({"plan": {"mode": "exact"}}, Plan(mode="exact")),
    ],
)
def test_what_is_within_bounds_arrives(values, arrives):
    (key,) = values
    assert checked_parameters("policy", "bounded", Bounded, values)[key] == arrives


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rate": 0}, "policy.rate=0.0 (of 'bounded') is out of bounds; expected above 0"),
        ({"rate": math.nan}, "policy.rate=nan (of 'bounded') is out of bounds; expected above 0"),
        ({"count": 0}, "policy.count=0 (of 'bounded') is out of bounds; expected at least 1"),
        ({"share": 1.01}, "policy.share=1.01 (of 'bounded') is out of bounds; expected at least 0 and at most 1"),
        ({"share": -0.1}, "expected at least 0 and at most 1"),
        ({"seconds": -1}, "policy.seconds=-1.0 (of 'bounded') is out of bounds; expected above 0"),
        ({"mode": "exat"}, "policy.mode=exat (of 'bounded') expected one of fast, exact. Did you mean 'exact'?"),
        ({"turns": 3}, "policy.turns=3 (of 'bounded') expected one of 1, 2, 4."),
        ({"sizes": [1, 0]}, "is out of bounds; expected above 0"),
        ({"pair": [0, -1]}, "is out of bounds; expected at least 0"),
        (
            {"plan": {"budget": {"seconds": 0}}},
            "policy.plan.budget.seconds=0.0 (of 'bounded') is out of bounds; expected above 0",
        ),
        ({"plan": {"mode": "slow"}}, "policy.plan.mode=slow (of 'bounded') expected one of fast, exact."),
    ],
)
def test_what_is_out_of_bounds_is_refused_with_the_field_and_the_bounds(values, message):
    with pytest.raises(ConfigError) as refusal:
        checked_parameters("policy", "bounded", Bounded, values)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("task.num_envs=0", "task.num_envs=0 (of 'grasp') is out of bounds; expected at least 1"),
        ("task.signals=objct", "task.signals=objct (of 'grasp') expected one of object, hand. Did you mean 'object'?"),
        ("task.lift=-0.1", "task.lift=-0.1 (of 'grasp') is out of bounds; expected above 0"),
        ("pipeline.grasp.episodes=0", "pipeline.grasp.episodes=0 (of 'main') is out of bounds; expected at least 1"),
        ("policy=bounded policy.rate=0", "policy.rate=0.0 (of 'bounded') is out of bounds; expected above 0"),
        ("policy=bounded policy.budget.seconds=0", "policy.budget.seconds=0.0 (of 'bounded') is out of bounds"),
        ("policy=bounded policy.mode=exakt", "policy.mode=exakt (of 'bounded') expected one of fast, exact."),
    ],
)
def test_a_run_out_of_bounds_does_not_begin(install, tmp_path, monkeypatch, capsys, word, expected):
    from icub_testing.tiny import TINY

    points = {f"icub.{kind}": {"tiny": target} for kind, target in TINY.items()}
    points["icub.policy"]["bounded"] = "bounded_module:Bounded"
    install("bounded", points, {"bounded_module.py": MODULE})
    monkeypatch.chdir(tmp_path)
    assert main(["run", *WORLD, *word.split()]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_bounds_and_choices_are_shown(install, capsys):
    install("bounded", {"icub.policy": {"bounded": "bounded_module:Bounded"}}, {"bounded_module.py": MODULE})
    assert main(["plugins", "show", "policy", "bounded"]) == 0
    shown = capsys.readouterr().out
    assert "policy.rate: float above 0 = 0.5" in shown
    assert "policy.count: int at least 1 = 3" in shown
    assert "policy.share: float at least 0 and at most 1 = 0.25" in shown
    assert "policy.seconds: float | None above 0 = None" in shown
    assert "policy.mode: one of fast, exact = 'fast'" in shown
    assert main(["plugins", "show", "task", "grasp"]) == 0
    shown = capsys.readouterr().out
    assert "task.signals: one of object, hand = 'object'" in shown
    assert "task.num_envs: int at least 1 = 1" in shown


def test_a_default_out_of_its_own_bounds_is_noticed_when_the_plugin_is_used():
    class Wrong:
        def __init__(self, rate: Annotated[float, above(0)] = 0.0): ...

    with pytest.raises(ConfigError, match="out of bounds; expected above 0"):
        checked_parameters("policy", "wrong", Wrong, {})
