"""Speed of the grasping environment over whole scripted episodes, one core, without rendering.

    icub benchmark environment
    icub benchmark environment --only speed --worlds 8 --repeats 1

`sim.env_steps_per_s`: control steps of 25 ms (five physics steps, inverse kinematics, governor, observation, reward,
TensorDict, scripted policy) from the pre-grasp pose to the end of the episode. `sim.task_overhead`: what one step of
the environment takes above the physics steps it contains, as a share of them; the policy is not part of it. Processor
time of one thread; the starts are planned beforehand.

`sim.scaling_2`: control steps per second of wall time of two processes at once (`icub_benchmarks.workers`) over one's;
`sim.scaling_2_limit`: the same of nothing but physics steps, in the engine's own loop: what the machine allows, with
whatever else runs on it; `sim.scaling_2_threads`: of one environment whose worlds two threads step over the same with
one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: one core is measured

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from rich.console import Console
from rich.progress import track

import icub_core as icub
from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_benchmarks.workers import Workers
from icub_tasks.grasping.task import GraspingTask
from icub_tasks.grasping.world import StartState

OBJECTS = ["004_sugar_box", "006_mustard_bottle", "010_potted_meat_can"]


class Clock:
    """Adds up the processor time of one method of an object."""

    def __init__(self, owner: object, method: str) -> None:
        self.seconds = 0.0
        self._call = getattr(owner, method)
        setattr(owner, method, self)

    def __call__(self, *arguments: object) -> object:
        """Call the method."""
        begun = time.thread_time()
        answer = self._call(*arguments)
        self.seconds += time.thread_time() - begun
        return answer


def prepare(name: str, worlds: int, seed: int) -> tuple[GraspingTask, list[StartState]]:
    """Return a task with one object, and a planned start for each of its worlds."""
    env = make_task(name, worlds, seed)
    starts = [world.prepare() for world in track(env.worlds, description=f"plans for {name}", transient=True)]
    return env, starts


def make_task(name: str, worlds: int, seed: int, threads: int = 1) -> GraspingTask:
    """Return a task with one object."""
    made = icub.make_env("grasp", objects=[name], num_envs=worlds, threads=threads, seed=seed)
    assert isinstance(made, GraspingTask)
    return made


def play(env: GraspingTask, starts: Sequence[StartState], clock: Callable[[], float]) -> tuple[int, float, float]:
    """Play every start to its end; returns control steps, seconds, and those of them inside the environment."""
    script = icub.load("policy", "demonstrations")
    script.bind(env)
    for world, start in enumerate(starts):
        env.begin(world, start)
    observation = env.observe()
    in_env, steps = 0.0, 0
    active = [True] * len(starts)
    begun = clock()
    while any(active):
        observation["action"] = script.act(observation)
        before = clock()
        observation = env.advance(observation, active)
        in_env += clock() - before
        steps += sum(active)
        for world in torch.nonzero(observation["done"][:, 0])[:, 0].tolist():
            active[world] = False
    return steps, clock() - begun, in_env


def measure(name: str, worlds: int, seed: int) -> tuple[float, float, int]:
    """Return steps per second of whole episodes, the overhead share, and the control steps measured."""
    env, starts = prepare(name, worlds, seed)
    physics = Clock(env.batch, "simulate")  # once per control step of all worlds: the clock itself takes no time
    steps, total, in_env = play(env, starts, time.thread_time)
    env.close()
    return steps / total, in_env / physics.seconds - 1.0, steps


class Player:
    """Plays the same starts whenever it is asked. Lives in a worker process."""

    def __init__(self, name: str, worlds: int) -> None:
        torch.set_num_threads(1)
        self._env, self._starts = prepare(name, worlds, seed=0)

    def __call__(self, repeats: int) -> int:
        """Play `repeats` times; returns the control steps."""
        return sum(play(self._env, self._starts, time.perf_counter)[0] for _ in range(repeats))


class Stepper:
    """Does nothing but physics steps of one world, in the engine's loop. Lives in a worker process."""

    def __init__(self, name: str) -> None:
        env, (start,) = prepare(name, 1, seed=0)
        self._simulator, self._start = env.simulator(0), start

    def __call__(self, repeats: int) -> int:
        """Step `repeats` times 4000 steps from the same start; returns the steps."""
        for _ in range(repeats):
            self._simulator.restore_state(self._start.simulation)
            for _ in range(4):
                self._simulator.step(1000)
        return 4000 * repeats


def timed(workers: Workers[int, int], jobs: Sequence[int]) -> float:
    """Return steps per second of wall time over jobs done at once."""
    begun = time.perf_counter()
    steps = workers.map(jobs)
    return sum(step or 0 for step in steps) / (time.perf_counter() - begun)


def scaling(options: argparse.Namespace) -> dict[str, Figure]:
    """Measure two processes against one, and two threads against one, turn by turn."""
    name, worlds = options.objects[0], options.worlds // 2
    processes: list[float] = []
    limits: list[float] = []
    threads: list[float] = []
    with Workers(partial(Player, name, worlds), 2) as players, Workers(partial(Stepper, name), 2) as steppers:
        players.map([1, 1])  # both are set up
        steppers.map([1, 1])
        for _ in track(range(options.repeats * 3), description="one and two processes", transient=True):
            for workers, jobs, ratios in ((players, 2, processes), (steppers, 10, limits)):
                alone = timed(workers, [jobs])
                ratios.append(timed(workers, [jobs, jobs]) / alone)
    single, starts = prepare(name, worlds, seed=0)
    double = make_task(name, worlds, seed=0, threads=2)
    for _ in track(range(options.repeats * 3), description="one and two threads", transient=True):
        steps, alone, _ = play(single, starts, time.perf_counter)
        more, together, _ = play(double, starts, time.perf_counter)
        threads.append(more / together / (steps / alone))
    single.close()
    double.close()
    return {
        key: Figure(float(np.median(values)), "1", float(np.std(values)), len(values))
        for key, values in (
            ("sim.scaling_2", processes),
            ("sim.scaling_2_limit", limits),
            ("sim.scaling_2_threads", threads),
        )
    }


def main(argv: Sequence[str]) -> None:
    """Measure, print and write simulation.json."""
    parser = make_parser("environment", __doc__)
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--only", choices=["speed", "scaling"], help="measure this part alone")
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    figures: dict[str, Figure] = {}
    if options.only != "scaling":
        rows = [
            measure(name, options.worlds, options.seed + repeat)
            for repeat in range(options.repeats)
            for name in options.objects
        ]
        speeds, overheads, steps = (np.array(column) for column in zip(*rows, strict=True))
        figures["sim.env_steps_per_s"] = Figure(float(speeds.mean()), "1/s", float(speeds.std()), int(steps.sum()))
        figures["sim.task_overhead"] = Figure(float(overheads.mean()), "1", float(overheads.std()), int(steps.sum()))
    if options.only != "speed":
        figures |= scaling(options)
    for key, figure in figures.items():
        Console().print(f"{key}: {figure.value:.4g} +- {figure.spread:.2g}")
    command = command_line("environment", argv)
    write_figures(options.results / "simulation.json", figures, command=command, seed=options.seed)
