"""The stages teach, learn and see: a segmenter is taught, and evaluated on cluttered tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from icub_core.construct import build
from icub_core.data import Instance, RgbdFrame
from icub_core.errors import DataError
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.segmenter import Segmenter
from icub_core.interfaces.simulator import Simulator
from icub_core.robot_description import RobotDescription
from icub_core.run import Run
from icub_core.scene import ObjectSpec, Scene, Table
from icub_pipelines.images import Image, contact_sheet, draw_instances, save_image
from icub_pipelines.settings import SeeSettings
from icub_pipelines.stream import StreamTeacher
from icub_pipelines.tabletop import Tabletop, tabletop_images
from icub_pipelines.teacher import Showing, annotate, show
from icub_support.appearance import random_lights, random_surface
from icub_support.detection import evaluate_instances

SHEET_COLUMNS = 4
DISTRACTOR_SIZE = (0.08, 0.2)
"""Smallest and largest extent to which distractors are scaled, meters: sizes alone must not give the targets away."""


def teach(
    run: Run,
    simulator: Simulator,
    robot: RobotDescription,
    specs: Sequence[ObjectSpec],
    segmenter: Segmenter,
    frames: int,
) -> None:
    """Show every object to the robot; features are extracted as the frames arrive, nothing is trained yet."""
    rng = run.rng("teach")
    samples: list[Image] = []
    annotated = 0
    for number, spec in enumerate(specs):

        def tell(share: float, text: str, number: int = number) -> None:
            run.progress((number + share) / len(specs), text)

        seen, sample = teach_object(simulator, robot, spec, segmenter, frames, rng, tell)
        annotated += seen
        samples.append(sample)
    run.record({"teach.objects": len(specs), "teach.frames": annotated})
    save_sheet(run, "Taught: masks from depth", "taught.png", samples)


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
    shown = show(simulator, spec.name, Showing(frames=frames), rng, robot.camera().name)
    with StreamTeacher(segmenter) as teacher:  # the next image is taken while features are extracted
        for frame, instance in annotate(shown, spec.name):
            teacher.push(frame, (instance,))
            seen += 1
            progress(min(seen / frames, 1.0), f"{spec.name}, {seen} frames")
            if sample is None or seen == frames // 2:
                sample = draw_instances(frame.rgb, (instance,))
        teacher.drain()
    if sample is None:
        raise DataError(f"no frame of '{spec.name}' gave a mask that agrees with its neighbors; show it more slowly")
    return seen, sample


def learn(run: Run, segmenter: Segmenter) -> None:
    """Train the heads on what was observed."""
    report = segmenter.update()
    run.record({"segmentation.train_seconds": report.seconds})
    run.record({f"segmentation.train_{part}_seconds": seconds for part, seconds in report.parts.items()})


def see(
    run: Run,
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
    pictures = tabletop_images(simulator, targets, distractors, Tabletop(frames=settings.frames), run.rng("see"))
    for number, (frame, present) in enumerate(pictures):
        found = segmenter.segment(frame)
        truths.append(tuple(instance for instance in present if instance.label in names))
        predictions.append(found)
        if len(examples) < 2 * SHEET_COLUMNS:
            examples.append(draw_instances(frame.rgb, confident(found)))
        run.progress((number + 1) / settings.frames, f"{number + 1} of {settings.frames} images")
    metrics = evaluate_instances(truths, predictions, names)
    run.record(metrics.as_dict("segmentation."))
    run.record({"segmentation.test_frames": len(truths), "segmentation.test_objects": sum(map(len, truths))})
    save_sheet(run, "Seen on the table, among distractors, in other rooms", "seen.png", examples)


def distractors(
    objects: ObjectSet, taught: Sequence[str], settings: SeeSettings, rng: np.random.Generator
) -> list[ObjectSpec]:
    """Draw objects that are never taught: half of them from the rest of the object set, the others random ones."""
    count = settings.count
    others = [name for name in objects.names if name not in taught]
    if settings.distractor_set is None:
        return [objects.get(name) for name in others[:count]]
    rest = [objects.get(name) for name in others[: count // 2]]
    random = build("objects", settings.distractor_set, size=list(DISTRACTOR_SIZE))
    drawn = rng.choice(len(random.names), count - len(rest), replace=False)
    return rest + [random.get(random.names[i]) for i in sorted(drawn)]


def confident(instances: Sequence[Instance]) -> tuple[Instance, ...]:
    """Return the instances that a user would be shown: score above 0, at most one per class."""
    best: dict[str, Instance] = {}
    for instance in instances:
        if instance.score > 0 and (instance.label not in best or instance.score > best[instance.label].score):
            best[instance.label] = instance
    return tuple(best.values())


def find_mask(segmenter: Segmenter, frame: RgbdFrame, name: str) -> NDArray[np.bool_] | None:
    """Return the mask of the best instance called `name`, or None when the segmenter does not see it."""
    candidates = [instance for instance in segmenter.segment(frame) if instance.label == name]
    return max(candidates, key=lambda instance: instance.score).mask if candidates else None


def save_sheet(run: Run, caption: str, file_name: str, images: Sequence[Image]) -> None:
    """Write images of one size as one image into the run folder, for the report."""
    if images:
        path = run.run_dir / file_name
        save_image(path, contact_sheet(images, SHEET_COLUMNS))
        run.images.append((caption, path))
