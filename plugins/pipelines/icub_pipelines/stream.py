"""Learning from a stream: features are extracted while frames arrive, and what is waited for after the last is known.

The source (a camera, a simulator) and the extraction of features run side by side, with a bounded queue between
them: a source that is faster than the extraction waits, so memory stays bounded and no frame is lost. Frames are
learned from in the order in which they came, one at a time, so the result is that of the batch protocol on the same
frames and seed.

Source: thesis 11.7 and appendix C, the stream-based scenario.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType

from icub_core.data import Instance, RgbdFrame
from icub_core.errors import ConfigError, DataError
from icub_core.interfaces.segmenter import Segmenter, UpdateReport

logger = logging.getLogger(__name__)

ON_ERROR = ("stop", "skip")

Sample = tuple[RgbdFrame, tuple[Instance, ...]]


@dataclass(frozen=True)
class StreamReport:
    """What learning from a stream took.

    Attributes:
        update: Of the heads.
        seconds_after_last_frame: From the arrival of the last frame until the heads were trained: frames still in the
            queue, and the update.
        frames: Learned from.
        skipped: Frames that could not be learned from (``on_error="skip"``).
        waited: Seconds that the source was held back because the queue was full.
        longest_queue: Frames that waited at most.
    """

    update: UpdateReport
    seconds_after_last_frame: float
    frames: int
    skipped: int
    waited: float
    longest_queue: int


class StreamTeacher:
    """Feeds a segmenter from a stream.

        with StreamTeacher(segmenter) as teacher:
            for frame, instances in camera:
                teacher.push(frame, instances)
            report = teacher.finish()

    Nothing else may use the segmenter between the first `push` and the end of `finish`. Leaving the context without
    `finish` (on an exception, say) stops after the frame that is being learned from.
    """

    def __init__(self, segmenter: Segmenter, capacity: int = 8, on_error: str = "stop") -> None:
        """Start the thread that extracts features; it waits for the first frame.

        Args:
            segmenter: Learns.
            capacity: Frames that may wait at most.
            on_error: ``"stop"``: a frame that cannot be learned from ends the stream with its error; ``"skip"``: it is
                left out with a warning.
        """
        if capacity < 1:
            raise ConfigError(f"capacity is {capacity}; expected at least 1 frame")
        if on_error not in ON_ERROR:
            raise ConfigError(f"on_error is '{on_error}'; expected one of {', '.join(ON_ERROR)}")
        self._segmenter, self._skips = segmenter, on_error == "skip"
        self._queue: queue.Queue[Sample | None] = queue.Queue(capacity)
        self._error: BaseException | None = None
        self._stopped = threading.Event()
        self._frames = self._skipped = self._longest = 0
        self._waited, self._last = 0.0, time.perf_counter()
        self._thread = threading.Thread(target=self._work, name="feature extraction", daemon=True)
        self._thread.start()

    def push(self, frame: RgbdFrame, instances: Sequence[Instance]) -> None:
        """Hand over one annotated frame; returns when there is room for it in the queue.

        Raises:
            DataError: An earlier frame could not be learned from (``on_error="stop"``); or the stream has ended.
        """
        self._raise_error()
        if self._stopped.is_set():
            raise DataError("the stream has ended; start another StreamTeacher for more frames")
        arrived = time.perf_counter()
        self._put((frame, tuple(instances)))
        self._last = arrived
        self._waited += time.perf_counter() - arrived
        self._longest = max(self._longest, self._queue.qsize())

    def drain(self) -> None:
        """Extract what is still in the queue and end the stream, without training the heads.

        Raises:
            DataError: A frame could not be learned from (``on_error="stop"``).
        """
        self._put(None)
        self._thread.join()
        self._stopped.set()
        self._raise_error()

    def finish(self) -> StreamReport:
        """Extract what is still in the queue and train the heads.

        Raises:
            DataError: A frame could not be learned from (``on_error="stop"``).
        """
        self.drain()
        update = self._segmenter.update()
        after = time.perf_counter() - self._last
        return StreamReport(update, after, self._frames, self._skipped, self._waited, self._longest)

    def __enter__(self) -> StreamTeacher:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._thread.join()

    def _put(self, item: Sample | None) -> None:
        # in short waits, since the thread that would make room may have stopped
        while self._thread.is_alive() and not self._stopped.is_set():
            try:
                self._queue.put(item, timeout=0.1)
                return
            except queue.Full:
                continue
        self._raise_error()

    def _work(self) -> None:
        number = 0
        while not self._stopped.is_set():
            try:
                item = self._queue.get(timeout=0.1)
            except queue.Empty:
                continue
            if item is None:
                return
            try:
                self._segmenter.observe(*item)
                self._frames += 1
            except DataError as error:
                if not self._skips:
                    self._error = DataError(f"frame {number} of the stream: {error}")
                    self._error.__cause__ = error
                    return
                logger.warning("frame %d of the stream is left out: %s", number, error)
                self._skipped += 1
            except BaseException as error:
                self._error = error
                return
            number += 1

    def _raise_error(self) -> None:
        if self._error is not None:
            error, self._error = self._error, None
            self._stopped.set()
            raise error
