"""What the grasp generator `vgn` takes: one volume through its network, one signed distance field, 300 hand poses
through their judge, one proposal.

    icub benchmark vgn
    icub benchmark vgn --repetitions 100

Medians of wall times on one thread, after one call that does not count; the spread is the median absolute deviation.
The cloud is a box of random size on the table, seen once. How good the proposals are is measured by
`icub benchmark grasps +grasp_generator=vgn`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch: times are those of one core

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.progress import track

from icub_core.construct import build
from icub_core.data import PointCloud
from icub_core.evaluation.results import Figure, write_results
from icub_core.scene import Table
from icub_grasp_generators.synthetic_clouds import single_view
from icub_grasp_generators.vgn.hand_search import MAX_JUDGED, around
from icub_grasp_generators.vgn.network import load_network
from icub_grasp_generators.vgn.volume import Volume

RESULTS = Path(__file__).resolve().parent / "results" / "vgn.json"
PLACE, EYE = np.array([-0.35, 0.0, 0.0]), np.array([0.0, 0.0, 1.45])


def milliseconds(call: Callable[[], object], repetitions: int, label: str) -> Figure:
    """Return the median time of a call."""
    call()
    times = []
    for _ in track(range(repetitions), description=label, transient=True):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    median = float(np.median(times))
    return Figure(median, "ms", float(np.median(np.abs(np.array(times) - median))), repetitions)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0, help="of the box")
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    box = single_view("box", np.random.default_rng(options.seed), count=3000, outliers=0.0)
    cloud = PointCloud(box.points + PLACE, viewpoint=EYE)
    table = Table()
    volume = Volume.around(box.center + PLACE, table.top)
    tsdf = torch.from_numpy(volume.tsdf((cloud,)))[None, None]
    network, _, judge = load_network("icub_hand")
    assert judge is not None  # the shipped file has one
    view, poses = volume.range_view(cloud), around(cloud.points[::50], cloud)[:MAX_JUDGED]
    robot, generator = build("robot", "icub"), build("grasp_generator", "vgn")

    def forward() -> None:
        with torch.inference_mode():
            network(tsdf)

    calls: dict[str, Callable[[], object]] = {
        "vgn.network_ms": forward,
        "vgn.tsdf_ms": lambda: volume.tsdf((cloud,)),
        "vgn.judge_ms": lambda: judge.judge(view, poses, box.center + PLACE, table.top),
        "vgn.propose_ms": lambda: generator.propose(cloud, robot, table),
    }
    figures = {key: milliseconds(call, options.repetitions, key) for key, call in calls.items()}
    command = f"icub benchmark vgn --repetitions {options.repetitions}"
    write_results(options.results, command=command, seed=options.seed, figures=figures)
    for key, figure in figures.items():
        Console().print(f"{key}: {figure.value:.3g} +- {figure.spread:.2g} {figure.unit}")


if __name__ == "__main__":
    main()
