"""Success of the grasping policies on poses planned from the camera's cloud.

    icub benchmark grasping
    icub benchmark grasping --only resprect --objects 003_cracker_box --seconds 150 --learning-seeds 0
    icub benchmark grasping --only resprect --env-steps 28000            # the same on a slow or busy machine

`demonstrations`: the scripted policy on sugar box, mustard bottle and potted meat can. `base`: the shipped base policy
on every object. `resprect`: that policy and what RESPRECT makes of it within its budget, on the same test starts, which
neither learning nor the choice of the best residual has seen.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch: the networks are small, the worlds use the cores

import argparse
import dataclasses
import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

import icub_core as icub
from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, work_folder, write_figures
from icub_benchmarks.statistics import merge, paired_gain
from icub_core.files import write_text_atomically
from icub_core.interfaces.abilities import Learns
from icub_core.interfaces.policy import LearnReport, Policy
from icub_core.interfaces.task import Start, Task
from icub_core.rollouts import EpisodeResults, run_episodes

EASY = ["004_sugar_box", "006_mustard_bottle", "010_potted_meat_can"]
HARD = ["003_cracker_box", "021_bleach_cleanser", "035_power_drill"]
"""Objects on which the shipped base policy stays under 0.9: see `base`."""
TEST_SEED = 1_000
STARTS = 16
"""Planned starts that each world keeps while a policy learns."""
BASE = "base_gpayn"
LEARNING_SEEDS = [0, 1, 2]


def make_task(name: str, options: argparse.Namespace, seed: int) -> Task:
    """Return worlds with one object each."""
    return icub.make_env(
        "grasp", objects=[name], num_envs=options.worlds, starts=STARTS, threads=options.threads, seed=seed
    )


class Tests:
    """Test starts of one task, planned once, each from its own image."""

    def __init__(self, task: Task, episodes: int, bar: Progress) -> None:
        self._task, self._episodes, self._bar = task, episodes, bar
        before = task.resamples
        self._starts: list[Start] = []
        for episode in bar.track(range(episodes), description=f"plans for {task.objects[0]}"):
            rng = np.random.default_rng([TEST_SEED, episode])
            self._starts.append(task.draw(episode % task.batch_size[0], rng))
        self.resamples = task.resamples - before

    def __call__(self, policy: Policy, title: str) -> EpisodeResults:
        """Evaluate a policy on all of them."""
        starts = self._starts
        return run_episodes(
            policy,
            self._task,
            self._episodes,
            lambda world, episode: starts[episode],
            progress=line_of(self._bar, title),
        )


def line_of(bar: Progress, title: str) -> Callable[[float, str], None]:
    """Return a progress callback with a line of its own."""
    line = bar.add_task(title, total=1.0)
    return lambda share, text: bar.update(line, completed=share, description=f"{title}: {text}")


def rate(results: EpisodeResults) -> Figure:
    """Return a success rate with its 95 % Wilson interval."""
    return Figure(results.success_rate, "1", results.interval, len(results))


def demonstrations(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure the scripted policy on the easy objects."""
    figures, everything, resamples = {}, [], 0
    for name in options.objects or EASY:
        task = make_task(name, options, options.seed)
        tests = Tests(task, options.episodes, bar)
        results = tests(icub.load("policy", "demonstrations"), f"demonstrations, {name}")
        figures[f"demonstrations.success_rate.{name}"] = rate(results)
        everything.append(results)
        resamples += tests.resamples
        task.close()
    together = merge(everything)
    figures["demonstrations.success_rate"] = rate(together)
    poses = resamples + len(together)
    figures["demonstrations.poses_without_plan"] = Figure(resamples / poses, "1", None, poses)
    return figures


def base(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure the shipped base policy on every object: where it stays under 0.9 there is something to gain."""
    figures = {}
    for name in options.objects or icub.load("objects", "ycb_primitives").names:
        task = make_task(name, options, options.seed)
        tests = Tests(task, options.episodes, bar)
        policy = icub.load("policy", "gpayn", weights=BASE)
        figures[f"base.success_rate.{name}"] = rate(tests(policy, f"base, {name}"))
        task.close()
    return figures


def resprect(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure base policy and RESPRECT, learned with each seed, on the same starts of each hard object."""
    figures: dict[str, Figure] = {}
    before: list[EpisodeResults] = []
    after: list[EpisodeResults] = []
    for name in options.objects or HARD:
        gains = []
        for seed in options.learning_seeds:
            outcome = learn_and_test(name, seed, options, bar)
            frozen, learned, report = outcome.frozen, outcome.learned, outcome.report
            before.append(frozen)
            after.append(learned)
            gain, interval = paired_gain(learned, frozen)
            gains.append(gain)
            figures |= {
                f"resprect.success_rate.{name}.seed{seed}": rate(learned),
                f"resprect.gain.{name}.seed{seed}": Figure(gain, "1", interval, len(frozen)),
                f"resprect.learn_seconds.{name}.seed{seed}": Figure(report.seconds, "s"),
                f"resprect.learn_env_steps.{name}.seed{seed}": Figure(report.env_steps, "1"),
                f"resprect.learn_updates.{name}.seed{seed}": Figure(report.updates, "1"),
            }
            bar.console.print(f"{name}, seed {seed}: {frozen.success_rate:.2f} to {learned.success_rate:.2f}")
        spread = float(np.std(gains, ddof=1)) if len(gains) > 1 else None
        figures[f"resprect.base_success_rate.{name}"] = rate(before[-1])
        figures[f"resprect.gain.{name}"] = Figure(float(np.mean(gains)), "1", spread, len(gains))
    gain, interval = paired_gain(merge(after), merge(before))
    figures["resprect.gain"] = Figure(gain, "1", interval, sum(map(len, before)))
    figures["resprect.base_success_rate"], figures["resprect.success_rate"] = rate(merge(before)), rate(merge(after))
    return figures


@dataclass(frozen=True)
class Outcome:
    """Of one learning: episodes of the frozen base and of what was learned, on the same starts."""

    frozen: EpisodeResults
    learned: EpisodeResults
    report: LearnReport

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        parts = {name: dataclasses.asdict(getattr(self, name)) for name in ("frozen", "learned", "report")}
        write_text_atomically(path, json.dumps(parts, default=lambda array: array.tolist()))

    @classmethod
    def read(cls, path: Path) -> Outcome:
        """Read what `write` wrote."""
        parts = json.loads(path.read_text())
        return cls(_results(parts["frozen"]), _results(parts["learned"]), LearnReport(**parts["report"]))


def _results(content: dict[str, Any]) -> EpisodeResults:
    arrays = {name: np.array(content[name]) for name in ("success", "returns", "steps", "reasons")}
    names: dict[str, Any] = {name: tuple(content[name]) for name in ("objects", "reason_names") if name in content}
    return EpisodeResults(**(content | arrays | names))


def learn_and_test(name: str, seed: int, options: argparse.Namespace, bar: Progress) -> Outcome:
    """Learn one object with one seed and test; an interrupted learning is resumed, a finished one is read."""
    spent = f"{options.seconds:g}s" if options.env_steps is None else f"{options.env_steps}steps"
    folder = options.work / f"{name}_{spent}_seed{seed}"
    path = folder / f"outcome_{options.episodes}.json"
    if path.exists():
        return Outcome.read(path)
    task = make_task(name, options, seed)
    seconds = options.seconds if options.env_steps is None else None
    budget = {"seconds": seconds, "env_steps": options.env_steps, "seed": seed}
    policy: Policy = icub.load("policy", "resprect", base=BASE, **budget)
    assert isinstance(policy, Learns)
    folder.mkdir(parents=True, exist_ok=True)
    report = policy.learn(task, folder, line_of(bar, f"resprect learns {name}, seed {seed}"))
    tests = Tests(task, options.episodes, bar)
    frozen = tests(icub.load("policy", "gpayn", weights=BASE), f"base, {name}")
    outcome = Outcome(frozen, tests(policy, f"resprect, {name}, seed {seed}"), report)
    task.close()
    outcome.write(path)
    return outcome


PARTS = {"demonstrations": demonstrations, "base": base, "resprect": resprect}


def main(argv: Sequence[str]) -> None:
    """Measure, print and write grasping.json, part by part."""
    parser = make_parser("grasping", __doc__)
    parser.add_argument("--only", choices=sorted(PARTS), help="measure this part alone")
    parser.add_argument("--objects", nargs="+", help="YCB objects instead of the part's own")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=150.0, help="wall-clock budget of resprect")
    parser.add_argument("--env-steps", type=int, help="budget of resprect in control steps instead: repeatable")
    parser.add_argument("--learning-seeds", type=int, nargs="+", default=LEARNING_SEEDS, help="of resprect")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--work", type=Path, default=work_folder("grasping"), help="folder of the learnings; interrupted ones resume"
    )
    options = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    for name in PARTS if options.only is None else [options.only]:
        with Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:
            figures = PARTS[name](options, bar)
        for key, figure in figures.items():
            Console().print(f"{key}: {figure.value:.4g} {figure.spread if figure.spread is not None else ''}")
        part = [] if options.only else ["--only", name]
        command = command_line("grasping", [*argv, *part])
        write_figures(options.results / "grasping.json", figures, command=command, seed=options.seed)
