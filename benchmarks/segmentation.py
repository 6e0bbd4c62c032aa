"""Segmenters against one another: four mAPs (mean and deviation over runs) and the training time in its parts.

    icub benchmark segmentation                                       # every known method, both rendered tasks
    icub benchmark segmentation --methods falkon --tasks tabletop --runs 1
    icub benchmark segmentation --tasks "ycb_video,path=/data/ycbv"   # any dataset plugin

Trials are kept one by one in the work folder: interrupted, the same line goes on where it stopped. They are known by
task, method and their whole configuration, not by the code: measure again with --fresh after changing it.

Source: the shape of thesis tables 10.1 and 11.1 to 11.6.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from icub_core import registry
from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.errors import ConfigError, IcubError, unknown_name
from icub_core.evaluation.detection import MEAN_NAMES
from icub_core.evaluation.results import Figure, write_results
from icub_core.evaluation.trial import Trial, run_trial
from icub_core.files import write_text_atomically
from icub_core.interfaces.dataset import Dataset

OURS, OUTPUT_LAYERS, O_OS = "falkon", "output_layers", "o_os"
"""Registry names of the methods that the ratios are taken between."""
TASKS = {"tabletop": "rendered_tabletop", "handheld": "rendered_handheld"}
PARTS = ("rpn", "detection", "masks")
MAIN_TASK = "tabletop"
TABLE_WIDTH = 170
"""Columns when the output is a file or a pipe."""
RESULTS = Path(__file__).resolve().parent / "results" / "segmentation.json"


@dataclass(frozen=True)
class Task:
    """A data set with its own settings, such as ``path``."""

    name: str
    plugin: str
    settings: dict[str, Any]

    def split(self, split: str, frames: int) -> Dataset:
        """Build one split; only rendered sets have a number of frames to choose."""
        chosen = dict(self.settings)
        if self.plugin.startswith("rendered_"):
            chosen.setdefault("frames", frames)
        return registry.build("dataset", {"plugin": self.plugin, "split": split, **chosen})


@dataclass(frozen=True)
class Method:
    """A segmenter with overrides, such as ``falkon,segmenter.batches=2``."""

    name: str
    overrides: tuple[str, ...]

    def config(self, seed: int, device: str) -> Any:
        """Compose the configuration of one run; only what the segmenter is made of."""
        plugin = self.overrides[0].partition("=")[2]
        return compose([f"segmenter={plugin}", f"seed={seed}", f"device={device}", *self.overrides[1:]])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parser().parse_args(arguments)
    console = Console(stderr=True)
    try:
        tasks = [_task(text) for text in options.tasks]
        methods = [_method(text) for text in options.methods or sorted(registry.available("segmenter"))]
        trials = _run_all(tasks, methods, options, console)
    except KeyboardInterrupt:
        console.print("stopped; the same line goes on from the last finished trial")
        return 130
    except IcubError as error:
        console.print(f"error: {error}", style="red", highlight=False)
        return 1
    figures = _figures(trials)
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    command = shlex.join(["icub", "benchmark", "segmentation", *arguments])
    write_results(options.out, command=command, seed=0, figures=figures)
    _print_tables(trials)
    console.print(f"written: {options.out}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="icub benchmark segmentation", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--tasks", nargs="+", default=sorted(TASKS), help="tabletop, handheld, or DATASET,key=value,..."
    )
    parser.add_argument("--methods", nargs="+", help="SEGMENTER[,key=value,...] (default: every segmenter plugin)")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--train-frames", type=int, default=240)
    parser.add_argument("--test-frames", type=int, default=120)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fresh", action="store_true", help="measure again what was measured before")
    parser.add_argument("--work", type=Path, default=Path("runs/benchmarks/segmentation"), help="folder of the trials")
    parser.add_argument("--out", type=Path, default=RESULTS)
    return parser


def _task(text: str) -> Task:
    name, *settings = text.split(",")
    plugin = TASKS.get(name, name)
    known = registry.available("dataset")
    if plugin not in known:
        raise ConfigError(unknown_name("task or dataset plugin", name, [*TASKS, *known]))
    return Task(name, plugin, dict(_pair(s) for s in settings))


def _pair(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"'{text}' is no setting; expected key=value")
    return key, OmegaConf.create(f"value: {value}").value


def _method(text: str) -> Method:
    plugin, *overrides = text.split(",")
    registry.info("segmenter", plugin)
    return Method(text, (f"segmenter={plugin}", *overrides))


Trials = dict[tuple[str, str], list[Trial]]


def _run_all(tasks: list[Task], methods: list[Method], options: argparse.Namespace, console: Console) -> Trials:
    """Run or read back every trial."""
    trials: Trials = {}
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[doing]}"), TimeElapsedColumn())
    with Progress(*columns, console=console) as bars:
        for task in tasks:
            train, test = task.split("train", options.train_frames), task.split("test", options.test_frames)
            for method in methods:
                done: list[Trial] = []
                for run in range(options.runs):
                    config = method.config(run, options.device)
                    file = options.work / f"{_trial_name(task, method, run, config, len(train), len(test))}.json"
                    bar = bars.add_task(f"{task.name} {method.name} run {run + 1}", total=1.0, doing="")

                    def progress(share: float, doing: str, bar: Any = bar) -> None:
                        bars.update(bar, completed=share, doing=doing)

                    if file.exists() and not options.fresh:
                        done.append(Trial.from_dict(json.loads(file.read_text())))
                        progress(1.0, "measured before")
                        continue
                    trial = run_trial(Assembly(config).get("segmenter"), train, test, progress)
                    write_text_atomically(file, json.dumps(trial.as_dict(), indent=1))
                    done.append(trial)
                    progress(1.0, f"mask mAP50 {100 * trial.metrics.map50_segm:.1f}")
                trials[task.name, method.name] = done
            for dataset in (train, test):
                close = getattr(dataset, "close", None)
                if close is not None:
                    close()
    return trials


def _trial_name(task: Task, method: Method, run: int, config: Any, train_frames: int, test_frames: int) -> str:
    """Name a trial by everything that was chosen for it."""
    parts = {kind: config.get(kind) for kind in ("segmenter", "feature_extractor", "online_head")}
    chosen = [OmegaConf.to_yaml(OmegaConf.create(parts), resolve=False), task.plugin, task.settings, train_frames]
    key = hashlib.sha256(repr([*chosen, test_frames, config.seed, config.device]).encode()).hexdigest()[:12]
    safe = "".join(c if c.isalnum() or c in "._-" else "_" for c in f"{task.name}-{method.name}")
    return f"{safe}-{run}-{key}"


def _mean(values: Sequence[float], unit: str) -> Figure:
    spread = statistics.stdev(values) if len(values) > 1 else None
    return Figure(statistics.fmean(values), unit, spread, len(values))


def _figures(trials: Trials) -> dict[str, Figure]:
    figures = {}
    for (task, method), done in trials.items():
        prefix = f"segmentation.{task}.{method}"
        for name in MEAN_NAMES:
            figures[f"{prefix}.{name}"] = _mean([getattr(t.metrics, name) for t in done], "1")
        figures[f"{prefix}.feature_seconds"] = _mean([t.feature_seconds for t in done], "s")
        figures[f"{prefix}.update_seconds"] = _mean([t.update_seconds for t in done], "s")
        figures[f"{prefix}.segment_seconds"] = _mean([t.segment_seconds for t in done], "s")
        for part in sorted({p for t in done for p in t.parts}):
            figures[f"{prefix}.{part}_seconds"] = _mean([t.parts.get(part, 0.0) for t in done], "s")
    return figures | _comparisons(trials)


def _comparisons(trials: Trials) -> dict[str, Figure]:
    """Compare ours with the baselines on the table-top task, run by run, where both were measured."""
    figures = {}
    ours = trials.get((MAIN_TASK, OURS), [])
    output_layers, o_os = trials.get((MAIN_TASK, OUTPUT_LAYERS), []), trials.get((MAIN_TASK, O_OS), [])
    if ours and output_layers:
        pairs = list(zip(ours, output_layers, strict=False))
        ratios = [b.update_seconds / a.update_seconds for a, b in pairs]
        gains = [100 * (a.metrics.map50_segm - b.metrics.map50_segm) for a, b in pairs]
        figures["segmentation.speedup_output_layers"] = _mean(ratios, "1")
        figures["segmentation.map50_segm_minus_output_layers"] = _mean(gains, "points")
    if ours and o_os:
        pairs = list(zip(ours, o_os, strict=False))
        gains_by_name = [
            _mean([100 * (getattr(a.metrics, name) - getattr(b.metrics, name)) for a, b in pairs], "points")
            for name in MEAN_NAMES
        ]
        figures["segmentation.ours_minus_oos"] = min(gains_by_name, key=lambda figure: figure.value)
    return figures


def _print_tables(trials: Trials) -> None:
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=TABLE_WIDTH)
    for task in dict.fromkeys(task for task, _ in trials):
        table = Table(title=f"{task}: mAP in percent, times in seconds")
        for heading in ("method", *MEAN_NAMES, "features", *PARTS, "after last frame", "a frame"):
            table.add_column(heading, justify="left" if heading == "method" else "right")
        for (name, method), done in trials.items():
            if name != task:
                continue
            cells = [_cell([100 * getattr(t.metrics, m) for t in done], 1) for m in MEAN_NAMES]
            cells.append(_cell([t.feature_seconds for t in done], 1))
            cells += [_cell([t.parts[p] for t in done if p in t.parts], 2) for p in PARTS]
            cells.append(_cell([t.update_seconds for t in done], 2))
            cells.append(_cell([t.segment_seconds for t in done], 3))
            table.add_row(method, *cells)
        console.print(table)


def _cell(values: Sequence[float], digits: int) -> str:
    if not values:
        return "-"
    figure = _mean(values, "")
    spread = "" if figure.spread is None else f" ± {figure.spread:.{digits}f}"
    return f"{figure.value:.{digits}f}{spread}"


if __name__ == "__main__":
    sys.exit(main())
