"""Pipeline: a run as a tuple of stages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from icub_core.run import Run


@dataclass(frozen=True)
class Stage:
    """One step of a run. Leaving out, timing, resuming and reporting are done by whoever runs the pipeline.

    Attributes:
        name: Key of its time and of its figures; shown while it runs.
        run: Does the work; figures, notes and images go into the `Run`.
        needs: Kinds that must be chosen, or the stage is left out.
        without: What the reader is told when it is left out.
        resume: Restores in memory, from the run folder, what the stage had left there when it was finished, and
            returns True; False when that is not to be had, and the stage is run again. None: it leaves only figures.
    """

    name: str
    run: Callable[[Run], None]
    needs: tuple[str, ...] = ()
    without: str = ""
    resume: Callable[[Run], bool] | None = None


class Pipeline(ABC):
    """What ``icub run`` does, as named stages. The constructor's parameters are the keys of the group `pipeline`.

    Contract: the stages of one composed run are the same at every call, in a fixed order, with different names;
    nothing expensive happens before a stage runs, except that wrong settings are refused.
    """

    @abstractmethod
    def stages(self, run: Run) -> tuple[Stage, ...]:
        """Return the stages of a run in their order.

        Raises:
            ConfigError: The run's composition cannot work.
        """
