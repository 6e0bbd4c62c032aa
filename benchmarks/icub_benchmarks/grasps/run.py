"""Grasps put to the test: each in two engines, and by the scripted demonstrations.

    icub benchmark grasps
    icub benchmark grasps --only validate --poses 10 +grasp_generator=superquadrics
    icub benchmark grasps --only demonstrations --episodes 20

Choices as after `icub run` (`+grasp_generator=...`, `robot=...`, `objects=...`) decide what is tested.

`validate`: objects stand at random on the table; the generator's first grasp that the arm can carry out is closed,
lifted 10 cm, shaken and held, once in each engine, from the same arm motion (`icub_benchmarks.grasps.validate`).
`validate.success` is the share that every engine holds, `validate.agreement` the share on which all engines say the
same. `demonstrations`: the grasping task with the scripted policy, as in benchmarks/grasping.py, on seven objects.
Object poses without a plan are drawn anew and counted.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: the processes use the cores

import argparse
import logging
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn
from rich.table import Table

from icub_benchmarks.grasps.judging import Outcome, Pose, judge_poses
from icub_benchmarks.grasps.validate import Outcome
from icub_benchmarks.parallel import EnvRecipe, evaluate_in_workers
from icub_core.config.compose import compose
from icub_core.construct import build, split_config
from icub_core.evaluation.results import Figure, write_results
from icub_core.rollouts import merge, wilson_interval

RESULTS = Path(__file__).resolve().parent / "results" / "grasps.json"
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

Plugins = dict[str, dict[str, Any]]


def validate(options: argparse.Namespace, plugins: Plugins, bar: Progress) -> dict[str, Figure]:
    """Judge the first grasp for every object at several poses in every engine."""
    names = options.objects or build("objects", plugins["objects"]).names
    poses = [Pose(name, number, options.seed) for name in names for number in range(options.poses)]
    line = bar.add_task("grasps judged", total=len(poses))
    outcomes = judge_poses(
        poses, **plugins, engines=options.engines, workers=options.workers,
        progress=lambda over: bar.update(line, completed=over),
    )  # fmt: skip
    table = Table("object", "all engines", *options.engines, "agreement", "poses without plan", "outcomes")
    figures: dict[str, Figure] = {}
    everything: list[Outcome] = []
    for name in [*names, ""]:
        rows = [o for o, p in zip(outcomes, poses, strict=True) if o is not None and p.object_name == name]
        everything += rows
        rows = rows if name else everything
        figures |= (found := _figures(rows, options.engines, f".{name}" if name else ""))
        shown = [figure.value for figure in found.values()]
        counts = Counter(f"{e}: {v.name.lower()}" for o in rows for e, v in o.outcomes.items() if v != Outcome.HELD)
        table.add_row(
            name or "all", *(f"{v:.2f}" for v in shown), ", ".join(f"{n} {what}" for what, n in counts.items())
        )
    lost = sum(o is None for o in outcomes)
    figures["validate.lost"] = Figure(lost, "1", None, len(poses))
    bar.console.print(table)
    return figures


def _figures(outcomes: Sequence[Outcome], engines: Sequence[str], suffix: str) -> dict[str, Figure]:
    judged = [o.outcomes for o in outcomes if o.outcomes]

    def share(of: Callable[[dict[str, Outcome]], bool]) -> Figure:
        hits = sum(of(outcomes) for outcomes in judged)
        return Figure(hits / len(judged) if judged else 0.0, "1", wilson_interval(hits, len(judged)), len(judged))

    figures = {f"validate.success{suffix}": share(lambda v: all(v[e] == Outcome.HELD for e in engines))}
    for engine in engines:
        figures[f"validate.success.{engine}{suffix}"] = share(lambda v, e=engine: v[e] == Outcome.HELD)  # type: ignore[misc]
    figures[f"validate.agreement{suffix}"] = share(lambda v: len({v[e] == Outcome.HELD for e in engines}) == 1)
    resamples = sum(o.resamples for o in outcomes)
    poses = resamples + len(judged)
    figures[f"validate.poses_without_plan{suffix}"] = Figure(resamples / poses if poses else 0.0, "1", None, poses)
    return figures


def demonstrations(options: argparse.Namespace, plugins: Plugins, bar: Progress) -> dict[str, Figure]:
    """Run the scripted policy on seven objects, each alone on the table."""
    key = f"demonstrations.{plugins['grasp_generator']['plugin']}"
    figures: dict[str, Figure] = {}
    parts = []
    table = Table("object", "success", "95 % interval", "poses without plan", "ends")
    for name in options.objects or SEVEN:
        line = bar.add_task(f"demonstrations, {name}", total=1.0)
        recipe = EnvRecipe(
            (name,),
            object_set=plugins["objects"],
            robot=plugins["robot"],
            simulator=options.engines[0],
            generator=plugins["grasp_generator"],
        )
        results = evaluate_in_workers(
            recipe,
            "demonstrations",
            options.episodes,
            options.seed,
            workers=options.workers,
            progress=lambda share, _, line=line: bar.update(line, completed=share),  # type: ignore[misc]
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
            _write(options, {key: value for key, value in figures.items()})  # what is measured is not lost
    together = merge(parts)
    poses = together.resamples + len(together)
    mean = float(np.mean([part.success_rate for part in parts]))
    figures[key] = Figure(mean, "1", together.interval, len(together))
    figures[f"{key}.poses_without_plan"] = Figure(together.resamples / poses, "1", None, poses)
    bar.console.print(table)
    return figures


PARTS = {"validate": validate, "demonstrations": demonstrations}


def _write(options: argparse.Namespace, figures: dict[str, Figure]) -> None:
    write_results(options.results, command=options.command, seed=options.seed, figures=figures)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=sorted(PARTS), help="measure this part alone")
    parser.add_argument("--objects", nargs="+", help="objects instead of the part's own")
    parser.add_argument("--engines", nargs="+", default=["mujoco", "pybullet"])
    parser.add_argument("--poses", type=int, default=12, help="of each object, for validate")
    parser.add_argument("--episodes", type=int, default=100, help="of each object, for demonstrations")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    options, overrides = parser.parse_known_args(arguments)
    if unknown := [word for word in overrides if word.startswith("-")]:
        parser.error(f"unknown option {unknown[0]}")
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    config = compose(overrides)
    plugins: Plugins = {}
    for kind in ("robot", "objects", "grasp_generator"):
        name, parameters = split_config(kind, config[kind])
        plugins[kind] = {"plugin": name, **parameters}
    for name in [options.only] if options.only else list(PARTS):
        chosen = "".join(f" {word}" for word in overrides)
        sizes = f" --poses {options.poses}" if name == "validate" else f" --episodes {options.episodes}"
        objects = f" --objects {' '.join(options.objects)}" if options.objects else ""
        options.command = f"icub benchmark grasps --only {name}{sizes} --seed {options.seed}{objects}{chosen}"
        with Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:
            figures = PARTS[name](options, plugins, bar)
        _write(options, figures)
        for key, figure in figures.items():
            if key.count(".") < 2:
                Console().print(f"{key}: {figure.value:.4g} {figure.spread if figure.spread is not None else ''}")


if __name__ == "__main__":
    main()
