"""Inverse kinematics of the iCub: time per solve, per batch of 100 candidates, share of targets reached.

    icub benchmark kinematics
    icub benchmark kinematics --targets 1000 --seed 1

Targets are hand poses of random postures of torso and right arm over the whole ranges (torso_pitch up to its limit in
inverse kinematics), solved from home to 1 mm and 0.01 rad. Times are processor time of one thread, so that other work
on the machine does not count.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: 6 x 6 matrices gain nothing from threads

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table as TextTable

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_core.geometry import rotation_exp
from icub_core.interfaces.robot import IkSolution
from icub_core.scene import Table
from icub_robots.icub import ICub

FloatArray = NDArray[np.float64]
FRAME, GROUP, BATCH = "r_hand_dh_frame", "right_reach", 100
TORSO_PITCH_MAX = 0.5


def random_targets(robot: ICub, count: int, rng: np.random.Generator) -> FloatArray:
    """Return poses (count, 4, 4) of the hand at random postures of the reaching group."""
    d = robot.description
    upper = np.where(np.array(d.joint_names) == "torso_pitch", np.minimum(d.upper, TORSO_PITCH_MAX), d.upper)
    group, poses = d.indices(GROUP), []
    for _ in range(count):
        q = d.home_q
        q[group] = rng.uniform(d.lower[group], upper[group])
        poses.append(robot.forward_kinematics(q, FRAME))
    return np.array(poses)


def timed(work: Callable[[], object], calls: int, repeats: int, label: str) -> Figure:
    """Measure processor milliseconds per call: the mean of a repeat, median and deviation over repeats."""
    work()
    times = []
    for _ in track(range(repeats), description=label, transient=True):
        start = time.process_time()
        work()
        times.append((time.process_time() - start) / calls * 1e3)
    return Figure(float(np.median(times)), "ms", float(np.std(times)), repeats)


def share(solutions: Sequence[IkSolution]) -> Figure:
    """Return the share of solutions that reached, with its standard error."""
    reached = float(np.mean([s.reached for s in solutions]))
    return Figure(reached, "1", float(np.sqrt(reached * (1 - reached) / len(solutions))), len(solutions))


def follow(robot: ICub, steps: int, rng: np.random.Generator) -> tuple[Figure, Figure]:
    """Track targets that move 2 mm and up to 0.01 rad per axis a step, two iterations a step, 15 steps at a time."""
    home, errors, times = robot.description.home_q, [], []
    for _ in range(steps // 15):
        direction = rng.normal(size=3)
        shift, turn = 0.002 * direction / np.linalg.norm(direction), rotation_exp(rng.uniform(-0.01, 0.01, 3))
        q, target = home, robot.forward_kinematics(home, FRAME)
        for _ in range(15):
            target = target.copy()
            target[:3, 3] += shift
            target[:3, :3] = turn @ target[:3, :3]
            start = time.process_time()
            solution = robot.inverse_kinematics(target, q, FRAME, max_iterations=2)
            times.append((time.process_time() - start) * 1e6)
            q = solution.q
            errors.append(solution.position_error * 1e3)
    return (
        Figure(
            float(np.median(times)), "us", (float(np.quantile(times, 0.05)), float(np.quantile(times, 0.95))), steps
        ),
        Figure(float(np.mean(errors)), "mm", (0.0, float(np.quantile(errors, 0.95))), steps),
    )


def measure(targets: int, seed: int) -> dict[str, Figure]:
    """Measure everything; about half a minute."""
    rng = np.random.default_rng(seed)
    robot, placo = ICub(), ICub(kinematics="placo")
    home = robot.description.home_q
    poses = random_targets(robot, targets, rng)
    batches = [poses[i : i + BATCH] for i in range(0, targets - BATCH + 1, BATCH)]

    def rank() -> None:
        for batch in batches:
            robot.inverse_kinematics_batch(batch, home, FRAME)

    def solve(solver: ICub) -> list[IkSolution]:
        return [solver.inverse_kinematics(T, home, FRAME) for T in poses]

    figures = {
        "ik.solve_ms": timed(lambda: solve(robot), targets, 7, "solve"),
        "ik.reached": share(solve(robot)),
        "ik.batch100_ms": timed(rank, len(batches), 15, "batch"),
        "ik.batch100_reached": share(robot.inverse_kinematics_batch(poses, home, FRAME)),
        "ik.placo_ms": timed(lambda: solve(placo), targets, 3, "placo"),
        "ik.placo_reached": share(solve(placo)),
        "robot.collisions_ms": timed(lambda: robot.collisions(home, Table()), 1, 100, "collision check"),
        "robot.gaze_ms": timed(lambda: robot.gaze(np.array([-0.5, 0.1, 1.0]), home), 1, 25, "gaze"),
    }
    figures["ik.track_us"], figures["ik.track_error_mm"] = follow(robot, 1500, rng)
    return figures


def main(argv: Sequence[str]) -> None:
    """Measure, print and write simulation.json."""
    parser = make_parser("kinematics", __doc__)
    parser.add_argument("--targets", type=int, default=500, help="random targets, at least 100")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    if options.targets < BATCH:
        parser.error(f"--targets is {options.targets}; expected at least {BATCH}")
    figures = measure(options.targets, options.seed)
    table = TextTable("figure", "value", "unit", "spread", "n")
    for key, figure in sorted(figures.items()):
        spread = figure.spread if isinstance(figure.spread, tuple) else (figure.spread,)
        values = ", ".join("" if v is None else f"{v:.3g}" for v in spread)
        table.add_row(key, f"{figure.value:.4g}", figure.unit, values, str(figure.n))
    Console().print(table)
    command = command_line("kinematics", argv)
    write_figures(options.results / "simulation.json", figures, command=command, seed=options.seed)
