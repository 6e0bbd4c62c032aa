"""The main job's teaching and examination as a pair of data sets, so that segmenters can be compared on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

import icub_core as icub
from icub_core.data import Instance, RgbdFrame
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.segmenter import Segmenter
from icub_pipelines import seeing
from icub_pipelines.settings import SeeSettings
from icub_pipelines.tabletop import Tabletop, tabletop_images

Sample = tuple[RgbdFrame, tuple[Instance, ...]]


class Frames(Dataset):
    """Frames that lie in memory."""

    def __init__(self, samples: Sequence[Sample], classes: Sequence[str]) -> None:
        """Take annotated frames whose labels are among `classes`."""
        self._samples, self._classes = list(samples), tuple(classes)

    @property
    def classes(self) -> tuple[str, ...]:
        """Class names in a fixed order."""
        return self._classes

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._samples)

    def __getitem__(self, index: int) -> Sample:
        """Frame and its instances."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return self._samples[index]


def taught_and_seen(
    seed: int,
    names: Sequence[str],
    frames: int,
    see: SeeSettings,
    engine: str = "mujoco",
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> tuple[Frames, Frames]:
    """Show objects to the robot and take test images, as the stages `teach` and `see` do.

    Args:
        seed: Decides rooms, movements, arrangements and distractors.
        names: Taught objects, from the object set ``ycb_primitives``.
        frames: Images of each object.
        see: How many test images and distractors.
        engine: Registry name of the simulator.
        progress: Called with the finished share and a text.

    Returns:
        Taught frames with masks from depth, and test frames with true masks of the taught objects.
    """
    rng = np.random.default_rng([seed, *b"shown"])
    simulator, objects = icub.load("simulator", engine), icub.load("objects", "ycb_primitives")
    robot = icub.load("robot", "icub").description
    try:
        recorder = _Recorder()
        targets = [objects.get(name) for name in names]
        for number, spec in enumerate(targets):

            def tell(share: float, text: str, number: int = number) -> None:
                progress(0.7 * (number + share) / len(targets), text)

            seeing.teach_object(simulator, robot, spec, cast(Segmenter, recorder), frames, rng, tell)
        others = seeing.distractors(objects, names, see, rng)
        test = []
        for frame, present in tabletop_images(simulator, targets, others, Tabletop(frames=see.frames), rng):
            test.append((frame, tuple(i for i in present if i.label in names)))
            progress(0.7 + 0.3 * len(test) / see.frames, f"{len(test)} of {see.frames} images")
    finally:
        simulator.close()
    return Frames(recorder.samples, names), Frames(test, names)


class _Recorder:
    """Stand-in for a segmenter that records its training frames."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def observe(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        self.samples.append((frame, tuple(instances)))
