"""``icub train KIND=NAME``: make the weights that a plugin ships with.

A training is a function announced by an entry point of the group ``icub.train`` with the name ``KIND.NAME``::

    def train(run_dir: Path, seed: int, minutes: float = 60.0, progress: Callable[[float, str], None] = ...) -> None

It keeps everything in `run_dir`, checkpoints at least every few minutes, resumes when it is called again with the same
folder, and spends `minutes` of wall time in all, over all resumptions; the default becomes the command's default.
"""

from __future__ import annotations

import argparse
import inspect
import logging
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from icub_core.cli import Interrupted
from icub_core.errors import ConfigError, PluginError, unknown_name
from icub_core.registry import info, one_line

ENTRY_POINT_GROUP = "icub.train"
DEFAULT_MINUTES = 60.0


def main(arguments: Sequence[str]) -> int:
    """Train the weights that a plugin ships with."""
    parser = argparse.ArgumentParser(prog="icub train", description="Train the weights that a plugin ships with.")
    parser.add_argument("plugin", metavar="KIND=NAME", help=f"one of {', '.join(choices())}")
    parser.add_argument("--minutes", type=float, help="wall time in all; the plugin's own default otherwise")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--run-dir", type=Path, help="folder; the same folder again resumes (runs/train/KIND-NAME-SEED)"
    )
    options = parser.parse_args(list(arguments))
    kind, equals, name = options.plugin.lstrip("+").partition("=")
    if not equals:
        raise ConfigError(f"'{options.plugin}' is not KIND=NAME. Known: {', '.join(choices())}")
    train = trainer(kind, name)
    minutes = options.minutes if options.minutes is not None else default_minutes(train)
    if not minutes > 0:
        raise ConfigError(f"--minutes {minutes} is not above 0")
    run_dir = options.run_dir or Path("runs", "train", f"{kind}-{name}-seed{options.seed}")
    run_dir.mkdir(parents=True, exist_ok=True)
    logging.basicConfig(level=logging.INFO, filename=run_dir / "train.log", format="%(asctime)s %(name)s: %(message)s")
    try:
        with _bar(f"training {kind} {name}") as progress:
            train(run_dir=run_dir, seed=options.seed, minutes=minutes, progress=progress)
    except KeyboardInterrupt:
        again = f"icub train {options.plugin} --seed {options.seed} --minutes {minutes:g} --run-dir {run_dir}"
        raise Interrupted(f"icub: interrupted; to resume: {again}") from None
    logging.getLogger(__name__).info("finished in %s", run_dir)
    return 0


def trainings() -> dict[str, EntryPoint]:
    """Return every training by ``KIND.NAME``, without importing any."""
    return {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}


def choices() -> list[str]:
    """Return what may be typed for every training: ``KIND=NAME``."""
    return [name.replace(".", "=", 1) for name in sorted(trainings())]


def trainer(kind: str, name: str) -> Callable[..., None]:
    """Import and return the training of a plugin; raises PluginError with the plugins that have one."""
    info(kind, name)
    known = trainings()
    entry = known.get(f"{kind}.{name}")
    if entry is None:
        raise PluginError(f"nothing to train: {unknown_name('training', f'{kind}={name}', choices())}")
    try:
        function: Callable[..., None] = entry.load()
    except Exception as cause:
        raise PluginError(
            f"the training '{entry.name}' ({entry.value}) cannot be imported: {one_line(cause)}"
        ) from cause
    return function


def default_minutes(train: Callable[..., None]) -> float:
    """Return the default of the parameter `minutes`, or one hour."""
    parameter = inspect.signature(train).parameters.get("minutes")
    if parameter is None or parameter.default is inspect.Parameter.empty:
        return DEFAULT_MINUTES
    return float(parameter.default)


class _bar:
    """A progress bar with time left, fed by ``progress(fraction, text)``."""

    def __init__(self, title: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        columns: list[Any] = [TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>5.1f}%")]
        columns += [TimeElapsedColumn(), TimeRemainingColumn(), TextColumn("{task.fields[text]}")]
        self._progress = Progress(*columns)
        self._task = self._progress.add_task(title, total=1.0, text="")

    def __enter__(self) -> Callable[[float, str], None]:
        self._progress.start()
        return lambda fraction, text: self._progress.update(self._task, completed=fraction, text=text)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()
