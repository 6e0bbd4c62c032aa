"""The main job: teach, learn, see, plan, grasp, report."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, TypeVar, cast

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from icub_core import registry
from icub_core.errors import ConfigError
from icub_core.grasping.env import GraspEnv
from icub_core.grasping.plan import MaskProvider
from icub_core.grasping.task import GraspTask
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.object_set import ObjectSet
from icub_core.interfaces.policy import Policy
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.segmenter import Segmenter
from icub_core.pipeline import grasping, seeing
from icub_core.pipeline.context import RunContext
from icub_core.pipeline.report import write_metrics, write_provenance, write_report
from icub_core.pipeline.settings import GraspSettings, MainSettings
from icub_core.scene import ObjectSpec, Scene

logger = logging.getLogger(__name__)
Settings = TypeVar("Settings")

STRANGERS_SET = "random1000"
STRANGER_SIZE = (0.08, 0.2)
"""Smallest and largest extent to which strangers are scaled, metres: sizes alone must not give the targets away."""


def typed_settings(cfg: DictConfig, key: str, schema: type[Settings]) -> Settings:
    """Return the node `key` as the dataclass `schema`; ConfigError for unknown keys and wrong types."""
    try:
        merged = OmegaConf.merge(OmegaConf.structured(schema), cfg.get(key) or {})
        return cast(Settings, OmegaConf.to_object(merged))
    except OmegaConfBaseException as cause:
        raise ConfigError(f"{key}: {str(cause).splitlines()[0]}") from cause


def run(cfg: DictConfig, run_dir: Path, hook: Any) -> dict[str, Any]:
    """Do every stage whose plugin was chosen and write the run folder.

    Args:
        cfg: Composed configuration.
        run_dir: Where everything is written; stages that an interrupted run has finished there are not done again.
        hook: Relay of hook calls.

    Returns:
        The flat figures of metrics.json.
    """
    settings = typed_settings(cfg, "pipeline", MainSettings)
    context = RunContext(run_dir, int(cfg.seed), hook)
    write_provenance(run_dir, context.seed, command=f"icub run {' '.join(cfg.get('command_line') or [])}".strip())
    robot = registry.build("robot", cfg.robot)
    objects = registry.build("objects", cfg.objects)
    segmenter = _segmenter(cfg) if cfg.segmenter else None
    policy = registry.build("policy", cfg.policy) if cfg.policy else None
    generator = registry.build("grasp_generator", cfg.grasp_generator) if cfg.grasp_generator else None
    _check_objects(objects, settings)

    if segmenter is None:
        context.note("no segmenter was chosen: masks are the simulator's ground truth")
    else:
        _learn_to_see(context, cfg, robot, objects, segmenter, settings)
    if policy is None:
        context.note("no policy was chosen: nothing is grasped; add +policy=NAME")
    elif generator is None:
        raise ConfigError("a policy needs grasp poses; choose grasp_generator=superquadrics")
    else:
        _grasp(context, cfg, robot, objects, segmenter, generator, policy, settings)
    _finish(context, cfg)
    return context.metrics


def _check_objects(objects: ObjectSet, settings: MainSettings) -> None:
    for name in (*settings.teach.objects, settings.grasp.target):
        objects.get(name)


def _segmenter(cfg: DictConfig) -> Segmenter:
    if not cfg.feature_extractor or not cfg.online_head:
        raise ConfigError(
            "a segmenter needs feature_extractor=NAME and online_head=NAME; segmenter=falkon brings compact and falkon"
        )
    return registry.build(
        "segmenter",
        cfg.segmenter,
        feature_extractor=registry.build("feature_extractor", cfg.feature_extractor),
        online_head=registry.factory("online_head", cfg.online_head),
    )


def _learn_to_see(
    context: RunContext, cfg: DictConfig, robot: Robot, objects: ObjectSet, segmenter: Segmenter, settings: MainSettings
) -> None:
    heads = context.run_dir / "segmenter"
    if context.recall("see"):
        segmenter.load(heads)
        logger.info("stages teach, learn and see were done before in %s", context.run_dir)
        return
    simulator = registry.build("simulator", cfg.simulator)
    try:
        with context.stage("teach"):
            seeing.teach(context, simulator, robot.description, objects, segmenter, settings.teach)
        with context.stage("learn"):
            seeing.learn(context, segmenter)
        with context.stage("see"):
            targets = [objects.get(name) for name in settings.teach.objects]
            strangers = _strangers(context, objects, settings)
            seeing.see(context, simulator, robot.description, targets, strangers, segmenter, settings.see)
    finally:
        simulator.close()
    segmenter.save(heads)
    context.remember("see")


def _strangers(context: RunContext, objects: ObjectSet, settings: MainSettings) -> list[ObjectSpec]:
    """Objects that were never taught: the rest of the object set, and random ones."""
    rest = [objects.get(name) for name in objects.names if name not in settings.teach.objects]
    rest = rest[: settings.see.strangers // 2]
    smallest, largest = STRANGER_SIZE
    random = registry.build("objects", STRANGERS_SET, smallest=smallest, largest=largest)
    drawn = context.rng("strangers").choice(len(random.names), settings.see.strangers - len(rest), replace=False)
    return rest + [random.get(random.names[i]) for i in sorted(drawn)]


def _grasp(
    context: RunContext,
    cfg: DictConfig,
    robot: Robot,
    objects: ObjectSet,
    segmenter: Segmenter | None,
    generator: GraspGenerator,
    policy: Policy,
    settings: MainSettings,
) -> None:
    env = grasp_env(cfg, robot, objects, generator, segmenter, settings.grasp, context.seed)
    try:
        with context.stage("plan"):
            grasping.plan(context, env.batch.tasks[0], settings.grasp.target)
        with context.stage("grasp"):
            grasping.grasp(context, env, policy, settings.grasp)
    finally:
        env.close()


def grasp_env(
    cfg: DictConfig,
    robot: Robot,
    objects: ObjectSet,
    generator: GraspGenerator,
    segmenter: Segmenter | None,
    settings: GraspSettings,
    seed: int,
) -> GraspEnv:
    """Build the worlds in which the target is grasped."""
    masks: MaskProvider | None = None
    if segmenter is not None:
        seer = segmenter
        masks = lambda frame, name: seeing.find_mask(seer, frame, name)  # noqa: E731  # one use, no name needed
    scene = Scene(objects=(objects.get(settings.target),), timestep=float(cfg.scene.timestep))
    tasks = []
    for world in range(settings.worlds):
        simulator = registry.build("simulator", cfg.simulator)
        simulator.load(robot.description, scene)
        tasks.append(GraspTask(simulator, robot, generator, [settings.target], masks=masks, seed=seed + world))
    return GraspEnv(tasks, pool_size=settings.starts, threads=settings.threads, seed=seed)


def _finish(context: RunContext, cfg: DictConfig) -> None:
    context.metrics["run.seconds"] = sum(context.seconds.values())
    write_metrics(context.run_dir, context.metrics)
    write_report(
        context.run_dir,
        "icub run",
        context.metrics,
        context.seconds,
        context.pictures,
        context.notes,
        OmegaConf.to_yaml(cfg, resolve=True),
    )
