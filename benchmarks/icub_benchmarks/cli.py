"""Time in which the command line answers, as whole processes.

    icub benchmark cli
    icub benchmark cli --repetitions 5

The first call of each command, which reads files from the disk, does not count.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Sequence

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures

COMMANDS = {"cli.help_s": ["--help"], "cli.plugins_list_s": ["plugins", "list"]}


def seconds(words: list[str]) -> float:
    """Return the wall time of one process, start of the interpreter included."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "icub_core.cli", *words], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main(argv: Sequence[str]) -> None:
    """Measure, print and write cli.json."""
    parser = make_parser("cli", __doc__)
    parser.add_argument("--repetitions", type=int, default=20)
    options = parser.parse_args(argv)
    figures = {}
    for key, words in COMMANDS.items():
        seconds(words)
        times = sorted(seconds(words) for _ in range(options.repetitions))
        median = statistics.median(times)
        figures[key] = Figure(median, "s", (times[0], times[-1]), options.repetitions)
        print(f"{key}: median {median:.3f} s, {times[0]:.3f} to {times[-1]:.3f} s")
    write_figures(options.results / "cli.json", figures, command=command_line("cli", argv))
