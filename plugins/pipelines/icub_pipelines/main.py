"""The main job: teach, learn, see, plan, grasp."""

from __future__ import annotations

import functools
from inspect import Parameter
from pathlib import Path

from icub_core.errors import ConfigError
from icub_core.interfaces.pipeline import Pipeline, Stage
from icub_core.interfaces.simulator import Simulator
from icub_core.interfaces.task import Task
from icub_core.kinds import KINDS
from icub_core.run import Run
from icub_pipelines import grasping, seeing
from icub_pipelines.settings import GraspSettings, SeeSettings, TeachSettings, target_name, taught_names

TAUGHT = 5
"""Objects that are taught when nothing was chosen."""


class Main(Pipeline):
    """Teach objects, find them on a cluttered table, plan grasps, learn to carry them out.

    Args:
        teach: What is taught.
        see: How the segmenter is evaluated.
        grasp: What is grasped, and how often.
        scripted_policy: Policy that carries planned grasps out when neither a segmenter nor a policy was chosen.
    """

    def __init__(
        self,
        teach: TeachSettings = TeachSettings(),  # noqa: B008 - frozen
        see: SeeSettings = SeeSettings(),  # noqa: B008 - frozen
        grasp: GraspSettings = GraspSettings(),  # noqa: B008 - frozen
        scripted_policy: str | None = None,
    ) -> None:
        self._teach, self._see, self._grasp, self._scripted = teach, see, grasp, scripted_policy

    def stages(self, run: Run) -> tuple[Stage, ...]:
        """Return teach, learn, see, plan, grasp; what cannot work is refused before anything starts."""
        plugins = run.plugins
        if self._scripted and not plugins.chosen("segmenter") and not plugins.chosen("policy"):
            plugins.choose("policy", self._scripted)
            run.note(
                f"no policy was chosen: planned grasps are carried out by '{self._scripted}'; +policy=NAME learns to"
            )
        objects = plugins.get("objects")
        self._names = taught_names(self._teach.objects, self._teach.preferred, objects.names, TAUGHT)
        known = self._names if plugins.chosen("segmenter") else objects.names
        if not known:
            raise ConfigError("pipeline.teach.objects is empty; expected at least one name of the object set")
        self._target = target_name(self._grasp.target, self._grasp.preferred, known)
        for name in self._names if plugins.chosen("segmenter") else ():
            objects.get(name)  # a misspelled name must not wait until its stage
        if plugins.chosen("policy"):
            objects.get(self._target)
            _check_task(run)
        for kind in ("segmenter", "policy", "grasp_generator"):
            if plugins.chosen(kind):
                plugins.get(kind)  # the same for a misspelled parameter or a missing weight file
        without = "no segmenter was chosen: masks are the simulator's ground truth"
        idle = "no policy was chosen: nothing is grasped; add +policy=NAME"
        segmenter, policy = ("segmenter",), ("policy",)
        return (
            Stage("teach", self._do_teach, segmenter, without, resume=lambda run: _heads(run).exists()),
            Stage("learn", self._do_learn, segmenter, without, resume=_load_heads),
            Stage("see", self._do_see, segmenter, without),
            Stage("plan", self._do_plan, policy, idle),
            Stage("grasp", self._do_grasp, policy, idle),
        )

    def _do_teach(self, run: Run) -> None:
        specs = [run.plugins.get("objects").get(name) for name in self._names]
        robot = run.plugins.get("robot").description
        seeing.teach(run, _simulator(run), robot, specs, run.plugins.get("segmenter"), self._teach.frames)

    def _do_learn(self, run: Run) -> None:
        seeing.learn(run, run.plugins.get("segmenter"))
        run.plugins.get("segmenter").save(_heads(run))

    def _do_see(self, run: Run) -> None:
        objects = run.plugins.get("objects")
        specs = [objects.get(name) for name in self._names]
        # the stream keeps its first name, so that figures stay what they were
        others = seeing.distractors(objects, self._names, self._see, run.rng("strangers"))
        seeing.see(run, _simulator(run), specs, others, run.plugins.get("segmenter"), self._see)

    def _do_plan(self, run: Run) -> None:
        grasping.plan(run, self._task(run), self._target)

    def _do_grasp(self, run: Run) -> None:
        grasping.grasp(run, self._task(run), run.plugins.get("policy"), self._grasp)

    def _task(self, run: Run) -> Task:
        """Return the worlds in which the target is grasped, with the segmenter's masks where there is one."""
        chosen, settings = run.plugins.chosen("segmenter"), self._grasp
        masks = functools.partial(seeing.find_mask, run.plugins.get("segmenter")) if chosen else None

        given = {
            "targets": [self._target],
            "masks": masks,
            "num_envs": settings.worlds,
            "starts": settings.starts,
            "threads": settings.threads,
            "visual": settings.visual,
            "seed": run.seed,
        }
        given = {key: value for key, value in given.items() if key in run.plugins.takes("task")}

        def make() -> Task:
            task: Task = run.plugins.fresh("task", **given)
            return task

        made: Task = run.shared("task", make)
        return made


DECIDED_HERE = {"num_envs": "worlds", "starts": "starts", "threads": "threads", "visual": "visual"}
"""Parameter of the task to the key of `pipeline.grasp` that decides it."""


def _check_task(run: Run) -> None:
    """Refuse a run without a task, and settings of the task that this pipeline would overrule."""
    if not run.plugins.chosen("task"):
        raise ConfigError("a policy acts in a task; add task=NAME")
    taken, node = run.plugins.takes("task"), run.config.get("task") or {}
    for kind in KINDS:
        if taken.get(kind) is Parameter.empty and not run.plugins.chosen(kind):
            raise ConfigError(f"the task '{run.plugins.chosen('task')}' needs a {kind}; add {kind}=NAME")
    for key, setting in DECIDED_HERE.items():
        if key in taken and key in node and node[key] != taken[key]:
            raise ConfigError(
                f"task.{key}={node[key]} is decided by pipeline.grasp.{setting} in this pipeline; "
                f"type pipeline.grasp.{setting}={node[key]}"
            )


def _simulator(run: Run) -> Simulator:
    """Return the simulator in which objects are taught and found; grasping has its own."""
    made: Simulator = run.shared("simulator", lambda: run.plugins.fresh("simulator"))
    return made


def _heads(run: Run) -> Path:
    return run.run_dir / "segmenter"


def _load_heads(run: Run) -> bool:
    if not _heads(run).exists():
        return False
    run.plugins.get("segmenter").load(_heads(run))
    return True
