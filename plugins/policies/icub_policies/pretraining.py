"""The base policy that ships with this package: G-PAYN on many random objects, one world for each."""

from __future__ import annotations

import datetime
import json
import logging
import platform
from dataclasses import replace
from pathlib import Path

import numpy as np

from icub_core import registry
from icub_core.evaluation.results import machine, versions
from icub_core.files import write_text_atomically
from icub_core.interfaces.policy import Progress
from icub_core.scene import Scene
from icub_policies.gpayn import Gpayn
from icub_tasks.grasping.env import GraspEnv
from icub_tasks.grasping.plan import GraspPlan
from icub_tasks.grasping.task import GraspTask, StartState

log = logging.getLogger(__name__)

OBJECTS = 32
"""Random objects, one world each."""
OBJECT_SIZE = [0.09, 0.2]
"""Meters of their longest side, drawn in this range."""
STARTS = 10
"""Starts that a world keeps."""
FIRST_STARTS = 3
FIRST_POSES = 8
DEMONSTRATIONS = 3 * OBJECTS
UPDATES_PER_STEP = 0.2
EVALUATE_EVERY = 25_000
NAME = "base_gpayn"


def training_worlds(count: int, seed: int, progress: Progress) -> tuple[list[GraspTask], list[list[StartState]]]:
    """Build one world for each of `count` random objects that are planned often enough, with their first starts."""
    robot = registry.build("robot", "icub")
    generator = registry.build("grasp_generator", "superquadrics")
    objects = registry.build("objects", {"plugin": "random1000", "size": OBJECT_SIZE, "graspable": True})
    tasks: list[GraspTask] = []
    starts: list[list[StartState]] = []
    for name in objects.names:
        simulator = registry.build("simulator", "mujoco")
        simulator.load(robot.description, Scene(objects=(objects.get(name),)))
        task = GraspTask(simulator, robot, generator, [name], seed=seed + len(tasks))
        found = first_starts(task, name, np.random.default_rng([seed, len(tasks)]))
        if len(found) < FIRST_STARTS:
            log.info("%s is left out: only %d plans for %d poses", name, len(found), FIRST_POSES)
            simulator.close()
            continue
        tasks.append(task)
        starts.append(found)
        progress(0.0, f"{len(tasks)} of {count} objects have a world and first plans")
        if len(tasks) == count:
            break
    return tasks, starts


def first_starts(task: GraspTask, name: str, rng: np.random.Generator) -> list[StartState]:
    """Plan for a few random poses of one object; returns the starts that came of it, at most `FIRST_STARTS`."""
    found: list[StartState] = []
    for _ in range(FIRST_POSES):
        rest = task.place(name, rng)
        plan = task.plan(name)
        if isinstance(plan, GraspPlan):
            found.append(task.approach(plan, rest))
            if len(found) == FIRST_STARTS:
                break
    return found


def pretrain(run_dir: Path, seed: int, minutes: float, progress: Progress) -> None:
    """Train, or go on training, and write weights and card into `run_dir` whenever an evaluation is the best so far."""
    tasks, starts = training_worlds(OBJECTS, seed, progress)
    env = GraspEnv(tasks, pool_size=STARTS, seed=seed)
    for pool, found in zip(env.pools, starts, strict=True):
        pool.starts.extend(found)
    policy = Gpayn(
        seconds=60 * minutes, demonstrations=DEMONSTRATIONS, updates_per_step=UPDATES_PER_STEP, seed=seed
    )  # fmt: skip
    policy.settings = replace(policy.settings, evaluate_every=EVALUATE_EVERY, evaluation_episodes=len(tasks))
    policy.exports = run_dir / f"{NAME}.safetensors"
    report = policy.learn(env, run_dir, progress)
    policy.save(policy.exports)
    card = {
        "name": NAME,
        "command": f"icub train policy=gpayn --seed {seed} --minutes {minutes:g}",
        "seed": seed,
        "date": datetime.date.today().isoformat(),
        "data": f"random1000 (pybullet_data), {len(tasks)} graspable objects of {OBJECT_SIZE} m: "
        + ", ".join(task.objects[0] for task in tasks),
        "machine": {**machine(), "system": platform.machine()},
        "versions": versions(),
        "seconds": round(report.seconds, 1),
        "env_steps": report.env_steps,
        "updates": report.updates,
        "figures": report.metrics,
    }
    write_text_atomically(run_dir / f"{NAME}.json", json.dumps(card, indent=2) + "\n")
    env.close()
