"""How long the command line takes to answer, as whole processes: python benchmarks/cli.py."""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path

from icub_core.evaluation.results import Figure, write_results

RESULTS = Path(__file__).resolve().parent / "results" / "cli.json"
COMMANDS = {"cli.help_s": ["--help"], "cli.plugins_list_s": ["plugins", "list"]}


def seconds(words: list[str]) -> float:
    """Return the wall time of one process, start of the interpreter included."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "icub_core.cli", *words], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    """Measure, print and write benchmarks/results/cli.json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=20)
    repetitions = parser.parse_args().repetitions
    figures = {}
    for key, words in COMMANDS.items():
        seconds(words)  # the first one reads files from the disk
        times = sorted(seconds(words) for _ in range(repetitions))
        median = statistics.median(times)
        figures[key] = Figure(median, "s", (times[0], times[-1]), repetitions)
        print(f"{key}: median {median:.3f} s, {times[0]:.3f} to {times[-1]:.3f} s")
    write_results(RESULTS, command="python benchmarks/cli.py", seed=0, figures=figures)


if __name__ == "__main__":
    main()
