"""Learning from a stream promises: the batch protocol's result, a bounded queue, no frame lost, errors that name it."""

import threading
import time

import numpy as np
import pytest

from icub_core.errors import ConfigError, DataError, NotFittedError
from icub_core.interfaces.segmenter import UpdateReport
from icub_pipelines.stream import StreamTeacher
from icub_segmenters.heads.falkon import Falkon
from icub_segmenters.online_segmenter import OnlineSegmenter
from icub_testing.tiny import tiny_class
from icub_testing.tiny.things import draw_frame


def training_images(count=4):
    for color in ("red", "blue"):
        for i in range(count):
            yield draw_frame({color: (45 + 18 * i, 45 + 9 * i, 16)}, seed=i)


def learner():
    def head():
        return Falkon(sigma=15.0, penalty=1e-5, n_centers=100)

    return OnlineSegmenter(tiny_class("feature_extractor")(), head, composites=1, seed=3)


def test_a_stream_teaches_what_the_same_frames_teach_at_once():
    batch = learner()
    for frame, instances in training_images():
        batch.observe(frame, instances)
    batch.update()
    streamed = learner()
    with StreamTeacher(streamed, capacity=2) as teacher:
        for frame, instances in training_images():
            teacher.push(frame, instances)
        report = teacher.finish()
    assert (report.frames, report.skipped) == (8, 0)
    assert report.update.classes == ("red", "blue")
    assert report.seconds_after_last_frame >= report.update.seconds
    frame, _ = draw_frame({"red": (50, 52, 17), "blue": (105, 80, 17)}, seed=7)
    expected, found = batch.segment(frame), streamed.segment(frame)
    assert len(found) == len(expected) > 0
    for a, b in zip(found, expected, strict=True):
        assert (a.label, a.score) == (b.label, b.score)
        assert np.array_equal(a.mask, b.mask)


class Slow:
    """Takes its time over a frame, and fails where it is told to."""

    def __init__(self, seconds=0.0, fails=(), error=DataError):
        self.seconds, self.fails, self.error = seconds, fails, error
        self.seen, self.threads = [], set()

    def observe(self, frame, instances):
        time.sleep(self.seconds)
        self.threads.add(threading.current_thread().name)
        if len(self.seen) in self.fails:
            self.seen.append(None)
            raise self.error("the mask of 'cup' is empty")
        self.seen.append(frame.stamp)

    def update(self):
        return UpdateReport(0.0)


def test_a_source_that_is_too_fast_is_held_back_and_loses_nothing():
    slow = Slow(0.02)
    with StreamTeacher(slow, capacity=3) as teacher:
        start = time.perf_counter()
        frames = [frame for frame, _ in training_images(6)]
        for frame in frames:
            teacher.push(frame, ())
        pushed = time.perf_counter() - start
        report = teacher.finish()
    assert len(slow.seen) == report.frames == 12
    assert report.longest_queue <= 3
    assert report.waited > 0.06  # at most 4 of 12 frames are in flight: the others had to be finished first
    assert pushed >= report.waited
    assert report.seconds_after_last_frame >= 0.02  # what was still in the queue
    assert slow.threads == {"feature extraction"}


def test_a_source_that_is_slow_does_not_wait():
    with StreamTeacher(Slow()) as teacher:
        for frame, _ in training_images(2):
            time.sleep(0.01)
            teacher.push(frame, ())
        report = teacher.finish()
    assert report.longest_queue <= 2
    assert report.waited < 0.05


def test_a_bad_frame_ends_the_stream_with_its_number_or_is_skipped_by_choice(caplog):
    samples = list(training_images(4))
    with StreamTeacher(Slow(fails={2})) as teacher, pytest.raises(DataError, match="frame 2 of the stream: the mask"):  # noqa: PT012
        for frame, _ in samples:
            teacher.push(frame, ())
        teacher.finish()
    slow = Slow(fails={2, 5})
    with StreamTeacher(slow, on_error="skip") as teacher:
        for frame, _ in samples:
            teacher.push(frame, ())
        report = teacher.finish()
    assert (report.frames, report.skipped) == (6, 2)
    assert "frame 2 of the stream is left out: the mask of 'cup' is empty" in caplog.text


def test_an_error_that_is_no_frames_fault_is_never_skipped():
    with StreamTeacher(Slow(fails={0}, error=MemoryError), on_error="skip") as teacher, pytest.raises(MemoryError):  # noqa: PT012
        teacher.push(next(training_images())[0], ())
        teacher.finish()


def test_an_exception_of_the_source_ends_the_thread_at_once():
    slow = Slow(0.05)
    with pytest.raises(KeyboardInterrupt), StreamTeacher(slow) as teacher:  # noqa: PT012
        for frame, _ in training_images(4):
            teacher.push(frame, ())
        raise KeyboardInterrupt
    assert not any(thread.name == "feature extraction" for thread in threading.enumerate())
    assert len(slow.seen) < 8


def test_an_ended_stream_takes_no_more_frames_and_an_empty_one_teaches_nothing():
    frame, instances = next(training_images())
    with StreamTeacher(learner()) as teacher:
        with pytest.raises(NotFittedError):
            teacher.finish()
        with pytest.raises(DataError, match="the stream has ended"):
            teacher.push(frame, instances)


@pytest.mark.parametrize(("options", "message"), [({"capacity": 0}, "capacity is 0"), ({"on_error": "halt"}, "skip")])
def test_impossible_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        StreamTeacher(Slow(), **options)
