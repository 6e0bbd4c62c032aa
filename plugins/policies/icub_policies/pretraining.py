"""The base policy that ships with this package: G-PAYN on many random objects, one world for each."""

from __future__ import annotations

import datetime
import json
import logging
import platform
from dataclasses import replace
from pathlib import Path

from icub_core import registry
from icub_core.errors import SimulationError
from icub_core.evaluation.results import machine, versions
from icub_core.files import write_text_atomically
from icub_core.grasping.env import GraspEnv
from icub_core.grasping.pool import StartPool
from icub_core.grasping.task import GraspTask
from icub_core.interfaces.policy import Progress
from icub_core.scene import Scene
from icub_policies.gpayn import Gpayn

log = logging.getLogger(__name__)

OBJECTS = 48
"""Random objects, one world each."""
OBJECT_SIZE = [0.09, 0.2]
"""Metres of their longest side, drawn in this range."""
STARTS = 12
"""Starts that a world keeps."""
FIRST_STARTS = 3
DEMONSTRATIONS = 3 * OBJECTS
UPDATES_PER_STEP = 0.06
EVALUATE_EVERY = 100_000
NAME = "base_gpayn"


def training_tasks(count: int, seed: int, progress: Progress) -> list[GraspTask]:
    """Build one world for each of `count` graspable random objects that the planner finds grasps for."""
    robot = registry.build("robot", "icub")
    generator = registry.build("grasp_generator", "superquadrics")
    objects = registry.build("objects", {"plugin": "random1000", "size": OBJECT_SIZE, "graspable": True})
    names = list(objects.names)
    tasks: list[GraspTask] = []
    while names and len(tasks) < count:
        name = names.pop(0)
        simulator = registry.build("simulator", "mujoco")
        simulator.load(robot.description, Scene(objects=(objects.get(name),)))
        task = GraspTask(simulator, robot, generator, [name], seed=seed + len(tasks))
        try:
            StartPool(task, 1, seed=seed).fill(1)
        except SimulationError as error:
            log.info("%s is left out: %s", name, error)
            simulator.close()
            continue
        tasks.append(task)
        progress(0.0, f"{len(tasks)} of {count} objects have a world")
    return tasks


def pretrain(run_dir: Path, seed: int, minutes: float, progress: Progress) -> None:
    """Train, or go on training, and write weights and card into `run_dir` whenever an evaluation is the best so far."""
    tasks = training_tasks(OBJECTS, seed, progress)
    env = GraspEnv(tasks, pool_size=STARTS, seed=seed)
    policy = Gpayn(
        seconds=60 * minutes, demonstrations=DEMONSTRATIONS, updates_per_step=UPDATES_PER_STEP, seed=seed
    )  # fmt: skip
    policy.settings = replace(policy.settings, evaluate_every=EVALUATE_EVERY, evaluation_episodes=len(tasks))
    policy.exports = run_dir / f"{NAME}.safetensors"
    for number, pool in enumerate(env.pools):
        pool.fill(FIRST_STARTS)
        progress(0.0, f"planned the first starts of {number + 1} of {len(tasks)} worlds")
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
