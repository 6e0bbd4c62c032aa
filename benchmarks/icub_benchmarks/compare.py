"""Two results compared figure by figure: what is measured in both, and is not the same.

    icub benchmark compare benchmarks/results runs/benchmark/heads/2026-01-31_12-00-00
    icub benchmark compare before/heads.json after/heads.json

A and B are results files or folders of them, of which those with the same name are compared. Figures in seconds, or in
something per second, are listed when B is more than a fifth slower; all others when their values differ at all, even
ratios of times. Returns 1 when something is listed.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from icub_core.errors import DataError

TIMES, RATES = ("s", "ms", "us"), ("1/s", "Gflop/s")
"""Units in which less is better, and in which more is."""
MAX_SLOWDOWN = 0.2

Figures = dict[str, dict[str, Any]]


def main(argv: Sequence[str]) -> int:
    """Print what differs; returns 1 when something does."""
    parser = argparse.ArgumentParser(
        prog="icub benchmark compare", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", metavar="A", type=Path)
    parser.add_argument("second", metavar="B", type=Path)
    options = parser.parse_args(argv)
    table = Table(Column("figure", overflow="fold"), "A", "B", "unit", "difference")
    both = same = 0
    for first, second in pairs(options.first, options.second):
        a, b = figures_of(first), figures_of(second)
        both += len(a.keys() & b.keys())
        for key in sorted(a.keys() & b.keys()):
            difference = compare(a[key], b[key])
            same += difference is None
            if difference is not None:
                table.add_row(key, f"{a[key]['value']:.6g}", f"{b[key]['value']:.6g}", a[key]["unit"], difference)
    if table.row_count:
        Console().print(table)
    print(f"{same} of {both} figures that both have are the same (times: not more than {MAX_SLOWDOWN:.0%} slower)")
    return int(same < both)


def pairs(first: Path, second: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the files to compare; DataError when there is nothing."""
    if first.is_file() and second.is_file():
        yield first, second
        return
    for path in (first, second):
        if not path.is_dir():
            raise DataError(f"{path} is not there, or not of the other's kind; expected two files or two folders")
    names = sorted({path.name for path in first.glob("*.json")} & {path.name for path in second.glob("*.json")})
    if not names:
        raise DataError(f"no results file has the same name in {first} and {second}")
    for name in names:
        yield first / name, second / name


def figures_of(path: Path) -> Figures:
    """Return the figures of a results file by key; DataError for any other file."""
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))["figures"]
        return {
            str(key): {"value": float(f["value"]), "unit": str(f["unit"]), "n": f["n"]} for key, f in figures.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as cause:
        raise DataError(f"{path} is no results file; expected JSON with figures, as a benchmark writes") from cause


def compare(a: Mapping[str, Any], b: Mapping[str, Any]) -> str | None:
    """Return how the second figure differs from the first, or None where it counts as the same."""
    if a["unit"] != b["unit"]:
        return f"unit {b['unit']}"
    x, y = a["value"], b["value"]
    if a["unit"] in (*TIMES, *RATES):
        slower = y / x if a["unit"] in TIMES else x / y
        return f"{slower - 1:.0%} slower" if slower > 1 + MAX_SLOWDOWN else None
    if x != y and not (math.isnan(x) and math.isnan(y)):
        return f"{y - x:+.3g}"
    return None if a["n"] == b["n"] else f"n {a['n']}, {b['n']}"
