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
from icub_core.scene import ObjectSpec
from icub_pipelines import seeing
from icub_pipelines.context import RunContext
from icub_pipelines.conversation import converse
from icub_pipelines.images import draw_instances
from icub_pipelines.lifecycle import carry_out
from icub_pipelines.settings import ShowingSettings, shown
from icub_pipelines.tabletop import Tabletop
from icub_pipelines.teaching_session import Look, Mistake, TeachingSession, mistakes, recognized

OBJECTS = 3
"""Shown when nothing was chosen."""
DEPENDENCIES = 3
"""Other unknown objects that stand beside the corrected one in the images that measure the correction."""


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
    unknown = seeing.distractors(objects, names, settings.distractors, context.rng("strangers"))
    simulator = plugins.fresh("simulator")
    session = TeachingSession(context, simulator, plugins.get("robot").description, plugins.get("segmenter"))
    try:
        if settings.interactive:
            converse(session, objects, unknown, settings)
        else:
            _script(session, taught, unknown, settings)
    finally:
        simulator.close()


def _script(
    session: TeachingSession, taught: Sequence[ObjectSpec], unknown: Sequence[ObjectSpec], settings: ShowingSettings
) -> None:
    context = session.context
    if context.recall("teach"):
        session.segmenter.load(session.heads)
    else:
        _teach_all(session, taught, settings)
        session.segmenter.save(session.heads)
        context.remember("teach")
    with context.stage("look"):
        looks = session.look(taught, unknown, Tabletop(frames=settings.looks), context.rng("look"))
        wrong = [mistake for m in _all_mistakes(session.recognize(looks), looks) for mistake in m]
    distractor = _most_mistaken(wrong, unknown)
    if distractor is None:
        context.note(f"no unknown object was taken for a taught one in {settings.looks} images: nothing to correct")
        context.record({"showing.false_positives_before": 0})
        return
    _correct(session, taught, unknown, distractor, settings)
    session.segmenter.save(session.heads)


def _teach_all(session: TeachingSession, taught: Sequence[ObjectSpec], settings: ShowingSettings) -> None:
    context, rng = session.context, session.context.rng("teach")
    training_images = []
    for number, spec in enumerate(taught):
        with context.stage(f"teach {number + 1}"):
            training_images.append(session.teach(spec, settings.frames, rng))
    seeing.save_sheet(context, "Taught: masks from depth", "taught.png", [sample for _, sample, _ in training_images])
    context.record(
        {
            "showing.objects": len(taught),
            "showing.teach_seconds": float(np.mean([seconds for _, _, seconds in training_images])),
            "showing.update_seconds": max(report.seconds for report, _, _ in training_images),
        }
    )


def _correct(
    session: TeachingSession,
    taught: Sequence[ObjectSpec],
    unknown: Sequence[ObjectSpec],
    distractor: ObjectSpec,
    settings: ShowingSettings,
) -> None:
    """Teach the mistaken object; measure before and after on images that had no part in choosing it."""
    context = session.context
    dependencies = [spec for spec in unknown if spec.name != distractor.name][:DEPENDENCIES]
    shown = [distractor, *dependencies]
    with context.stage("before"):
        everyone = Tabletop(frames=settings.looks, distractors=(len(shown), len(shown)))
        looks = session.look(taught, shown, everyone, context.rng("measure"))
        before = session.recognize(looks)
    with context.stage("correct"):
        report, sample, _ = session.teach(distractor, settings.frames, context.rng("correct"))
    with context.stage("after"):
        after = session.recognize(looks)

    def of_distractor(found: Sequence[tuple[Instance, ...]]) -> list[list[Mistake]]:
        return [[m for m in picture if m.shown == distractor.name] for picture in _all_mistakes(found, looks)]

    mistaken = of_distractor(before)
    earlier = [m for picture in mistaken for m in picture]
    answers = [recognized(found, truth, distractor.name) for found, (_, truth) in zip(after, looks, strict=True)]
    visible = [answer for answer in answers if answer is not None]
    names = [spec.name for spec in taught]

    def precision(found: Sequence[tuple[Instance, ...]]) -> float:
        pairs = [(_of(names, truth), _of(names, instances)) for instances, (_, truth) in zip(found, looks, strict=True)]
        return evaluate_instances([t for t, _ in pairs], [f for _, f in pairs], names).map50_segm

    context.record(
        {
            "showing.corrected": distractor.name,
            "showing.taken_for": Counter(m.taken_for for m in earlier).most_common(1)[0][0] if earlier else "",
            "showing.looks_with_corrected": len(visible),
            "showing.false_positives_before": len(earlier),
            "showing.false_positives_after": sum(map(len, of_distractor(after))),
            "showing.corrected_recall": float(np.mean(visible)) if visible else 0.0,
            "showing.correct_update_seconds": report.seconds,
            "showing.map50_segm_before": precision(before),
            "showing.map50_segm_after": precision(after),
        }
    )
    chosen = sorted(range(len(looks)), key=lambda n: not mistaken[n])[: seeing.SHEET_COLUMNS]
    for caption, name, found in (("Before", "before.png", before), ("After", "after.png", after)):
        pictures = [draw_instances(looks[n][0].rgb, seeing.confident(found[n])) for n in chosen]
        seeing.save_sheet(context, f"{caption} '{distractor.name}' was taught", name, pictures)
    seeing.save_sheet(context, f"The correction: '{distractor.name}' is shown", "correction.png", [sample])


def _of(names: Sequence[str], instances: Sequence[Instance]) -> tuple[Instance, ...]:
    return tuple(instance for instance in instances if instance.label in names)


def _all_mistakes(found: Sequence[tuple[Instance, ...]], looks: Sequence[Look]) -> list[list[Mistake]]:
    return [mistakes(instances, truth) for instances, (_, truth) in zip(found, looks, strict=True)]


def _most_mistaken(wrong: Sequence[Mistake], unknown: Sequence[ObjectSpec]) -> ObjectSpec | None:
    """Return the unknown object that was most often taken for a taught one, the first of equals."""
    counts = Counter(mistake.shown for mistake in wrong)
    candidates = [spec for spec in unknown if counts[spec.name]]
    return max(candidates, key=lambda spec: counts[spec.name]) if candidates else None
