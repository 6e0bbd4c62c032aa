"""Processes that do jobs, watched: one that dies or hangs is replaced, and no more than its job is lost."""

from __future__ import annotations

import logging
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Generic, TypeVar

from icub_core.errors import ConfigError, IcubError, SimulationError

Job = TypeVar("Job")
Result = TypeVar("Result")

logger = logging.getLogger(__name__)

_READY, _DONE, _FAILED = "ready", "done", "failed"
_MAX_WAIT = 1.0
"""Seconds between two looks for workers that hang."""


@dataclass
class _Worker:
    process: BaseProcess
    connection: Connection
    ready: bool = False
    job: int | None = None
    since: float = 0.0


class Workers(Generic[Job, Result]):
    """A number of processes, each with a handler of its own that `make` builds there.

    Jobs, results and `make` travel between processes, so they are functions and classes of importable modules; a script
    that uses this keeps its main part behind ``if __name__ == "__main__"``.

    Args:
        make: Builds the handler of jobs, once in each process.
        count: Processes.
        patience: Seconds that a job may take, setting up included, before its worker counts as hung.
    """

    def __init__(self, make: Callable[[], Callable[[Job], Result]], count: int, patience: float = 600.0) -> None:
        if count < 1 or patience <= 0:
            raise ConfigError(f"{count} workers with {patience} s of patience; expected at least 1, and more than 0 s")
        # a fork would share locks and graphics contexts of whatever threads the caller has
        self._context = multiprocessing.get_context("spawn")
        self._make, self._patience = make, patience
        self._workers = [self._start() for _ in range(count)]
        self.replaced = 0

    def __enter__(self) -> Workers[Job, Result]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def map(self, jobs: Sequence[Job], progress: Callable[[int], None] | None = None) -> list[Result | None]:
        """Do all jobs; returns their results in order, None for a job whose worker was lost.

        Args:
            jobs: What the handlers take.
            progress: Told how many jobs are over, after each.

        Raises:
            IcubError: What a handler raised; a SimulationError for errors that are not this project's, and for a worker
                that dies before it is set up.
        """
        results: list[Result | None] = [None] * len(jobs)
        waiting, over = deque(range(len(jobs))), 0
        while over < len(jobs):
            for worker in self._workers:
                if worker.job is None and waiting:
                    worker.job, worker.since = waiting.popleft(), time.monotonic()
                    with suppress(OSError):  # a worker that died idle is found below
                        worker.connection.send(jobs[worker.job])
            busy = [worker for worker in self._workers if worker.job is not None]
            heard = wait([worker.connection for worker in busy], timeout=min(_MAX_WAIT, self._patience))
            for worker in busy:
                job = worker.job
                assert job is not None
                if worker.connection in heard:
                    answer = _receive(worker)
                    if answer is None:
                        self._replace(worker, f"died (exit status {_status(worker)})")
                    elif answer[0] == _READY:
                        worker.ready = True
                        continue
                    elif answer[0] == _FAILED:
                        raise answer[1]
                    else:
                        results[job], worker.job = answer[1], None
                elif time.monotonic() - worker.since > self._patience:
                    self._replace(worker, f"gave no answer for {self._patience:.0f} s")
                else:
                    continue
                over += 1
                if progress is not None:
                    progress(over)
        return results

    def close(self) -> None:
        """End all processes; may be called twice."""
        for worker in self._workers:
            _end(worker)
        self._workers = []

    def _start(self) -> _Worker:
        here, there = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(self._make, there), daemon=True)
        process.start()
        there.close()  # so that the end of the process is the end of the pipe
        return _Worker(process, here)

    def _replace(self, worker: _Worker, reason: str) -> None:
        logger.warning("a worker %s; its job is lost, another takes its place", reason)
        _end(worker)
        if not worker.ready:
            raise SimulationError(f"a worker {reason} before it was set up")
        self._workers[self._workers.index(worker)] = self._start()
        self.replaced += 1


def _serve(make: Callable[[], Callable[[Job], Result]], connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted, too, and ends its workers
    try:
        handle = make()
        connection.send((_READY, None))
        while True:
            connection.send((_DONE, handle(connection.recv())))
    except (EOFError, ConnectionError):  # the parent has gone
        return
    except IcubError as error:
        connection.send((_FAILED, error))
    except Exception as error:
        logger.debug("worker failed", exc_info=True)
        connection.send((_FAILED, SimulationError(f"a worker failed: {type(error).__name__}: {error}")))


def _receive(worker: _Worker) -> tuple[str, Any] | None:
    try:
        answer: tuple[str, Any] = worker.connection.recv()
    except (EOFError, OSError):
        return None
    return answer


def _status(worker: _Worker) -> int | None:
    worker.process.join(_MAX_WAIT)
    return worker.process.exitcode


def _end(worker: _Worker) -> None:
    worker.connection.close()
    worker.process.kill()
    worker.process.join()
