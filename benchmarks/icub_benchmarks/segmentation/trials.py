"""Trials of `icub benchmark segmentation`: run once, kept one by one in the work folder, read back."""

from __future__ import annotations

import argparse
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from icub_benchmarks.segmentation.head_clock import heads_share
from icub_benchmarks.segmentation.methods import Method, setting
from icub_benchmarks.segmentation.recording import taught_and_seen
from icub_benchmarks.segmentation.trial import Trial, run_trial
from icub_core import registry
from icub_core.config.compose import compose
from icub_core.construct import build
from icub_core.errors import ConfigError, unknown_name
from icub_core.files import write_text_atomically
from icub_core.interfaces.abilities import Closable
from icub_core.interfaces.dataset import Dataset
from icub_pipelines.settings import SeeSettings

TASKS = {"tabletop": "rendered_tabletop", "handheld": "rendered_handheld"}
SHOWING = "showing"
"""The main job's own task: objects shown one after another, examined on a table among distractors."""
MIN_TAUGHT = 12
"""Fewest frames in which an object is shown: with fewer the gaze may lose it."""
SHARE_FRAMES = 20


@dataclass(frozen=True)
class Task:
    """A data set with its own settings, such as ``path``."""

    name: str
    plugin: str
    settings: dict[str, Any]

    def splits(self, train: int, test: int, run: int) -> tuple[Dataset, Dataset]:
        """Build both splits; only rendered sets have a number of frames to choose.

        Rooms, movements and distractors of the task `SHOWING` are other ones in every run; the rendered tasks are the
        same.
        """
        if self.name == SHOWING:
            names = list(compose().pipeline.teach.preferred)
            frames = max(MIN_TAUGHT, train // len(names))
            return taught_and_seen(run, names, frames, SeeSettings(frames=test))
        return self._split("train", train), self._split("test", test)

    def _split(self, split: str, frames: int) -> Dataset:
        chosen = dict(self.settings)
        if self.plugin.startswith("rendered_"):
            chosen.setdefault("frames", frames)
        return build("dataset", {"plugin": self.plugin, "split": split, **chosen})


@dataclass(frozen=True)
class Run:
    """A trial and the heads' share of the time a test frame takes, NaN where the method has no on-line heads."""

    trial: Trial
    heads_share: float


Runs = dict[tuple[str, str], list[Run]]


def find_task(text: str) -> Task:
    """Read a task: a name of `TASKS`, `SHOWING`, or a dataset plugin with settings, ``NAME,key=value``."""
    name, *settings = text.split(",")
    plugin = TASKS.get(name, name)
    if name == SHOWING:
        return Task(name, SHOWING, {})
    known = registry.available("dataset")
    if plugin not in known:
        raise ConfigError(unknown_name("task or dataset plugin", name, [*TASKS, SHOWING, *known]))
    return Task(name, plugin, dict(setting(s) for s in settings))


def run_all(tasks: list[Task], methods: list[Method], options: argparse.Namespace, console: Console) -> Runs:
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
                    if isinstance(dataset, Closable):
                        dataset.close()
    return runs


def _run(method: Method, config: Any, train: Dataset, test: Dataset, progress: Any, keep: Path | None) -> Run:
    segmenter = method.segmenter(config)
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
