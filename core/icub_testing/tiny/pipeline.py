"""A run of two stages that counts."""

from __future__ import annotations

from icub_core.interfaces.pipeline import Pipeline, Stage
from icub_core.run import Run


class TinyPipeline(Pipeline):
    """Counts, then checks the count.

    Args:
        steps: How far it counts.
    """

    def __init__(self, steps: int = 3) -> None:
        self._steps = steps

    def stages(self, run: Run) -> tuple[Stage, ...]:
        """Return count and verify."""
        return (
            Stage("count", self._count, resume=lambda run: (run.run_dir / "count.txt").exists()),
            Stage("verify", self._verify),
            Stage("name", self._name, needs=("robot",), without="no robot was chosen: nothing is named"),
        )

    def _count(self, run: Run) -> None:
        for step in range(self._steps):
            run.progress((step + 1) / self._steps, f"{step + 1}")
        (run.run_dir / "count.txt").write_text(str(self._steps), encoding="utf-8")
        run.record({"count.steps": self._steps})

    def _verify(self, run: Run) -> None:
        counted = int((run.run_dir / "count.txt").read_text(encoding="utf-8"))
        run.record({"verify.right": counted == self._steps})

    def _name(self, run: Run) -> None:
        run.record({"name.robot": run.plugins.get("robot").description.name})
