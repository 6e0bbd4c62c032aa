"""The grasp generator `vgn`: its times, and what the scripted grasp makes of its proposals beside `superquadrics`.

    python benchmarks/vgn.py
    python benchmarks/vgn.py --only network
    python benchmarks/vgn.py --only demonstrations --episodes 20 --generators superquadrics vgn

`network`: one volume through the network, one signed distance field, one whole proposal; one thread. `demonstrations`:
the scripted policy on the objects of `ycb_primitives`, each at random places. The starts are those poses that the
generator has a plan for; the share without one is stated.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch: times are those of one core

import argparse
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from icub_core import registry
from icub_core.data import PointCloud
from icub_core.errors import SimulationError
from icub_core.evaluation.results import Figure, write_results
from icub_core.grasping.env import GraspEnv
from icub_core.grasping.evaluation import EpisodeResults, evaluate, merge, wilson_interval
from icub_core.grasping.task import GraspTask
from icub_core.scene import Scene, Table
from icub_grasp_generators.synthetic_clouds import single_view
from icub_grasp_generators.vgn.network import VgnNetwork
from icub_grasp_generators.vgn.volume import Volume

RESULTS = Path(__file__).resolve().parent / "results" / "vgn.json"
OBJECTS = (
    "004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle", "008_pudding_box", "010_potted_meat_can",
    "021_bleach_cleanser", "003_cracker_box",
)  # fmt: skip
GENERATORS = ("superquadrics", "vgn", "vgn:parallel_jaw")
EYE = np.array([0.35, 0.0, 1.5])
TEST_SEED = 2_000


def milliseconds(call: Callable[[], object], repetitions: int) -> Figure:
    """Return the median time of a call and its median absolute deviation, after one call that does not count."""
    call()
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    median = float(np.median(times))
    return Figure(median, "ms", float(np.median(np.abs(np.array(times) - median))), repetitions)


def network(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure times."""
    torch.set_num_threads(1)
    view = single_view("box", np.random.default_rng(options.seed), outliers=0.0)
    cloud = PointCloud(view.points - [0.35, 0.0, 0.0], viewpoint=EYE)
    top = Table().top
    volume = Volume.around(cloud.points.mean(axis=0), top)
    tsdf = torch.from_numpy(volume.tsdf((cloud,)))[None, None]
    net = VgnNetwork().eval()
    robot, generator = registry.build("robot", "icub"), registry.build("grasp_generator", "vgn")
    line = bar.add_task("times", total=3)

    def forward() -> None:
        with torch.inference_mode():
            net(tsdf)

    figures = {"vgn.network_ms": milliseconds(forward, options.repetitions)}
    bar.advance(line)
    figures["vgn.tsdf_ms"] = milliseconds(lambda: volume.tsdf((cloud,)), options.repetitions)
    bar.advance(line)
    figures["vgn.propose_ms"] = milliseconds(lambda: generator.propose(cloud, robot, Table()), options.repetitions)
    bar.advance(line)
    return figures


def built(generator: str) -> object:
    """Build ``NAME`` or ``NAME:WEIGHTS``."""
    name, _, weights = generator.partition(":")
    return registry.build("grasp_generator", {"plugin": name, **({"weights": weights} if weights else {})})


def demonstrations(options: argparse.Namespace, bar: Progress) -> dict[str, Figure]:
    """Measure the scripted grasp with each generator on each object."""
    robot, objects = registry.build("robot", "icub"), registry.build("objects", "ycb_primitives")
    policy = registry.build("policy", "demonstrations")
    figures: dict[str, Figure] = {}
    for generator in options.generators:
        everything: list[EpisodeResults] = []
        redraws = 0
        for name in options.objects:
            tasks = []
            for world in range(options.worlds):
                simulator = registry.build("simulator", "mujoco")
                simulator.load(robot.description, Scene(objects=(objects.get(name),)))
                tasks.append(GraspTask(simulator, robot, built(generator), [name], seed=world))
            env = GraspEnv(tasks)
            line = bar.add_task(f"{generator}, {name}", total=1.0)
            try:
                results = evaluate(
                    policy,
                    env,
                    options.episodes,
                    TEST_SEED + options.seed,
                    progress=lambda share, text, line=line: bar.update(line, completed=share),  # type: ignore[misc]
                )
            except SimulationError as error:  # no plan in a hundred poses: counts as never grasped
                logging.getLogger(__name__).warning("%s", error)
                figures[f"demonstrations.{generator}.{name}"] = Figure(0.0, "1", wilson_interval(0, 100), 0)
                continue
            finally:
                env.close()
            everything.append(results)
            redraws += results.redraws
            figures[f"demonstrations.{generator}.{name}"] = Figure(
                results.success_rate, "1", results.interval, len(results)
            )
        rates = [figures[f"demonstrations.{generator}.{name}"].value for name in options.objects]
        count = sum(map(len, everything))
        interval = merge(everything).interval if everything else None
        figures[f"demonstrations.{generator}"] = Figure(float(np.mean(rates)), "1", interval, count)
        figures[f"demonstrations.{generator}.poses_without_plan"] = Figure(
            redraws / max(redraws + count, 1), "1", None, redraws + count
        )
    return figures


PARTS = {"network": network, "demonstrations": demonstrations}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=sorted(PARTS), help="measure this part alone")
    parser.add_argument("--objects", nargs="+", default=list(OBJECTS))
    parser.add_argument("--generators", nargs="+", default=list(GENERATORS), help="NAME or NAME:WEIGHTS")
    parser.add_argument("--episodes", type=int, default=100, help="of each object")
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--repetitions", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    for name in PARTS if options.only is None else [options.only]:
        with Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:
            figures = PARTS[name](options, bar)
        command = f"icub benchmark vgn --only {name}"
        if name == "demonstrations":
            command += f" --episodes {options.episodes} --generators {' '.join(options.generators)}"
        write_results(options.results, command=command, seed=options.seed, figures=figures)
        for key, figure in figures.items():
            Console().print(f"{key}: {figure.value:.4g} {figure.spread if figure.spread is not None else ''}")


if __name__ == "__main__":
    main()
