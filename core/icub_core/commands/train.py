"""``icub train KIND=NAME``: make the weights that a plugin ships with.

A training is an entry point of the group ``icub.train``, named ``KIND.NAME``; a third party adds one with one line in
its own pyproject::

    [project.entry-points."icub.train"]
    "feature_extractor.mine" = "my_package.training:train"

It is a function ``train(run_dir: Path, seed: int, minutes: float = 60.0, progress=...)``: `run_dir` is an existing
folder for checkpoints and the finished weights with their card; `minutes` is the wall time in all, over all
resumptions, whose default is the command's; `progress` is to be called with the finished share (0..1) and a short text.
It keeps checkpoints at least every few minutes, and resumes when it is called again with the same folder.
"""

from __future__ import annotations

import argparse
import inspect
import logging
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from icub_core.cli import Interrupted
from icub_core.errors import ConfigError, PluginError

DEFAULT_MINUTES = 60.0
GROUP = "icub.train"


def main(arguments: Sequence[str]) -> int:
    """Run ``icub train``; returns the exit code."""
    parser = argparse.ArgumentParser(prog="icub train", description="Train the weights that a plugin ships with.")
    parser.add_argument("plugin", metavar="KIND=NAME", help="such as feature_extractor=compact or policy=gpayn")
    parser.add_argument("--minutes", type=float, help="wall time in all; the plugin's own default otherwise")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--run-dir", type=Path, help="folder; the same folder again goes on (runs/train/KIND-NAME-SEED)"
    )
    options = parser.parse_args(list(arguments))
    kind, equals, name = options.plugin.lstrip("+").partition("=")
    if not equals:
        raise ConfigError(f"'{options.plugin}' is not KIND=NAME, such as feature_extractor=compact")
    train = trainer(kind, name)
    run_dir = options.run_dir or Path("runs", "train", f"{kind}-{name}-seed{options.seed}")
    run_dir.mkdir(parents=True, exist_ok=True)
    minutes = options.minutes if options.minutes is not None else default_minutes(train)
    if not minutes > 0:
        raise ConfigError(f"--minutes {minutes} is not above 0")
    logging.basicConfig(level=logging.INFO, filename=run_dir / "train.log", format="%(asctime)s %(name)s: %(message)s")
    try:
        with _bar(f"training {kind} {name}") as progress:
            train(run_dir=run_dir, seed=options.seed, minutes=minutes, progress=progress)
    except KeyboardInterrupt:
        again = f"icub train {options.plugin} --seed {options.seed} --minutes {minutes:g} --run-dir {run_dir}"
        raise Interrupted(f"icub: interrupted; to go on: {again}") from None
    logging.getLogger(__name__).info("finished in %s", run_dir)
    return 0


def trainer(kind: str, name: str) -> Callable[..., None]:
    """Return the training of a plugin; raises PluginError in one line when there is none."""
    from icub_core.registry import load, one_line

    plugin = load(kind, name)
    wanted = f"{kind}.{name}"
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if wanted in found:
        try:
            train: Callable[..., None] = found[wanted].load()
        except Exception as cause:
            raise PluginError(f"the training of {kind} '{name}' cannot be imported: {one_line(cause)}") from cause
        return train
    method = getattr(plugin, "train", None)
    if inspect.ismethod(method):
        message = (
            f"the class method 'train' of {kind} '{name}' should be an entry point '{wanted}' of the group {GROUP}"
        )
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return method
    known = ", ".join(sorted(found)) or "none"
    raise PluginError(
        f"{kind} '{name}' cannot be trained ahead of a run: there is no '{wanted}' in the group {GROUP}. Known: {known}"
    )


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
