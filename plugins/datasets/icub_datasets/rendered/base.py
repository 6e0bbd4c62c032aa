"""What rendered TARGET-TASKs share: sequences, rendering on demand, the disk."""

from __future__ import annotations

import importlib.util
import logging
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path

import numpy as np

from icub_core import registry
from icub_core.construct import build
from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, PluginError, unknown_name
from icub_core.interfaces.dataset import Dataset
from icub_core.interfaces.simulator import Rendering, Simulator
from icub_core.scene import ObjectSpec
from icub_datasets.rendered import store
from icub_datasets.rendered.store import FrameStore, StoredFrame, digest

logger = logging.getLogger(__name__)

SPLITS = ("train", "val", "test")
"""Rooms, arrangements and movements of one split never occur in another."""
FRAME_RATE = 10.0
MINIMUM_VISIBLE_SHARE = 1e-3
"""An object that shows less of the image (77 pixels of 320 x 240) is not annotated."""


class RenderedDataset(Dataset):
    """Frames of sequences that are rendered when they are first asked for, and then kept on disk.

    Frame i depends on the constructor's parameters and on i only, never on what was asked for before, nor on the number
    of frames where the length of a sequence does not. Not to be used by two threads at once (the simulator's renderer
    belongs to one).

    Args:
        classes: Names of the target objects.
        split: ``"train"``, ``"val"`` or ``"test"``.
        frames: Number of frames.
        sequence_frames: Frames of one sequence.
        seed: Decides everything random.
        size: Width and height, pixels.
        engine: Registry name of the simulator that renders.
        sources: Files whose code decides how the frames look; a change of any renders all of them again.
    """

    def __init__(
        self,
        classes: tuple[str, ...],
        split: str,
        frames: int,
        sequence_frames: int,
        seed: int,
        size: tuple[int, int],
        engine: str,
        sources: tuple[str, ...],
    ) -> None:
        if split not in SPLITS:
            raise ConfigError(unknown_name("split of a rendered data set", split, SPLITS))
        if frames < 1 or seed < 0:
            raise ConfigError(f"a rendered data set has frames={frames}, seed={seed}; expected at least 1 and 0")
        if not 16 <= min(size) <= max(size) <= 4096:
            raise ConfigError(f"a rendered data set has images of {size[0]}x{size[1]}; expected 16 to 4096 pixels")
        registry.info("simulator", engine)  # an unknown name is refused now, not at the first frame
        self._classes = classes
        self._split = split
        self._frames = frames
        self._sequence_frames = sequence_frames
        self._seed = seed
        self._size = size
        self._engine = engine
        self._sources = sources
        self._store: FrameStore | None = None
        self._simulator: Simulator | None = None
        self._loaded: int | None = None

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the target objects."""
        return self._classes

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits."""
        return SPLITS

    def __len__(self) -> int:
        return self._frames

    def __getitem__(self, index: int) -> tuple[RgbdFrame, tuple[Instance, ...]]:
        if not -self._frames <= index < self._frames:
            raise IndexError(f"frame {index} of {self._frames}")
        index %= self._frames
        kept = self._frame_store.get(index)
        if kept is None:
            kept = self._render(index)
            self._frame_store.put(index, kept)
        return kept.unpack()

    def prepare(self, progress: Callable[[float, str], None]) -> None:
        """Render all frames that are not on disk yet; may be interrupted and called again.

        Args:
            progress: Called with the finished share (0..1) and a short text.
        """
        for index in range(self._frames):
            if self._frame_store.get(index) is None:
                self._frame_store.put(index, self._render(index))
            progress((index + 1) / self._frames, f"rendered {index + 1} of {self._frames} frames")

    def close(self) -> None:
        """Free the simulator; the next frame that is not on disk starts it again."""
        if self._simulator is not None:
            self._simulator.close()
        self._simulator, self._loaded = None, None

    @property
    def _frame_store(self) -> FrameStore:
        if self._store is None:
            code = [Path(file) for file in (*self._sources, __file__, store.__file__)]
            self._store = FrameStore(
                digest(
                    code, _code_of(self._engine), type(self).__name__, self._split, self._sequence_frames, self._seed,
                    self._size, self._objects(),
                )
            )  # fmt: skip
        return self._store

    def _rng(self, *purpose: int) -> np.random.Generator:
        """Return the generator of one purpose in this split."""
        return np.random.default_rng([self._seed, SPLITS.index(self._split), *purpose])

    def _render(self, index: int) -> StoredFrame:
        sequence, moment = divmod(index, self._sequence_frames)
        if self._simulator is None:
            self._simulator = build("simulator", self._engine)
        if self._loaded != sequence:
            self._loaded = None  # a failed load must not pass for the sequence
            self._load(self._simulator, sequence)
            self._loaded = sequence
        image = self._image(self._simulator, sequence, moment)
        return self._annotate(image, self._simulator, index)

    def _annotate(self, image: Rendering, simulator: Simulator, index: int) -> StoredFrame:
        """Number the visible target objects from 1; everything else is 0."""
        assert image.segmentation is not None
        shown = np.zeros(image.segmentation.shape, dtype=np.uint8)
        labels: list[str] = []
        least = max(1.0, MINIMUM_VISIBLE_SHARE * shown.size)
        for number, spec in enumerate(simulator.scene.objects):
            mask = image.segmentation == number
            if spec.name in self._classes and np.count_nonzero(mask) >= least:
                labels.append(spec.name)
                shown[mask] = len(labels)
        frame = image.frame
        stamped = RgbdFrame(frame.rgb, frame.depth, frame.intrinsics, frame.T_world_camera, index / FRAME_RATE)
        return StoredFrame.pack(stamped, shown, tuple(labels))

    @abstractmethod
    def _objects(self) -> tuple[ObjectSpec, ...]:
        """Return every object that may appear, for the name under which frames are kept."""

    @abstractmethod
    def _load(self, simulator: Simulator, sequence: int) -> None:
        """Build the room of a sequence."""

    @abstractmethod
    def _image(self, simulator: Simulator, sequence: int, moment: int) -> Rendering:
        """Take image number `moment` of the loaded sequence, with segmentation."""


def _code_of(engine: str) -> tuple[str, list[Path]]:
    """Return what tells one state of a simulator plugin from another, without importing its engine."""
    plugin = registry.info("simulator", engine)
    module = plugin.target.partition(":")[0]
    try:
        found = importlib.util.find_spec(module)
    except ImportError as error:
        raise PluginError(f"the simulator plugin '{engine}' ({plugin.target}) cannot be imported: {error}") from error
    origin = None if found is None else found.origin
    files = sorted(Path(origin).parent.glob("*.py")) if origin else []
    return f"{plugin.target} {plugin.distribution}", files
