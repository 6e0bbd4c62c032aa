"""The base policy that ships with this package: G-PAYN on many random objects, one world for each."""

from __future__ import annotations

import datetime
import json
import platform
from dataclasses import replace
from pathlib import Path

from icub_core.api import make_env
from icub_core.files import write_text_atomically
from icub_core.interfaces.policy import Progress
from icub_core.provenance import machine, versions
from icub_policies.gpayn import Gpayn

OBJECTS = 32
"""Random objects, one world each."""
OBJECT_SIZE = [0.09, 0.2]
"""Meters of their longest side, drawn in this range."""
STARTS = 10
"""Starts that a world keeps."""
DEMONSTRATIONS = 3 * OBJECTS
UPDATES_PER_STEP = 0.2
EVALUATE_EVERY = 25_000
NAME = "base_gpayn"


def pretrain(run_dir: Path, seed: int, minutes: float = 45.0, progress: Progress = lambda share, text: None) -> None:
    """Train, or resume, and write weights and card into `run_dir` whenever an evaluation is the best so far."""
    low, high = OBJECT_SIZE
    progress(0.0, f"looks for {OBJECTS} graspable objects")
    task = make_env(
        "grasp",
        overrides=["objects=random1000", f"objects.size=[{low},{high}]", "objects.graspable=true"],
        num_envs=OBJECTS,
        one_object_each=True,
        starts=STARTS,
        seed=seed,
    )
    policy = Gpayn(
        seconds=60 * minutes, demonstrations=DEMONSTRATIONS, updates_per_step=UPDATES_PER_STEP, seed=seed
    )  # fmt: skip
    policy.settings = replace(policy.settings, evaluate_every=EVALUATE_EVERY, evaluation_episodes=OBJECTS)
    policy.exports = run_dir / f"{NAME}.safetensors"
    report = policy.learn(task, run_dir, progress)
    policy.save(policy.exports)
    card = {
        "name": NAME,
        "command": f"icub train policy=gpayn --seed {seed} --minutes {minutes:g}",
        "seed": seed,
        "date": datetime.date.today().isoformat(),
        "data": f"random1000 (pybullet_data), {OBJECTS} graspable objects of {OBJECT_SIZE} m: "
        + ", ".join(task.objects),
        "machine": {**machine(), "system": platform.machine()},
        "versions": versions(),
        "seconds": round(report.seconds, 1),
        "env_steps": report.env_steps,
        "updates": report.updates,
        "figures": report.metrics,
    }
    write_text_atomically(run_dir / f"{NAME}.json", json.dumps(card, indent=2) + "\n")
    task.close()
