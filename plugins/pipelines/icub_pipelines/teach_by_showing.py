"""Teaching by showing (thesis 11.8): objects one after another, then a false positive is found, taught, and gone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from omegaconf import DictConfig

from icub_core.config.assembly import Assembly
from icub_core.config.settings import to_dataclass
from icub_core.data import Instance
from icub_core.errors import ConfigError
from icub_core.evaluation.detection import evaluate_instances
from icub_pipelines import seeing
from icub_pipelines.teaching_session import Classroom, Look, Mistake, mistakes, recognised
from icub_pipelines.context import RunContext
from icub_pipelines.conversation import converse
from icub_pipelines.lifecycle import carry_out
from icub_pipelines.images import draw_instances
from icub_pipelines.settings import ShowingSettings, shown
from icub_pipelines.tabletop import Tabletop
from icub_core.scene import ObjectSpec

OBJECTS = 3
"""Shown when nothing was chosen."""
COMPANY = 3
"""Other unknown objects that stand beside the corrected one in the pictures that measure the correction."""


def run(cfg: DictConfig, run_dir: Path) -> dict[str, Any]:
    """Follow the script, or the commands of whoever sits at the terminal.

    Args:
        cfg: Composed configuration.
        run_dir: Where everything is written; a segmenter saved there by an interrupted run is gone on with.

    Returns:
        The flat figures of metrics.json.

    Raises:
        ConfigError: No segmenter was chosen, or an object does not exist.
    """
    settings = cast(ShowingSettings, to_dataclass(cfg.pipeline))
    return carry_out(cfg, run_dir, lambda context: _stages(context, cfg, settings))


def _stages(context: RunContext, cfg: DictConfig, settings: ShowingSettings) -> None:
    plugins = Assembly(cfg)
    if not plugins.chosen("segmenter"):
        raise ConfigError("there is nobody to teach; choose +segmenter=falkon")
    objects = plugins.get("objects")
    names = shown(settings.objects, objects.names, OBJECTS)
    taught = [objects.get(name) for name in names]
    if not taught:
        raise ConfigError("pipeline.objects is empty; expected at least one name of the object set")
    unknown = seeing.strangers(objects, names, settings.strangers, context.rng("strangers"))
    simulator = plugins.fresh("simulator")
    classroom = Classroom(context, simulator, plugins.get("robot").description, plugins.get("segmenter"))
    try:
        if settings.interactive:
            converse(classroom, objects, unknown, settings)
        else:
            _script(classroom, taught, unknown, settings)
    finally:
        simulator.close()


def _script(
    classroom: Classroom, taught: Sequence[ObjectSpec], unknown: Sequence[ObjectSpec], settings: ShowingSettings
) -> None:
    context = classroom.context
    if context.recall("teach"):
        classroom.segmenter.load(classroom.heads)
    else:
        _teach_all(classroom, taught, settings)
        classroom.segmenter.save(classroom.heads)
        context.remember("teach")
    with context.stage("look"):
        looks = classroom.look(taught, unknown, Tabletop(frames=settings.looks), context.rng("look"))
        wrong = [mistake for m in _all_mistakes(classroom.recognise(looks), looks) for mistake in m]
    stranger = _most_mistaken(wrong, unknown)
    if stranger is None:
        context.note(f"no unknown object was taken for a taught one in {settings.looks} pictures: nothing to correct")
        context.record({"showing.false_positives_before": 0})
        return
    _correct(classroom, taught, unknown, stranger, settings)
    classroom.segmenter.save(classroom.heads)


def _teach_all(classroom: Classroom, taught: Sequence[ObjectSpec], settings: ShowingSettings) -> None:
    context, rng = classroom.context, classroom.context.rng("teach")
    lessons = []
    for number, spec in enumerate(taught):
        with context.stage(f"teach {number + 1}"):
            lessons.append(classroom.teach(spec, settings.frames, rng))
    seeing.save_sheet(context, "Taught: masks from depth", "taught.png", [sample for _, sample, _ in lessons])
    context.record(
        {
            "showing.objects": len(taught),
            "showing.teach_seconds": float(np.mean([seconds for _, _, seconds in lessons])),
            "showing.update_seconds": max(report.seconds for report, _, _ in lessons),
        }
    )


def _correct(
    classroom: Classroom,
    taught: Sequence[ObjectSpec],
    unknown: Sequence[ObjectSpec],
    stranger: ObjectSpec,
    settings: ShowingSettings,
) -> None:
    """Teach the mistaken object; measure before and after on pictures that had no part in choosing it."""
    context = classroom.context
    company = [spec for spec in unknown if spec.name != stranger.name][:COMPANY]
    shown = [stranger, *company]
    with context.stage("before"):
        everyone = Tabletop(frames=settings.looks, strangers=(len(shown), len(shown)))
        looks = classroom.look(taught, shown, everyone, context.rng("measure"))
        before = classroom.recognise(looks)
    with context.stage("correct"):
        report, sample, _ = classroom.teach(stranger, settings.frames, context.rng("correct"))
    with context.stage("after"):
        after = classroom.recognise(looks)

    def of_stranger(found: Sequence[tuple[Instance, ...]]) -> list[list[Mistake]]:
        return [[m for m in picture if m.shown == stranger.name] for picture in _all_mistakes(found, looks)]

    mistaken = of_stranger(before)
    earlier = [m for picture in mistaken for m in picture]
    answers = [recognised(found, truth, stranger.name) for found, (_, truth) in zip(after, looks, strict=True)]
    visible = [answer for answer in answers if answer is not None]
    names = [spec.name for spec in taught]

    def precision(found: Sequence[tuple[Instance, ...]]) -> float:
        pairs = [(_of(names, truth), _of(names, instances)) for instances, (_, truth) in zip(found, looks, strict=True)]
        return evaluate_instances([t for t, _ in pairs], [f for _, f in pairs], names).map50_segm

    context.record(
        {
            "showing.corrected": stranger.name,
            "showing.taken_for": Counter(m.taken_for for m in earlier).most_common(1)[0][0] if earlier else "",
            "showing.looks_with_corrected": len(visible),
            "showing.false_positives_before": len(earlier),
            "showing.false_positives_after": sum(map(len, of_stranger(after))),
            "showing.corrected_recall": float(np.mean(visible)) if visible else 0.0,
            "showing.correct_update_seconds": report.seconds,
            "showing.map50_segm_before": precision(before),
            "showing.map50_segm_after": precision(after),
        }
    )
    chosen = sorted(range(len(looks)), key=lambda n: not mistaken[n])[: seeing.SHEET_COLUMNS]
    for caption, name, found in (("Before", "before.png", before), ("After", "after.png", after)):
        pictures = [draw_instances(looks[n][0].rgb, seeing.confident(found[n])) for n in chosen]
        seeing.save_sheet(context, f"{caption} '{stranger.name}' was taught", name, pictures)
    seeing.save_sheet(context, f"The correction: '{stranger.name}' is shown", "correction.png", [sample])


def _of(names: Sequence[str], instances: Sequence[Instance]) -> tuple[Instance, ...]:
    return tuple(instance for instance in instances if instance.label in names)


def _all_mistakes(found: Sequence[tuple[Instance, ...]], looks: Sequence[Look]) -> list[list[Mistake]]:
    return [mistakes(instances, truth) for instances, (_, truth) in zip(found, looks, strict=True)]


def _most_mistaken(wrong: Sequence[Mistake], unknown: Sequence[ObjectSpec]) -> ObjectSpec | None:
    """Return the unknown object that was most often taken for a taught one, the first of equals."""
    counts = Counter(mistake.shown for mistake in wrong)
    candidates = [spec for spec in unknown if counts[spec.name]]
    return max(candidates, key=lambda spec: counts[spec.name]) if candidates else None
