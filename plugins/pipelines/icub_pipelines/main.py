"""The main job: teach, learn, see, plan, grasp, report."""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig

from icub_core.config.assembly import Assembly
from icub_core.config.settings import build_scene, to_dataclass
from icub_core.errors import ConfigError
from icub_core.interfaces.segmenter import Segmenter
from icub_core.scene import ObjectSpec
from icub_pipelines import grasping, seeing
from icub_pipelines.context import RunContext
from icub_pipelines.lifecycle import carry_out
from icub_pipelines.settings import GraspSettings, MainSettings, grasped, shown
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.task import GraspTask
from icub_tasks.grasping.visual import PictureEncoder

logger = logging.getLogger(__name__)

SCRIPTED = "demonstrations"
"""Carries planned grasps out when neither a segmenter nor a policy was chosen."""


def run(cfg: DictConfig, run_dir: Path) -> dict[str, Any]:
    """Do every stage whose plugin was chosen and write the run folder.

    Args:
        cfg: Composed configuration.
        run_dir: Where everything is written; stages that an interrupted run has finished there are not done again.

    Returns:
        The flat figures of metrics.json.
    """
    settings = cast(MainSettings, to_dataclass(cfg.pipeline))
    return carry_out(cfg, run_dir, lambda context: _stages(context, cfg, settings))


def _stages(context: RunContext, cfg: DictConfig, settings: MainSettings) -> None:
    plugins = Assembly(cfg)
    if not plugins.chosen("segmenter") and not plugins.chosen("policy"):
        plugins = Assembly({str(key): cfg.get(key) for key in cfg} | {"policy": {"plugin": SCRIPTED}})
        context.note(f"no policy was chosen: planned grasps are carried out by '{SCRIPTED}'; +policy=NAME learns to")
    objects = plugins.get("objects")
    names = shown(settings.teach.objects, objects.names)
    taught = [objects.get(name) for name in names] if plugins.chosen("segmenter") else []
    target = grasped(settings.grasp.target, names if taught else objects.names)
    if plugins.chosen("policy"):
        objects.get(target)  # a misspelt name must not wait until its stage
    for kind in ("segmenter", "policy", "grasp_generator"):
        if plugins.chosen(kind):
            plugins.get(kind)  # nor a misspelt parameter or a missing weight file
    segmenter = plugins.get("segmenter") if plugins.chosen("segmenter") else None
    if segmenter is None:
        context.note("no segmenter was chosen: masks are the simulator's ground truth")
    else:
        _learn_to_see(context, plugins, segmenter, taught, settings)
    if not plugins.chosen("policy"):
        context.note("no policy was chosen: nothing is grasped; add +policy=NAME")
        return
    if not plugins.chosen("grasp_generator"):
        raise ConfigError("a policy starts from a grasp pose; choose grasp_generator=superquadrics")
    env = grasp_env(cfg, plugins, segmenter, target, settings.grasp, context.seed)
    try:
        with context.stage("plan"):
            grasping.plan(context, env.batch.tasks[0], target)
        with context.stage("grasp"):
            grasping.grasp(context, env, plugins.get("policy"), settings.grasp)
    finally:
        env.close()


def _learn_to_see(
    context: RunContext,
    plugins: Assembly,
    segmenter: Segmenter,
    taught: Sequence[ObjectSpec],
    settings: MainSettings,
) -> None:
    if not taught:
        raise ConfigError("pipeline.teach.objects is empty; expected at least one name of the object set")
    heads = context.run_dir / "segmenter"
    if context.recall("see"):
        segmenter.load(heads)
        logger.info("the stages teach, learn and see were done before in %s", context.run_dir)
        return
    simulator, objects = plugins.fresh("simulator"), plugins.get("objects")
    robot = plugins.get("robot").description
    try:
        with context.stage("teach"):
            seeing.teach(context, simulator, robot, taught, segmenter, settings.teach.frames)
        with context.stage("learn"):
            seeing.learn(context, segmenter)
        with context.stage("see"):
            names = [spec.name for spec in taught]
            distractors = seeing.distractors(objects, names, settings.see.distractors, context.rng("strangers"))
            seeing.see(context, simulator, taught, distractors, segmenter, settings.see)
    finally:
        simulator.close()
    segmenter.save(heads)
    context.remember("see")


def grasp_env(
    cfg: DictConfig,
    plugins: Assembly,
    segmenter: Segmenter | None,
    target: str,
    settings: GraspSettings,
    seed: int,
) -> GraspEnv:
    """Build the worlds in which the target is grasped.

    Args:
        cfg: Composed configuration, for the scene.
        plugins: Of the run.
        segmenter: Finds the target in the image; None takes the simulator's ground truth.
        target: Name of the object.
        settings: Of the stage.
        seed: Of the starts.
    """
    masks = functools.partial(seeing.find_mask, segmenter) if segmenter is not None else None
    scene = build_scene(cfg.scene, [plugins.get("objects").get(target)])
    robot, generator = plugins.get("robot"), plugins.get("grasp_generator")
    task = to_dataclass(cfg.task)
    tasks = []
    for world in range(settings.worlds):
        simulator = plugins.fresh("simulator")
        simulator.load(robot.description, scene)
        world_seed = seed + world
        tasks.append(GraspTask(simulator, robot, generator, [target], masks=masks, settings=task, seed=world_seed))
    encoder = PictureEncoder(plugins.get("feature_extractor")) if settings.visual else None
    starts, threads = settings.starts, settings.threads
    return GraspEnv(tasks, pool_size=starts, threads=threads, encoder=encoder, seed=seed)
