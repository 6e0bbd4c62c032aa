"""Segmenters against one another: four mAPs (mean and deviation over runs) and the training time in its parts.

    icub benchmark segmentation                                       # all methods, both rendered tasks, three runs
    icub benchmark segmentation --full                                # and those that train the whole network: slow
    icub benchmark segmentation --curves                              # and precision over training time
    icub benchmark segmentation --ablation                            # what each ingredient adds, taught by showing
    icub benchmark segmentation --quick --work /tmp/quick --out /tmp/quick.json
    icub benchmark segmentation --methods ours falkon,segmenter.mode=faithful --tasks tabletop --runs 1
    icub benchmark segmentation --tasks "ycb_video,path=/data/ycbv"   # any dataset plugin

Trials are kept one by one in the work folder: interrupted, the same line goes on where it stopped. They are known by
task, method and their whole configuration, not by the code: measure again with --fresh after changing it.

A table (Markdown) and plots appear beside the results file.

Source: the shape of thesis tables 10.1, 11.1 to 11.6, 11.9 and 11.10 and figures 10.3, 11.6 and 11.7.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib
import json
import shlex
import statistics
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from icub_core import registry
from icub_core.config.assembly import Assembly
from icub_core.config.compose import compose
from icub_core.errors import ConfigError, IcubError, unknown_name
from icub_core.evaluation.detection import MEAN_NAMES
from icub_core.evaluation.head_clock import heads_share
from icub_core.evaluation.results import Figure, write_results
from icub_core.evaluation.trial import Trial, run_trial
from icub_core.evaluation.trial_report import HEADINGS, cells, markdown_table, plot_over_time
from icub_core.files import write_text_atomically
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.feature_extractor import FeatureExtractor, ImageFeatures
from icub_core.interfaces.segmenter import Segmenter
from icub_core.pipeline.settings import SeeSettings, TeachSettings
from icub_core.pipeline.shown import shown_and_seen

OURS, OUTPUT_LAYERS, O_OS = "ours", "output_layers", "o_os"
"""Names of the methods that the ratios are taken between."""
TASKS = {"tabletop": "rendered_tabletop", "handheld": "rendered_handheld"}
SHOWING = "showing"
"""The main job's own task: objects shown one after another, examined on a table among strangers."""
FEWEST_SHOWN = 12
"""Frames in which an object is shown at least: with fewer the gaze may lose it."""
MAIN_TASK = "tabletop"
EPOCHS = {"tabletop": 16, "handheld": 12}
"""Of the output layers: twice the thesis's, since there are 70 times fewer frames. With 8 on the table-top task mask
mAP50 was 4.6 points lower."""
METHODS = {
    OURS: "falkon",
    "ours_online_rpn": "falkon,segmenter.proposals=online",
    "ours_serial": "ours_serial",
    O_OS: "o_os",
    "linear_softmax": "linear_softmax",
    OUTPUT_LAYERS: "output_layers",
    "store_features": "output_layers,segmenter.store_features=true",
    "one_epoch": "output_layers,segmenter.epochs=1",
    "one_epoch_unshuffled": "output_layers,segmenter.epochs=1,segmenter.shuffle=false",
}
"""By the name in tables and results: output_layers is Mask R-CNN (output layers), the next three are its variants."""
FULL = {
    "mask_rcnn": "mask_rcnn",
    "ours_on_target_features": "falkon,feature_extractor.weights={mask_rcnn}",
    "mask_rcnn_one_epoch": "mask_rcnn,segmenter.epochs=1",
    "mask_rcnn_one_epoch_unshuffled": "mask_rcnn,segmenter.epochs=1,segmenter.shuffle=false",
}
"""With --full; the second takes its features from the network of the first (table 10.2)."""
CURVES = {
    "Ours, batches of the Minibootstrap": [f"falkon,segmenter.batches={n}" for n in (2, 5, 15)] + [OURS],
    "Mask R-CNN (output layers), epochs": [f"output_layers,segmenter.epochs={n}" for n in (1, 4)] + [OUTPUT_LAYERS],
    "Mask R-CNN (store features), epochs": [
        f"output_layers,segmenter.store_features=true,segmenter.epochs={n}" for n in (1, 4)
    ]
    + ["store_features"],
    "Ours, share of pixels r": [f"falkon,icub_segmenters.masks.SAMPLING_FACTOR={r}" for r in (0.01, 0.1)] + [OURS],
}
ABLATION = {
    OURS: "falkon",
    "no pasted clutter": "falkon,segmenter.composites=0",
    "one pasted picture a frame": "falkon,segmenter.composites=1",
    "no look-alikes": "falkon,icub_segmenters.clutter.LOOK_ALIKES=0.0",
    "strangers not described": "falkon,icub_segmenters.regions.STRANGER_BOXES=0",
    "bank of negatives": "falkon,icub_segmenters.online_segmenter.BANK_PICTURES=100",
    "features of the last layer alone": "falkon,features=256:512",
    "no colours and early maps": "falkon,features=0:640",
    "no boxes around true ones": "falkon,icub_segmenters.regions.JITTERED=0",
    "no box voting": "falkon,icub_segmenters.detection.VOTE_IOU=1.1",
    "second look (re-pooling)": "falkon,segmenter.repool=true",
    "on-line proposals": "falkon,segmenter.proposals=online",
    "own masks alone": "falkon,segmenter.masks=online",
    "pre-trained masks alone": "falkon,segmenter.masks=pretrained",
    "Algorithm 1 a class": "falkon,segmenter.mode=faithful",
    "a tenth of the negatives": "falkon,segmenter.batches=1",
    "centres half positives": "falkon,online_head.selection=balanced",
}
SHARE_FRAMES = 20
TABLE_WIDTH = 190
"""Columns when the output is a file or a pipe."""
RESULTS = Path(__file__).resolve().parent / "results" / "segmentation.json"


@dataclass(frozen=True)
class Task:
    """A data set with its own settings, such as ``path``."""

    name: str
    plugin: str
    settings: dict[str, Any]

    def splits(self, train: int, test: int, run: int) -> tuple[Dataset, Dataset]:
        """Build both splits; only rendered sets have a number of frames to choose.

        The objects that are shown are other ones in every run; the rendered tasks are the same.
        """
        if self.name == SHOWING:
            teach = TeachSettings()
            teach.frames = max(FEWEST_SHOWN, train // len(teach.objects))
            return shown_and_seen(run, teach, SeeSettings(frames=test))
        return self._split("train", train), self._split("test", test)

    def _split(self, split: str, frames: int) -> Dataset:
        chosen = dict(self.settings)
        if self.plugin.startswith("rendered_"):
            chosen.setdefault("frames", frames)
        return registry.build("dataset", {"plugin": self.plugin, "split": split, **chosen})


@dataclass(frozen=True)
class Method:
    """A segmenter with overrides, such as ``falkon,segmenter.batches=2``.

    Two kinds of overrides are the benchmark's own: a constant of a module of the segmenters, such as
    ``icub_segmenters.regions.JITTERED=0``, and ``features=FIRST:LAST``, columns of the region features.
    """

    name: str
    text: str

    @property
    def overrides(self) -> list[str]:
        """Overrides of the configuration."""
        return [o for o in self.text.split(",")[1:] if not o.startswith(("icub_segmenters.", "features="))]

    @property
    def constants(self) -> list[tuple[str, str, Any]]:
        """(module, name, value) of constants that are changed."""
        found = []
        for override in self.text.split(",")[1:]:
            if override.startswith("icub_segmenters."):
                path, value = _pair(override)
                module, _, name = path.rpartition(".")
                found.append((module, name, value))
        return found

    def config(self, seed: int, device: str, task: str, network: Path) -> Any:
        """Compose the configuration of one run; only what the segmenter is made of.

        `network` is the folder of the fine-tuned network of this task and run.
        """
        plugin = self.text.split(",")[0]
        overrides = [o.replace("{mask_rcnn}", str(network / "mask_rcnn.safetensors")) for o in self.overrides]
        if plugin == "output_layers" and task in EPOCHS and not any("epochs" in o for o in overrides):
            overrides.append(f"segmenter.epochs={EPOCHS[task]}")
        return compose([f"segmenter={plugin}", f"seed={seed}", f"device={device}", *overrides])

    @contextlib.contextmanager
    def segmenter(self, config: Any) -> Iterator[Segmenter]:
        """Build the segmenter; its constants are changed within this context."""
        before = []
        for module, name, value in self.constants:
            loaded = importlib.import_module(module)
            if not hasattr(loaded, name):
                raise ConfigError(unknown_name(f"constant of {module}", name, [n for n in vars(loaded) if n.isupper()]))
            before.append((loaded, name, getattr(loaded, name)))
            setattr(loaded, name, value)
        try:
            yield self._built(config)
        finally:
            for loaded, name, value in before:
                setattr(loaded, name, value)

    def _built(self, config: Any) -> Segmenter:
        plugins = Assembly(config)
        columns = [o.partition("=")[2] for o in self.text.split(",") if o.startswith("features=")]
        if not columns:
            return plugins.get("segmenter")
        first, last = (int(number) for number in columns[0].split(":"))
        few = SomeFeatures(plugins.get("feature_extractor"), slice(first, last))
        head = plugins.get("online_head")
        return registry.build("segmenter", config.segmenter, feature_extractor=few, online_head=head)


class SomeFeatures(FeatureExtractor):
    """Another extractor, of whose region features only some columns are seen."""

    def __init__(self, whole: Any, columns: slice) -> None:
        self._whole, self._columns = whole, columns

    region_dim = property(lambda self: self._columns.stop - self._columns.start)
    mask_dim = property(lambda self: self._whole.mask_dim)
    mask_size = property(lambda self: self._whole.mask_size)

    def extract(self, rgb: Any) -> ImageFeatures:
        """Extract as the whole does."""
        return self._whole.extract(rgb)

    def region_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe boxes by the chosen columns."""
        return self._whole.region_features(features, boxes)[:, self._columns]

    def mask_features(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Describe pixels as the whole does."""
        return self._whole.mask_features(features, boxes)

    def mask_probabilities(self, features: ImageFeatures, boxes: torch.Tensor) -> torch.Tensor:
        """Draw masks as the whole does."""
        return self._whole.mask_probabilities(features, boxes)

    def rpn_cells(self, features: ImageFeatures) -> Any:
        """Offer the cells of the whole."""
        return self._whole.rpn_cells(features)


@dataclass(frozen=True)
class Run:
    """A trial and the heads' share of the time a test frame takes, NaN where the method has no on-line heads."""

    trial: Trial
    heads_share: float


Runs = dict[tuple[str, str], list[Run]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns the exit code."""
    options = _parser().parse_args(arguments)
    console = Console(stderr=True)
    if options.quick:
        options.train_frames, options.test_frames, options.runs = 24, 8, 1
    if options.ablation:
        options.tasks, options.methods = [SHOWING], options.methods or list(ABLATION)
    try:
        tasks = [_task(text) for text in options.tasks]
        runs = _run_all(tasks, _methods(options), options, console)
    except KeyboardInterrupt:
        console.print("stopped; the same line goes on from the last finished trial")
        return 130
    except IcubError as error:
        console.print(f"error: {error}", style="red", highlight=False)
        return 1
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    command = shlex.join(["icub", "benchmark", "segmentation", *arguments])
    write_results(options.out, command=command, seed=0, figures=_figures(runs, options.ablation))
    _write_tables(runs, options, command)
    _print_tables(runs)
    console.print(f"written: {options.out}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="icub benchmark segmentation", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--tasks", nargs="+", default=sorted(TASKS, reverse=True), help="tabletop, handheld, showing, DATASET,key=value"
    )
    parser.add_argument(
        "--methods", nargs="+", help=f"{', '.join([*METHODS, *FULL])}, or SEGMENTER[,key=value,...] (default: not full)"
    )
    parser.add_argument("--full", action="store_true", help="also train the whole of Mask R-CNN")
    parser.add_argument("--curves", action="store_true", help="also precision over training time and over r")
    parser.add_argument("--ablation", action="store_true", help="what each ingredient adds, on the task 'showing'")
    parser.add_argument("--quick", action="store_true", help="few frames, one run: does it work?")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--train-frames", type=int, default=160)
    parser.add_argument("--test-frames", type=int, default=80)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fresh", action="store_true", help="measure again what was measured before")
    parser.add_argument("--work", type=Path, default=Path("runs/benchmarks/segmentation"), help="folder of the trials")
    parser.add_argument("--out", type=Path, default=RESULTS)
    return parser


def _methods(options: argparse.Namespace) -> list[Method]:
    named = {**METHODS, **FULL, **(ABLATION if options.ablation else {})}
    chosen = options.methods or [*METHODS, *(FULL if options.full else ())]
    if options.curves:
        chosen = list(dict.fromkeys([*chosen, *(m for methods in CURVES.values() for m in methods)]))
    methods = [Method(name, named.get(name, name)) for name in chosen]
    for method in methods:
        plugin = method.text.split(",")[0]
        if plugin not in registry.available("segmenter"):
            raise ConfigError(unknown_name("method", plugin, [*named, *registry.available("segmenter")]))
    return methods


def _task(text: str) -> Task:
    name, *settings = text.split(",")
    plugin = TASKS.get(name, name)
    if name == SHOWING:
        return Task(name, SHOWING, {})
    known = registry.available("dataset")
    if plugin not in known:
        raise ConfigError(unknown_name("task or dataset plugin", name, [*TASKS, SHOWING, *known]))
    return Task(name, plugin, dict(_pair(s) for s in settings))


def _pair(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"'{text}' is no setting; expected key=value")
    return key, OmegaConf.create(f"value: {value}").value


def _run_all(tasks: list[Task], methods: list[Method], options: argparse.Namespace, console: Console) -> Runs:
    """Run or read back every trial."""
    runs: Runs = {(task.name, method.name): [] for task in tasks for method in methods}
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[doing]}"), TimeElapsedColumn())
    with Progress(*columns, console=console) as bars:
        for task in tasks:
            for number in range(options.runs):
                data: list[Dataset] = []
                network = options.work / f"{task.name}-{number}-{options.train_frames}-network"
                for method in methods:
                    config = method.config(number, options.device, task.name, network)
                    bar = bars.add_task(f"{task.name} {method.name} run {number + 1}", total=1.0, doing="")

                    def progress(share: float, doing: str, bar: Any = bar) -> None:
                        bars.update(bar, completed=share, doing=doing)

                    file = options.work / f"{_run_name(task, method, number, config, options)}.json"
                    if file.exists() and not options.fresh:
                        content = json.loads(file.read_text())
                        run = Run(Trial.from_dict(content["trial"]), content["heads_share"])
                    else:
                        data = data or list(task.splits(options.train_frames, options.test_frames, number))
                        keep = network if method.name == "mask_rcnn" else None
                        run = _run(method, config, data[0], data[1], progress, keep)
                        content = {"trial": run.trial.as_dict(), "heads_share": run.heads_share}
                        write_text_atomically(file, json.dumps(content, indent=1))
                    runs[task.name, method.name].append(run)
                    progress(1.0, f"mask mAP50 {100 * run.trial.metrics.map50_segm:.1f}")
                for dataset in data:
                    close = getattr(dataset, "close", None)
                    if close is not None:
                        close()
    return runs


def _run(method: Method, config: Any, train: Dataset, test: Dataset, progress: Any, keep: Path | None) -> Run:
    with method.segmenter(config) as segmenter:
        trial = run_trial(segmenter, train, test, progress)
        if keep is not None:
            segmenter.save(keep)
        frames = [test[i][0] for i in range(min(SHARE_FRAMES, len(test)))]
        return Run(trial, heads_share(segmenter, frames))


def _run_name(task: Task, method: Method, number: int, config: Any, options: argparse.Namespace) -> str:
    """Name a trial by everything that was chosen for it."""
    parts = {kind: config.get(kind) for kind in ("segmenter", "feature_extractor", "online_head")}
    chosen = [OmegaConf.to_yaml(OmegaConf.create(parts), resolve=False), method.text, task.plugin, task.settings]
    size = [options.train_frames, options.test_frames, config.seed, config.device]
    key = hashlib.sha256(repr([*chosen, *size]).encode()).hexdigest()[:12]
    safe = "".join(c if c.isalnum() or c in "._-" else "_" for c in f"{task.name}-{method.name}")
    return f"{safe}-{number}-{key}"


def _mean(values: Sequence[float], unit: str) -> Figure:
    spread = statistics.stdev(values) if len(values) > 1 else None
    return Figure(statistics.fmean(values), unit, spread, len(values))


def _figures(runs: Runs, ablation: bool = False) -> dict[str, Figure]:
    figures = {}
    for (task, method), done in runs.items():
        trials = [run.trial for run in done]
        prefix = f"segmentation.{'ablation' if ablation else task}.{method}"
        for name in MEAN_NAMES:
            figures[f"{prefix}.{name}"] = _mean([getattr(t.metrics, name) for t in trials], "1")
        figures[f"{prefix}.feature_seconds"] = _mean([t.feature_seconds for t in trials], "s")
        figures[f"{prefix}.update_seconds"] = _mean([t.update_seconds for t in trials], "s")
        figures[f"{prefix}.segment_seconds"] = _mean([t.segment_seconds for t in trials], "s")
        for part in sorted({p for t in trials for p in t.parts}):
            figures[f"{prefix}.{part}_seconds"] = _mean([t.parts.get(part, 0.0) for t in trials], "s")
    return figures if ablation else figures | _comparisons(runs)


def _comparisons(runs: Runs) -> dict[str, Figure]:
    """Compare ours with the baselines on the table-top task, run by run, where both were measured."""
    figures = {}
    ours = runs.get((MAIN_TASK, OURS), [])
    if ours:
        figures["segmentation.heads_share"] = _mean([run.heads_share for run in ours], "1")
    pairs = [(a.trial, b.trial) for a, b in zip(ours, runs.get((MAIN_TASK, OUTPUT_LAYERS), []), strict=False)]
    if pairs:
        ratios = [b.update_seconds / a.update_seconds for a, b in pairs]
        gains = [100 * (a.metrics.map50_segm - b.metrics.map50_segm) for a, b in pairs]
        figures["segmentation.speedup_output_layers"] = _mean(ratios, "1")
        figures["segmentation.map50_segm_minus_output_layers"] = _mean(gains, "points")
    pairs = [(a.trial, b.trial) for a, b in zip(ours, runs.get((MAIN_TASK, O_OS), []), strict=False)]
    if pairs:
        gains_by_name = [
            _mean([100 * (getattr(a.metrics, name) - getattr(b.metrics, name)) for a, b in pairs], "points")
            for name in MEAN_NAMES
        ]
        figures["segmentation.ours_minus_oos"] = min(gains_by_name, key=lambda figure: figure.value)
    return figures


def _by_task(runs: Runs) -> dict[str, dict[str, list[Trial]]]:
    tables: dict[str, dict[str, list[Trial]]] = {}
    for (task, method), done in runs.items():
        tables.setdefault(task, {})[method] = [run.trial for run in done]
    return tables


def _write_tables(runs: Runs, options: argparse.Namespace, command: str) -> None:
    """Write tables and plots beside the results file; an ablation has files of its own."""
    stem = options.out.with_name(f"{options.out.stem}_ablation" if options.ablation else options.out.stem)
    text = [f"# Segmentation\n\n`{command}`\n\nmAP in percent, times in seconds, mean ± deviation over runs.\n"]
    for task, rows in _by_task(runs).items():
        frames = f"{options.train_frames} frames to learn from, {options.test_frames} to be examined on"
        text.append(f"## {task}: {frames}\n\n{markdown_table(rows)}")
        if options.ablation:
            continue
        lines: dict[str, dict[str, list[Trial]]] = {}
        if options.curves:
            lines = {name: {m: rows[m] for m in methods if m in rows} for name, methods in CURVES.items()}
            for points in lines.values():
                order = sorted(points, key=lambda m: statistics.fmean(t.update_seconds for t in points[m]))
                points.update({m: points.pop(m) for m in order})
        drawn = {m for points in lines.values() for m in points}
        lines |= {name: {name: trials} for name, trials in rows.items() if name not in drawn}
        plot_over_time(stem.with_name(f"{stem.name}_{task}.png"), f"{task}: precision and training time", lines)
    write_text_atomically(stem.with_suffix(".md"), "\n".join(text))


def _print_tables(runs: Runs) -> None:
    terminal = Console()
    console = terminal if terminal.is_terminal else Console(width=TABLE_WIDTH)
    for task, rows in _by_task(runs).items():
        table = Table(title=f"{task}: mAP in percent, times in seconds")
        for heading in ("method", *HEADINGS):
            table.add_column(heading, justify="left" if heading == "method" else "right")
        for method, trials in rows.items():
            table.add_row(method, *cells(trials))
        console.print(table)


if __name__ == "__main__":
    sys.exit(main())
