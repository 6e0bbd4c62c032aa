"""The command line and the results folder that all benchmarks share."""

from __future__ import annotations

import argparse
import shlex
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from icub_benchmarks.figures import Figure, write_results

RUNS = Path("runs/benchmark")
"""Folder of the runs, below the folder in which the command is typed."""


def make_parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the option ``--results FOLDER``, by default a new folder of this benchmark in `RUNS`.

    Args:
        name: Of the benchmark, as typed after ``icub benchmark``.
        description: Shown by ``--help``, line by line as it stands.
    """
    parser = argparse.ArgumentParser(
        prog=f"icub benchmark {name}",
        description=description,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--results",
        type=_folder,
        metavar="FOLDER",
        default=RUNS / name / time.strftime("%Y-%m-%d_%H-%M-%S"),
        help=f"folder of the results files; figures of other runs in them are kept (default: {RUNS / name}/DATE_TIME)",
    )
    return parser


def work_folder(name: str) -> Path:
    """Return the folder in which a benchmark that can be resumed keeps its finished parts."""
    return RUNS / name / "work"


def command_line(name: str, argv: Sequence[str]) -> str:
    """Return the line that measures the same again; where its results are written is left out."""
    words, skip = [], False
    for word in argv:
        if not skip and word != "--results" and not word.startswith("--results="):
            words.append(word)
        skip = word == "--results"
    return shlex.join(["icub", "benchmark", name, *words])


def write_figures(path: Path, figures: Mapping[str, Figure], *, command: str, seed: int = 0) -> None:
    """Write figures to a results file, keeping the file's figures of other keys, and say where they are."""
    write_results(path, command=command, seed=seed, figures=figures)
    print(f"written: {path}")


def _folder(text: str) -> Path:
    path = Path(text)
    if path.suffix == ".json" or path.is_file():
        raise argparse.ArgumentTypeError(f"'{text}' is a file; expected a folder, such as {path.parent}")
    return path
