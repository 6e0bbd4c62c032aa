"""The main job, as a newcomer types it, for several seeds: figures of every stage and the wall time of the whole.

    icub benchmark main_job
    icub benchmark main_job --seeds 1

Means over the seeds; the spread is the standard deviation.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures

JOB = ("+segmenter=falkon", "+policy=resprect")
UNITS = {"seconds": "s", "frames": "1", "episodes": "1"}


def one_run(seed: int, folder: Path) -> dict[str, float]:
    """Run the main job in a process of its own and return its metrics, with the wall time of the process."""
    run_dir = folder / f"seed{seed}"
    command = [sys.executable, "-m", "icub_core.cli", "run", *JOB, f"seed={seed}", f"run_dir={run_dir}"]
    started = time.perf_counter()
    subprocess.run(command, check=True)
    metrics: dict[str, float] = json.loads((run_dir / "metrics.json").read_text())
    metrics["run.seconds"] = time.perf_counter() - started
    return metrics


def main(argv: Sequence[str]) -> None:
    """Run the main job for several seeds and write main_job.json."""
    parser = make_parser("main_job", __doc__)
    parser.add_argument("--seeds", type=int, default=3, help="number of runs, seeds 0, 1, ...")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        runs = [one_run(seed, Path(folder)) for seed in range(options.seeds)]
    figures = {}
    for key in runs[0]:
        values = [run[key] for run in runs if isinstance(run.get(key), (int, float))]
        if len(values) == len(runs):
            unit = UNITS.get(key.rpartition("_")[2].rpartition(".")[2], "1")
            spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
            figures[key] = Figure(float(np.mean(values)), unit, spread, len(values))
    write_figures(options.results / "main_job.json", figures, command=command_line("main_job", argv))
