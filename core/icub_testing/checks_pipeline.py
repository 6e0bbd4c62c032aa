"""Contract of pipelines: their stages, not what a run yields."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from icub_core.config.schema import signature
from icub_core.errors import ConfigError
from icub_core.hooks import Events
from icub_core.interfaces.pipeline import Stage
from icub_core.kinds import KINDS
from icub_core.run import Run
from icub_testing.checks import Make
from icub_testing.expect import expect, expect_same
from icub_testing.tiny import tiny_class


class _TinyPlugins:
    """A run composed of tiny plugins, all of them or none."""

    def __init__(self, everything: bool) -> None:
        self._everything = everything
        self._chosen: set[str] = set()

    def chosen(self, kind: str) -> str | None:
        always = kind in ("objects", "robot", "simulator", "task")
        return "tiny" if self._everything or always or kind in self._chosen else None

    def choose(self, kind: str, name: str) -> None:
        self._chosen.add(kind)

    def takes(self, kind: str) -> dict[str, Any]:
        wanted = signature(kind, "tiny", tiny_class(kind))
        return {key: parameter.default for key, parameter in {**wanted.parameters, **wanted.dependencies}.items()}

    def get(self, kind: str) -> Any:
        return self.fresh(kind)

    def fresh(self, kind: str, **given: Any) -> Any:
        cls: Callable[[], Any] = tiny_class(kind)
        if kind != "segmenter":
            return cls()
        return tiny_class(kind)(tiny_class("feature_extractor")(), tiny_class("online_head"))


def _stages(make: Make, folder: str, everything: bool = True) -> tuple[Stage, ...]:
    stages: tuple[Stage, ...] = make().stages(Run(Path(folder), 0, Events(), _TinyPlugins(everything)))
    return stages


def check_stages(make: Make) -> None:
    """Stages are a tuple, not empty, with different names and callables."""
    with tempfile.TemporaryDirectory() as folder:
        stages = _stages(make, folder)
    expect(isinstance(stages, tuple) and len(stages) > 0, "a tuple of stages", stages)
    names = [stage.name for stage in stages]
    expect(len(set(names)) == len(names), "stages with different names", names)
    expect(all(name.strip() and name == name.strip() for name in names), "names without blanks around them", names)
    for stage in stages:
        expect(callable(stage.run), f"a function for the stage '{stage.name}'", stage.run)


def check_needs(make: Make) -> None:
    """Every kind that a stage needs exists, and a stage that is left out says so."""
    with tempfile.TemporaryDirectory() as folder:
        for stage in _stages(make, folder):
            for kind in stage.needs:
                expect(kind in KINDS, f"a kind of plugin in the needs of '{stage.name}'", kind)
            expect(
                not stage.needs or bool(stage.without), f"what the reader is told without '{stage.name}'", stage.without
            )


def check_repeatable(make: Make) -> None:
    """Two runs composed alike have the same stages."""
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        expect_same(
            [(s.name, s.needs) for s in _stages(make, first)],
            [(s.name, s.needs) for s in _stages(make, second)],
            "stages of two runs composed alike",
        )


def check_nothing_is_done_early(make: Make) -> None:
    """Asking for the stages writes nothing, and a composition that cannot work is refused in one line."""
    for everything in (True, False):
        with tempfile.TemporaryDirectory() as folder:
            try:
                _stages(make, folder, everything)
            except ConfigError as refusal:
                expect("\n" not in str(refusal), "a refusal of one line", str(refusal))
            expect_same(list(Path(folder).iterdir()), [], "files before the first stage")
