"""Success of the grasping policies on poses planned from the camera's cloud.

    python benchmarks/grasping.py
    python benchmarks/grasping.py --only resprect --objects 003_cracker_box --seconds 150 --learning-seeds 0
    python benchmarks/grasping.py --only resprect --env-steps 28000      # the same on a slow or busy machine

`demonstrations`: the scripted teacher on sugar box, mustard bottle and potted meat can. `base`: the shipped base policy
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

import numpy as np
from icub_tasks.grasping.env import GraspEnv
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from icub_core.construct import build
from icub_core.evaluation.results import Figure, write_results
from icub_core.files import write_text_atomically
from icub_core.interfaces.policy import LearnReport, Policy
from icub_core.rollouts import EpisodeResults, merge, paired_gain, run_episodes
from icub_core.scene import Scene
from icub_tasks.grasping.task import GraspTask, StartState

RESULTS = Path(__file__).resolve().parent / "results" / "grasping.json"
EASY = ["004_sugar_box", "006_mustard_bottle", "010_potted_meat_can"]
WORK = Path("runs/benchmarks/grasping")
HARD = ["003_cracker_box", "021_bleach_cleanser", "035_power_drill"]
"""Objects on which the shipped base policy stays under 0.9: see `base`."""
TEST_SEED = 1_000
BASE = "base_gpayn"
LEARNING_SEEDS = [0, 1, 2]


def build_env(name: str, worlds: int, threads: int, seed: int) -> GraspEnv:
    """Return worlds with one YCB object each."""
    robot = build("robot", "icub")
    generator = build("grasp_generator", "superquadrics")
    spec = build("objects", "ycb_primitives").get(name)
    tasks = []
    for world in range(worlds):
        simulator = build("simulator", "mujoco")
        simulator.load(robot.description, Scene(objects=(spec,)))
        tasks.append(GraspTask(simulator, robot, generator, [name], seed=seed + world))
    return GraspEnv(tasks, pool_size=16, threads=threads, seed=seed)


class Tests:
    """Test starts of one environment, planned once, each from its own image."""

    def __init__(self, env: GraspEnv, episodes: int, bar: Progress) -> None:
        self._env, self._episodes, self._bar = env, episodes, bar
        tasks = env.batch.tasks
        before = sum(sum(task.plan_failures.values()) for task in tasks)
        self._starts: list[StartState] = []
        name = tasks[0].objects[0]
        for episode in bar.track(range(episodes), description=f"plans for {name}"):
            rng = np.random.default_rng([TEST_SEED, episode])
            self._starts.append(tasks[episode % len(tasks)].prepare(rng))
        self.resamples = sum(sum(task.plan_failures.values()) for task in tasks) - before

    def __call__(self, policy: Policy, title: str) -> EpisodeResults:
        """Evaluate a policy on all of them."""
        starts = self._starts
        return run_episodes(
            policy,
            self._env,
            self._episodes,
            lambda world, episode: starts[episode],
            progress=shown_in(self._bar, title),
        )


def shown_in(bar: Progress, title: str) -> Callable[[float, str], None]:
    """Return a progress callback with a line of its own."""
    line = bar.add_task(title, total=1.0)
    return lambda share, text: bar.update(line, completed=share, description=f"{title}: {text}")


def rate(results: EpisodeResults) -> Figure:
    """Return a success rate with its 95 % Wilson interval."""
    return Figure(results.success_rate, "1", results.interval, len(results))


def demonstrations(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure the scripted teacher on the easy objects."""
    figures, everything, resamples = {}, [], 0
    for name in options.objects or EASY:
        env = build_env(name, options.worlds, options.threads, options.seed)
        tests = Tests(env, options.episodes, bar)
        results = tests(build("policy", "demonstrations"), f"demonstrations, {name}")
        figures[f"demonstrations.success_rate.{name}"] = rate(results)
        everything.append(results)
        resamples += tests.resamples
        env.close()
    together = merge(everything)
    figures["demonstrations.success_rate"] = rate(together)
    poses = resamples + len(together)
    figures["demonstrations.poses_without_plan"] = Figure(resamples / poses, "1", None, poses)
    return figures


def base(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure the shipped base policy on every object: where it stays under 0.9 there is something to gain."""
    figures = {}
    for name in options.objects or build("objects", "ycb_primitives").names:
        env = build_env(name, options.worlds, options.threads, options.seed)
        tests = Tests(env, options.episodes, bar)
        policy = build("policy", {"plugin": "gpayn", "weights": BASE})
        figures[f"base.success_rate.{name}"] = rate(tests(policy, f"base, {name}"))
        env.close()
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
        """Keep it as JSON."""
        parts = {name: dataclasses.asdict(getattr(self, name)) for name in ("frozen", "learned", "report")}
        write_text_atomically(path, json.dumps(parts, default=lambda array: array.tolist()))

    @classmethod
    def read(cls, path: Path) -> Outcome:
        """Take back what `write` kept."""
        parts = json.loads(path.read_text())
        results = [_results(**parts[name]) for name in ("frozen", "learned")]
        return cls(results[0], results[1], LearnReport(**parts["report"]))


def _results(
    success: list[bool], returns: list[float], steps: list[int], reasons: list[int], objects: list[str], resamples: int
) -> EpisodeResults:
    return EpisodeResults(
        np.array(success), np.array(returns), np.array(steps), np.array(reasons), tuple(objects), resamples
    )


def learn_and_test(name: str, seed: int, options: argparse.Namespace, bar: Progress) -> Outcome:
    """Learn one object with one seed and test; a learning that was interrupted goes on, a finished one is read."""
    spent = f"{options.seconds:g}s" if options.env_steps is None else f"{options.env_steps}steps"
    folder = options.work / f"{name}_{spent}_seed{seed}"
    path = folder / f"outcome_{options.episodes}.json"
    if path.exists():
        return Outcome.read(path)
    env = build_env(name, options.worlds, options.threads, seed)
    seconds = options.seconds if options.env_steps is None else None
    budget = {"seconds": seconds, "env_steps": options.env_steps, "seed": seed}
    policy = build("policy", {"plugin": "resprect", "base": BASE, **budget})
    folder.mkdir(parents=True, exist_ok=True)
    report = policy.learn(env, folder, shown_in(bar, f"resprect learns {name}, seed {seed}"))
    tests = Tests(env, options.episodes, bar)
    frozen = tests(build("policy", {"plugin": "gpayn", "weights": BASE}), f"base, {name}")
    outcome = Outcome(frozen, tests(policy, f"resprect, {name}, seed {seed}"), report)
    env.close()
    outcome.write(path)
    return outcome


PARTS = {"demonstrations": demonstrations, "base": base, "resprect": resprect}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=sorted(PARTS), help="measure this part alone")
    parser.add_argument("--objects", nargs="+", help="YCB objects instead of the part's own")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=150.0, help="wall-clock budget of resprect")
    parser.add_argument("--env-steps", type=int, help="budget of resprect in control steps instead: repeatable")
    parser.add_argument("--learning-seeds", type=int, nargs="+", default=LEARNING_SEEDS, help="of resprect")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=WORK, help="folder of the learnings; interrupted ones go on there")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    command = "python benchmarks/grasping.py"
    for name in PARTS if options.only is None else [options.only]:
        with Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:
            figures = PARTS[name](options, bar)
        objects = f" --objects {' '.join(options.objects)}" if options.objects else ""
        objects += f" --env-steps {options.env_steps}" if options.env_steps is not None else ""
        if options.learning_seeds != LEARNING_SEEDS:
            objects += f" --learning-seeds {' '.join(map(str, options.learning_seeds))}"
        write_results(
            options.results, command=f"{command} --only {name}{objects}", seed=options.seed, figures=figures
        )  # fmt: skip
        for key, figure in figures.items():
            Console().print(f"{key}: {figure.value:.4g} {figure.spread if figure.spread is not None else ''}")


if __name__ == "__main__":
    main()
