"""Times of the grasp generator `vgn`: one volume through its network, one signed distance field, 300 hand poses
through the grasp-quality classifier, one proposal.

    icub benchmark vgn
    icub benchmark vgn --repetitions 100

Medians of wall times on one thread, after one call that does not count; the spread is the median absolute deviation.
The cloud is a box of random size on the table, seen once. How good the proposals are is measured by
`icub benchmark grasps +grasp_generator=vgn`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before torch: times are those of one core

import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from rich.console import Console
from rich.progress import track

import icub_core as icub
from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_core.data import PointCloud
from icub_core.scene import Table
from icub_grasp_generators.synthetic_clouds import single_view
from icub_grasp_generators.vgn.hand_search import MAX_SCORED, around
from icub_grasp_generators.vgn.network import load_network
from icub_grasp_generators.vgn.volume import Volume

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


def main(argv: Sequence[str]) -> None:
    """Measure, print and write vgn.json."""
    parser = make_parser("vgn", __doc__)
    parser.add_argument("--repetitions", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0, help="of the box")
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    box = single_view("box", np.random.default_rng(options.seed), count=3000, outliers=0.0)
    cloud = PointCloud(box.points + PLACE, viewpoint=EYE)
    table = Table()
    volume = Volume.around(box.center + PLACE, table.top)
    tsdf = torch.from_numpy(volume.tsdf((cloud,)))[None, None]
    network, _, classifier = load_network("icub_hand")
    assert classifier is not None  # the shipped file has one
    view, poses = volume.range_view(cloud), around(cloud.points[::50], cloud)[:MAX_SCORED]
    robot, generator = icub.load("robot", "icub"), icub.load("grasp_generator", "vgn")

    def forward() -> None:
        with torch.inference_mode():
            network(tsdf)

    calls: dict[str, Callable[[], object]] = {
        "vgn.network_ms": forward,
        "vgn.tsdf_ms": lambda: volume.tsdf((cloud,)),
        "vgn.judge_ms": lambda: classifier.score(view, poses, box.center + PLACE, table.top),
        "vgn.propose_ms": lambda: generator.propose(cloud, robot, table),
    }
    figures = {key: milliseconds(call, options.repetitions, key) for key, call in calls.items()}
    for key, figure in figures.items():
        Console().print(f"{key}: {figure.value:.3g} +- {figure.spread:.2g} {figure.unit}")
    write_figures(options.results / "vgn.json", figures, command=command_line("vgn", argv), seed=options.seed)
