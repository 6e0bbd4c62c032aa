"""Trials of grasps: planned grasps executed in two engines, and the scripted policy.

    icub benchmark grasps
    icub benchmark grasps --only validate --poses 10 +grasp_generator=superquadrics
    icub benchmark grasps --only demonstrations --episodes 20

Choices as after `icub run` (`+grasp_generator=...`, `robot=...`, `objects=...`) decide what is tested.

`validate`: objects stand at random on the table; the generator's first grasp that the arm can carry out is closed,
lifted 10 cm, shaken and held, once in each engine, from the same arm motion (`icub_benchmarks.grasps.validate`).
`validate.success` is the share that every engine holds, `validate.agreement` the share on which all engines agree.
`demonstrations`: the grasping task with the scripted policy, as in the benchmark `grasping`, on seven objects.
Object poses without a plan are drawn anew and counted.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: the processes use the cores

import argparse
import logging
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Table

import icub_core as icub
from icub_benchmarks.figures import Figure, write_results
from icub_benchmarks.grasps.engines import Pose, PoseResult, execute_poses
from icub_benchmarks.grasps.validate import Outcome
from icub_benchmarks.parallel import evaluate_in_workers
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_benchmarks.statistics import merge
from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.rollouts import wilson_interval

FILE = "grasps.json"
SEVEN = [
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "008_pudding_box",
    "010_potted_meat_can",
    "021_bleach_cleanser",
    "035_power_drill",
]
"""Objects of the thesis's grasping experiments."""


def validate(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Execute the first grasp for every object at several poses in every engine."""
    names = options.objects or Assembly(compose(options.overrides)).get("objects").names
    poses = [Pose(name, number, options.seed) for name in names for number in range(options.poses)]
    line = bar.add_task("grasps executed", total=len(poses))
    results = execute_poses(
        poses,
        overrides=options.overrides,
        engines=options.engines,
        workers=options.workers,
        progress=lambda over: bar.update(line, completed=over),
    )
    table = Table("object", "all engines", *options.engines, "agreement", "poses without plan", "outcomes")
    figures: dict[str, Figure] = {}
    everything: list[PoseResult] = []
    for name in [*names, ""]:
        rows = [r for r, p in zip(results, poses, strict=True) if r is not None and p.object_name == name]
        everything += rows
        rows = rows if name else everything
        figures |= (found := _figures(rows, options.engines, f".{name}" if name else ""))
        shown = [figure.value for figure in found.values()]
        counts = Counter(f"{e}: {o.name.lower()}" for r in rows for e, o in r.outcomes.items() if o != Outcome.HELD)
        table.add_row(
            name or "all", *(f"{v:.2f}" for v in shown), ", ".join(f"{n} {what}" for what, n in counts.items())
        )
    lost = sum(result is None for result in results)
    figures["validate.lost"] = Figure(lost, "1", None, len(poses))
    bar.console.print(table)
    return figures


def _figures(results: Sequence[PoseResult], engines: Sequence[str], suffix: str) -> dict[str, Figure]:
    executed = [result.outcomes for result in results if result.outcomes]

    def share(of: Callable[[dict[str, Outcome]], bool]) -> Figure:
        hits = sum(of(outcomes) for outcomes in executed)
        interval = wilson_interval(hits, len(executed))
        return Figure(hits / len(executed) if executed else 0.0, "1", interval, len(executed))

    def held_in(engine: str) -> Callable[[dict[str, Outcome]], bool]:
        return lambda outcomes: outcomes[engine] == Outcome.HELD

    figures = {f"validate.success{suffix}": share(lambda o: all(o[e] == Outcome.HELD for e in engines))}
    for engine in engines:
        figures[f"validate.success.{engine}{suffix}"] = share(held_in(engine))
    figures[f"validate.agreement{suffix}"] = share(lambda o: len({o[e] == Outcome.HELD for e in engines}) == 1)
    resamples = sum(result.resamples for result in results)
    poses = resamples + len(executed)
    figures[f"validate.poses_without_plan{suffix}"] = Figure(resamples / poses if poses else 0.0, "1", None, poses)
    return figures


def demonstrations(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Run the scripted policy on seven objects, each alone on the table."""
    overrides = [*options.overrides, f"simulator={options.engines[0]}"]
    key = f"demonstrations.{Assembly(compose(overrides)).chosen('grasp_generator')}"
    figures: dict[str, Figure] = {}
    parts = []
    table = Table("object", "success", "95 % interval", "poses without plan", "ends")
    for name in options.objects or SEVEN:
        results = evaluate_in_workers(
            partial(icub.make_env, "grasp", objects=[name], overrides=overrides),
            partial(icub.load, "policy", "demonstrations"),
            options.episodes,
            options.seed,
            workers=options.workers,
            progress=line_of(bar, f"demonstrations, {name}"),
        )
        parts.append(results)
        missed = results.resamples / (results.resamples + len(results))
        figures[f"{key}.{name}"] = Figure(results.success_rate, "1", results.interval, len(results))
        figures[f"{key}.poses_without_plan.{name}"] = Figure(missed, "1", None, results.resamples + len(results))
        low, high = results.interval
        table.add_row(
            name, f"{results.success_rate:.2f}", f"{low:.2f} to {high:.2f}", f"{missed:.2f}", str(results.ends())
        )
        if options.objects is None:
            # what is measured is not lost
            write_results(options.results / FILE, command=options.command, seed=options.seed, figures=figures)
    together = merge(parts)
    poses = together.resamples + len(together)
    mean = float(np.mean([part.success_rate for part in parts]))
    figures[key] = Figure(mean, "1", together.interval, len(together))
    figures[f"{key}.poses_without_plan"] = Figure(together.resamples / poses, "1", None, poses)
    bar.console.print(table)
    return figures


def line_of(bar: Progress, title: str) -> Callable[[float, str], None]:
    """Return a progress callback with a line of its own."""
    line = bar.add_task(title, total=1.0)
    return lambda share, text: bar.update(line, completed=share)


PARTS = {"validate": validate, "demonstrations": demonstrations}


def main(argv: Sequence[str]) -> None:
    """Measure, print and write grasps.json, part by part."""
    parser = make_parser("grasps", __doc__)
    parser.add_argument("--only", choices=sorted(PARTS), help="measure this part alone")
    parser.add_argument("--objects", nargs="+", help="objects instead of the part's own")
    parser.add_argument("--engines", nargs="+", default=["mujoco", "pybullet"])
    parser.add_argument("--poses", type=int, default=12, help="of each object, for validate")
    parser.add_argument("--episodes", type=int, default=100, help="of each object, for demonstrations")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=0)
    options, overrides = parser.parse_known_args(argv)
    options.overrides = overrides
    if unknown := [word for word in overrides if word.startswith("-")]:
        parser.error(f"unknown option {unknown[0]}")
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    for name in [options.only] if options.only else list(PARTS):
        options.command = command_line("grasps", [*argv, *([] if options.only else ["--only", name])])
        with Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:
            figures = PARTS[name](options, bar)
        for key, figure in figures.items():
            if key.count(".") < 2:
                Console().print(f"{key}: {figure.value:.4g} {figure.spread if figure.spread is not None else ''}")
        write_figures(options.results / FILE, figures, command=options.command, seed=options.seed)
