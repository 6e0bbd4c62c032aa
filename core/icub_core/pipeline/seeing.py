"""The stages teach, learn and see: a segmenter is taught by showing and examined on the table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, DataError
from icub_core.evaluation.detection import evaluate_instances
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.segmenter import Segmenter
from icub_core.interfaces.simulator import Simulator
from icub_core.pipeline.appearance import random_lights, random_surface
from icub_core.pipeline.context import RunContext
from icub_core.pipeline.pictures import Image, contact_sheet, draw_instances, save_picture
from icub_core.pipeline.settings import SeeSettings, TeachSettings
from icub_core.pipeline.tabletop import Tabletop, tabletop_pictures
from icub_core.pipeline.teacher import Showing, annotate, show
from icub_core.robot_description import RobotDescription
from icub_core.scene import ObjectSpec, Scene, Table

SHEET_COLUMNS = 4


def teach(
    context: RunContext,
    simulator: Simulator,
    robot: RobotDescription,
    objects: ObjectSet,
    segmenter: Segmenter,
    settings: TeachSettings,
) -> None:
    """Show every object to the robot; features are extracted as the frames arrive, nothing is trained yet."""
    if not settings.objects:
        raise ConfigError("pipeline.teach.objects is empty; expected at least one name of the object set")
    specs = [objects.get(name) for name in settings.objects]
    rng = context.rng("teach")
    samples: list[Image] = []
    annotated = 0
    for number, spec in enumerate(specs):
        table = Table(material=random_surface(rng))
        scene = Scene(objects=(spec,), table=table, floor=random_surface(rng), lights=random_lights(rng))
        simulator.load(robot, scene)
        simulator.reset()
        frames = show(simulator, spec.name, Showing(frames=settings.frames), rng)
        seen = 0
        for frame, instance in annotate(frames, spec.name):
            segmenter.observe(frame, (instance,))
            seen += 1
            share = (number + min(seen / settings.frames, 1.0)) / len(specs)
            context.progress(share, f"{spec.name}, {seen} frames")
            if seen == settings.frames // 2:
                samples.append(draw_instances(frame.rgb, (instance,)))
        if seen == 0:
            raise DataError(
                f"no frame of '{spec.name}' gave a mask that agrees with its neighbours; show it more slowly"
            )
        annotated += seen
    context.record({"teach.objects": len(specs), "teach.frames": annotated})
    _sheet(context, "Taught: masks from depth", "taught.png", samples)


def learn(context: RunContext, segmenter: Segmenter) -> None:
    """Train the heads on what was observed."""
    report = segmenter.update()
    context.record({"segmentation.train_seconds": report.seconds})
    context.record({f"segmentation.train_{part}_seconds": seconds for part, seconds in report.parts.items()})


def see(
    context: RunContext,
    simulator: Simulator,
    targets: Sequence[ObjectSpec],
    strangers: Sequence[ObjectSpec],
    segmenter: Segmenter,
    settings: SeeSettings,
) -> None:
    """Examine the segmenter on the table, among objects it never saw."""
    truths: list[tuple[Instance, ...]] = []
    predictions: list[tuple[Instance, ...]] = []
    examples: list[Image] = []
    pictures = tabletop_pictures(simulator, targets, strangers, Tabletop(frames=settings.frames), context.rng("see"))
    for number, (frame, truth) in enumerate(pictures):
        found = segmenter.segment(frame)
        truths.append(truth)
        predictions.append(found)
        if len(examples) < 2 * SHEET_COLUMNS:
            examples.append(draw_instances(frame.rgb, confident(found)))
        context.progress((number + 1) / settings.frames, f"{number + 1} of {settings.frames} pictures")
    metrics = evaluate_instances(truths, predictions, [spec.name for spec in targets])
    context.record(metrics.as_dict("segmentation."))
    context.record({"segmentation.test_frames": len(truths), "segmentation.test_objects": sum(map(len, truths))})
    _sheet(context, "Seen on the table, among strangers, in other rooms", "seen.png", examples)


def confident(instances: Sequence[Instance]) -> tuple[Instance, ...]:
    """Return the instances that a user would be shown: score above 0, at most one a class."""
    best: dict[str, Instance] = {}
    for instance in instances:
        if instance.score > 0 and (instance.label not in best or instance.score > best[instance.label].score):
            best[instance.label] = instance
    return tuple(best.values())


def find_mask(segmenter: Segmenter, frame: RgbdFrame, name: str) -> NDArray[np.bool_] | None:
    """Return the mask of the best instance called `name`, or None when the segmenter does not see it."""
    candidates = [instance for instance in segmenter.segment(frame) if instance.label == name]
    return max(candidates, key=lambda instance: instance.score).mask if candidates else None


def _sheet(context: RunContext, caption: str, file_name: str, images: Sequence[Image]) -> None:
    if images:
        path = context.run_dir / file_name
        save_picture(path, contact_sheet(images, SHEET_COLUMNS))
        context.pictures.append((caption, path))
