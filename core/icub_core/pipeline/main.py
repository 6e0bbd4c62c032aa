"""The main job: teach, learn, see, plan, grasp, report."""

from __future__ import annotations

import functools
import logging
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig

from icub_core.config.assembly import Assembly
from icub_core.config.settings import build_scene, to_dataclass
from icub_core.errors import ConfigError
from icub_core.grasping.env import GraspEnv
from icub_core.grasping.task import GraspTask
from icub_core.grasping.visual import PictureEncoder
from icub_core.interfaces.segmenter import Segmenter
from icub_core.pipeline import grasping, seeing
from icub_core.pipeline.context import RunContext
from icub_core.pipeline.lifecycle import carry_out
from icub_core.pipeline.settings import MainSettings

logger = logging.getLogger(__name__)


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
    objects = plugins.get("objects")
    taught = settings.teach.objects if plugins.chosen("segmenter") else []
    grasped = [settings.grasp.target] if plugins.chosen("policy") else []
    for name in (*taught, *grasped):
        objects.get(name)  # a misspelt name must not wait until its stage
    for kind in ("segmenter", "policy", "grasp_generator"):
        if plugins.chosen(kind):
            plugins.get(kind)  # nor a misspelt parameter or a missing weight file
    segmenter = plugins.get("segmenter") if plugins.chosen("segmenter") else None
    if segmenter is None:
        context.note("no segmenter was chosen: masks are the simulator's ground truth")
    else:
        _learn_to_see(context, plugins, segmenter, settings)
    if not plugins.chosen("policy"):
        context.note("no policy was chosen: nothing is grasped; add +policy=NAME")
        return
    if not plugins.chosen("grasp_generator"):
        raise ConfigError("a policy starts from a grasp pose; choose grasp_generator=superquadrics")
    env = grasp_env(cfg, plugins, segmenter, settings, context.seed)
    try:
        with context.stage("plan"):
            grasping.plan(context, env.batch.tasks[0], settings.grasp.target)
        with context.stage("grasp"):
            grasping.grasp(context, env, plugins.get("policy"), settings.grasp)
    finally:
        env.close()


def _learn_to_see(context: RunContext, plugins: Assembly, segmenter: Segmenter, settings: MainSettings) -> None:
    heads = context.run_dir / "segmenter"
    if context.recall("see"):
        segmenter.load(heads)
        logger.info("the stages teach, learn and see were done before in %s", context.run_dir)
        return
    simulator, objects = plugins.fresh("simulator"), plugins.get("objects")
    robot = plugins.get("robot").description
    try:
        with context.stage("teach"):
            seeing.teach(context, simulator, robot, objects, segmenter, settings.teach)
        with context.stage("learn"):
            seeing.learn(context, segmenter)
        with context.stage("see"):
            targets = [objects.get(name) for name in settings.teach.objects]
            strangers = seeing.strangers(
                objects, settings.teach.objects, settings.see.strangers, context.rng("strangers")
            )
            seeing.see(context, simulator, targets, strangers, segmenter, settings.see)
    finally:
        simulator.close()
    segmenter.save(heads)
    context.remember("see")


def grasp_env(
    cfg: DictConfig, plugins: Assembly, segmenter: Segmenter | None, settings: MainSettings, seed: int
) -> GraspEnv:
    """Build the worlds in which the target is grasped.

    Args:
        cfg: Composed configuration, for the scene.
        plugins: Of the run.
        segmenter: Finds the target in the picture; None takes the simulator's ground truth.
        settings: Of the pipeline.
        seed: Of the starts.
    """
    masks = functools.partial(seeing.find_mask, segmenter) if segmenter is not None else None
    target = settings.grasp.target
    scene = build_scene(cfg.scene, [plugins.get("objects").get(target)])
    robot, generator = plugins.get("robot"), plugins.get("grasp_generator")
    task = to_dataclass(cfg.task)
    tasks = []
    for world in range(settings.grasp.worlds):
        simulator = plugins.fresh("simulator")
        simulator.load(robot.description, scene)
        world_seed = seed + world
        tasks.append(GraspTask(simulator, robot, generator, [target], masks=masks, settings=task, seed=world_seed))
    encoder = PictureEncoder(plugins.get("feature_extractor")) if settings.grasp.visual else None
    starts, threads = settings.grasp.starts, settings.grasp.threads
    return GraspEnv(tasks, pool_size=starts, threads=threads, encoder=encoder, seed=seed)
