"""Faulty pipelines."""

import itertools
from dataclasses import replace

from icub_testing.tiny.pipeline import TinyPipeline

from .base import breaks


@breaks("pipeline", "check_stages")
class NamesTwoStagesAlike(TinyPipeline):
    def stages(self, run):
        first, second, *rest = super().stages(run)
        return (first, replace(second, name=first.name), *rest)


@breaks("pipeline", "check_needs")
class LeavesAStageOutInSilence(TinyPipeline):
    def stages(self, run):
        return tuple(replace(stage, without="") for stage in super().stages(run))


@breaks("pipeline", "check_repeatable")
class NumbersItsStages(TinyPipeline):
    count = itertools.count()

    def stages(self, run):
        return tuple(replace(stage, name=f"{stage.name} {next(self.count)}") for stage in super().stages(run))


@breaks("pipeline", "check_nothing_is_done_early")
class BeginsToWriteAtOnce(TinyPipeline):
    def stages(self, run):
        (run.run_dir / "begun.txt").write_text("begun")
        return super().stages(run)
