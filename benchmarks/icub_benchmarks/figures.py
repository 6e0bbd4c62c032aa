"""The one form of every file in `benchmarks/results/`: figures with what is needed to get them again."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from icub_core.files import write_text_atomically
from icub_core.provenance import machine, versions


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes:
        value: Mean or median, as the key says.
        unit: SI unit, or ``"1"`` for shares and ratios.
        spread: Standard deviation, half interval or (low, high); None when measured once.
        n: Number of repetitions.
    """

    value: float
    unit: str
    spread: float | tuple[float, float] | None = None
    n: int = 1


def write_results(path: Path, *, command: str, seed: int, figures: Mapping[str, Figure]) -> None:
    """Write `figures` to a results file, keeping figures of other keys that are already there.

    The header (command, seed, date, versions, machine) describes the figures written last; a figure kept from an
    earlier run carries its own ``command`` and ``date``.

    Args:
        path: File in benchmarks/results.
        command: Line to type to measure again.
        seed: First seed used.
        figures: By key, such as ``sim.env_steps_per_s``.
    """
    old: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    kept = dict(old.get("figures", {}))
    for entry in kept.values():
        entry.setdefault("command", old["command"])
        entry.setdefault("date", old["date"])
    fresh = {key: asdict(figure) for key, figure in figures.items()}
    content = {
        "command": command,
        "seed": seed,
        "date": datetime.date.today().isoformat(),
        "versions": versions(),
        "machine": machine(),
        "figures": dict(sorted({**kept, **fresh}.items())),
    }
    write_text_atomically(path, json.dumps(content, indent=2) + "\n")
