"""Fill a folder with files of grasp trials: one a batch, in order; files that are there already are kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from icub_grasp_generators.vgn.trials import TriedScene, write_trials


class Trials(Protocol):
    """Tries grasps; the number of a batch decides everything in it."""

    def batch(self, number: int) -> list[TriedScene]:
        """Try the grasps of one batch."""


def generate(
    trials: Trials, folder: Path, batches: int, until: float, progress: Callable[[float, str], None]
) -> list[Path]:
    """Try batches until there are enough files or the time is up; at least one file.

    Args:
        trials: What to try.
        folder: Of the files.
        batches: Files wanted.
        until: `time.monotonic()` at which no further batch is begun.
        progress: Told the finished share and what was held.

    Returns:
        All files of the folder, in order of their batches.
    """
    folder.mkdir(parents=True, exist_ok=True)
    done = 0
    for number in range(batches):
        path = folder / f"batch_{number:05d}.npz"
        if not path.exists():
            if done > 0 and time.monotonic() > until:
                break
            scenes = trials.batch(number)
            write_trials(path, scenes)
            held, tried = sum(int(s.success.sum()) for s in scenes), sum(len(s.success) for s in scenes)
            progress(number / batches, f"batch {number}: {held} of {tried} grasps held")
        done += 1
    return sorted(folder.glob("batch_*.npz"))
