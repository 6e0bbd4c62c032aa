"""The stages teach, learn and see: a segmenter is taught by showing and examined on the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from icub_core import registry
from icub_core.appearance import random_lights, random_surface
from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError
from icub_core.evaluation.detection import evaluate_instances
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.segmenter import Segmenter
from icub_core.interfaces.simulator import Simulator
from icub_core.robot_description import RobotDescription
from icub_core.scene import ObjectSpec, Scene, Table
from icub_pipelines.context import RunContext
from icub_pipelines.images import Image, contact_sheet, draw_instances, save_picture
from icub_pipelines.settings import SeeSettings
from icub_pipelines.tabletop import Tabletop, tabletop_pictures
from icub_pipelines.teacher import Showing, annotate, show

SHEET_COLUMNS = 4
DISTRACTORS_SET = "random1000"
DISTRACTOR_SIZE = (0.08, 0.2)
"""Smallest and largest extent to which distractors are scaled, meters: sizes alone must not give the targets away."""


def teach(
    context: RunContext,
    simulator: Simulator,
    robot: RobotDescription,
    specs: Sequence[ObjectSpec],
    segmenter: Segmenter,
    frames: int,
) -> None:
    """Show every object to the robot; features are extracted as the frames arrive, nothing is trained yet."""
    rng = context.rng("teach")
    samples: list[Image] = []
    annotated = 0
    for number, spec in enumerate(specs):

        def tell(share: float, text: str, number: int = number) -> None:
            context.progress((number + share) / len(specs), text)

        seen, sample = teach_object(simulator, robot, spec, segmenter, frames, rng, tell)
        annotated += seen
        samples.append(sample)
    context.record({"teach.objects": len(specs), "teach.frames": annotated})
    save_sheet(context, "Taught: masks from depth", "taught.png", samples)


def teach_object(
    simulator: Simulator,
    robot: RobotDescription,
    spec: ObjectSpec,
    segmenter: Segmenter,
    frames: int,
    rng: np.random.Generator,
    progress: Callable[[float, str], None],
) -> tuple[int, Image]:
    """Show one object in a room of its own; nothing is trained yet.

    Args:
        simulator: Its world is replaced.
        robot: Looks on.
        spec: What is shown, under its own name.
        segmenter: Observes.
        frames: Images taken.
        rng: Decides the room and how the object is moved.
        progress: Called with the finished share and a text.

    Returns:
        Number of annotated frames, and one of them with its mask drawn.

    Raises:
        DataError: No frame gave a mask.
    """
    table = Table(material=random_surface(rng))
    scene = Scene(objects=(spec,), table=table, floor=random_surface(rng), lights=random_lights(rng))
    simulator.load(robot, scene)
    simulator.reset()
    seen, sample = 0, None
    for frame, instance in annotate(show(simulator, spec.name, Showing(frames=frames), rng), spec.name):
        segmenter.observe(frame, (instance,))
        seen += 1
        progress(min(seen / frames, 1.0), f"{spec.name}, {seen} frames")
        if sample is None or seen == frames // 2:
            sample = draw_instances(frame.rgb, (instance,))
    if sample is None:
        raise DataError(f"no frame of '{spec.name}' gave a mask that agrees with its neighbors; show it more slowly")
    return seen, sample


def learn(context: RunContext, segmenter: Segmenter) -> None:
    """Train the heads on what was observed."""
    report = segmenter.update()
    context.record({"segmentation.train_seconds": report.seconds})
    context.record({f"segmentation.train_{part}_seconds": seconds for part, seconds in report.parts.items()})


def see(
    context: RunContext,
    simulator: Simulator,
    targets: Sequence[ObjectSpec],
    distractors: Sequence[ObjectSpec],
    segmenter: Segmenter,
    settings: SeeSettings,
) -> None:
    """Examine the segmenter on the table, among objects it never saw."""
    truths: list[tuple[Instance, ...]] = []
    predictions: list[tuple[Instance, ...]] = []
    examples: list[Image] = []
    names = [spec.name for spec in targets]
    pictures = tabletop_pictures(simulator, targets, distractors, Tabletop(frames=settings.frames), context.rng("see"))
    for number, (frame, present) in enumerate(pictures):
        found = segmenter.segment(frame)
        truths.append(tuple(instance for instance in present if instance.label in names))
        predictions.append(found)
        if len(examples) < 2 * SHEET_COLUMNS:
            examples.append(draw_instances(frame.rgb, confident(found)))
        context.progress((number + 1) / settings.frames, f"{number + 1} of {settings.frames} images")
    metrics = evaluate_instances(truths, predictions, names)
    context.record(metrics.as_dict("segmentation."))
    context.record({"segmentation.test_frames": len(truths), "segmentation.test_objects": sum(map(len, truths))})
    save_sheet(context, "Seen on the table, among distractors, in other rooms", "seen.png", examples)


def distractors(objects: ObjectSet, taught: Sequence[str], count: int, rng: np.random.Generator) -> list[ObjectSpec]:
    """Draw objects that are never taught: half of them from the rest of the object set, the others random ones."""
    rest = [objects.get(name) for name in objects.names if name not in taught][: count // 2]
    random = registry.build("objects", DISTRACTORS_SET, size=list(DISTRACTOR_SIZE))
    drawn = rng.choice(len(random.names), count - len(rest), replace=False)
    return rest + [random.get(random.names[i]) for i in sorted(drawn)]


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


def save_sheet(context: RunContext, caption: str, file_name: str, images: Sequence[Image]) -> None:
    """Write images of one size as one image into the run folder, for the report."""
    if images:
        path = context.run_dir / file_name
        save_picture(path, contact_sheet(images, SHEET_COLUMNS))
        context.pictures.append((caption, path))
