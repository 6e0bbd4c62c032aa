"""Speed of the simulator: physics steps per second over scripted grasps, time of an image.

    icub benchmark simulation
    icub benchmark simulation --only render --repeats 200

Each function returns its entries for simulation.json, where figures of other benchmarks and functions are kept. Times
are processor time of one thread, so that other work on the machine counts as little as possible; the machine should
still be quiet, since two busy hardware threads of a core share it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: the matrices here are small

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table as TextTable

from icub_benchmarks.figures import Figure
from icub_benchmarks.results import command_line, make_parser, write_figures
from icub_core.errors import SimulationError
from icub_core.geometry import make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.interfaces.simulator import Simulator
from icub_core.scene import ObjectSpec, Scene
from icub_robots.icub import ICub
from icub_simulators.mujoco.simulator import Mujoco
from icub_simulators.objects.ycb_primitives import YcbPrimitives

FloatArray = NDArray[np.float64]

OBJECTS = {
    "004_sugar_box": 0.0,
    "005_tomato_soup_can": 0.8,
    "006_mustard_bottle": 0.5 * np.pi,
    "010_potted_meat_can": 0.0,
}
"""What is grasped, and the roll of the hand about its fingers, rad: 0 palm down, pi / 2 palm sideways."""
APPROACH, CLOSE, LIFT = 25, 200, 60
"""Control steps of 25 ms; the hand moves 2 mm in one."""
SUBSTEPS = 5
SPEED = 0.002


class ScriptedGrasp:
    """A planned approach, a closing of all fingers and a lift of 12 cm, with the joint targets computed beforehand."""

    def __init__(self, robot: ICub, spec: ObjectSpec, roll: float, place: tuple[float, float]) -> None:
        self._d = d = robot.description
        R_object = quat_wxyz_to_matrix(spec.rest_quat_wxyz)
        center = np.array([*place, Scene().table.top + spec.rest_height])  # type: ignore[union-attr]
        self.T_object = make_transform(R_object, center)
        half = np.abs(R_object) @ np.array(spec.half_extents)
        R = np.diag([-1.0, 1.0, -1.0]) @ rotation_about("x", roll)
        face = center + (np.array([0.0, 0.0, half[2]]) if roll == 0 else -half[1] * R[:, 2])
        grasp = make_transform(R, face - R @ np.array([0.032, -0.002, 0.006]))
        outward = grasp[:3, 3] - center
        outward /= np.linalg.norm(outward)
        frame, q = d.hand("right").frame, d.home_q
        A, b = d.actuator_matrix()
        path = [grasp[:3, 3] + (APPROACH - k) * SPEED * outward for k in range(APPROACH + 1)]
        path += [grasp[:3, 3] + np.array([0.0, 0.0, k * SPEED]) for k in range(1, LIFT + 1)]
        self.q, self.lengths = [], []
        for point in path:
            solution = robot.inverse_kinematics(make_transform(R, point), q, frame)
            if not solution.reached:
                raise SimulationError(f"{spec.name} at {place} cannot be reached")
            q = solution.q
            self.q.append(q)
            self.lengths.append(A @ q + b)
        self._hand = d.actuator_indices(d.hand("right").actuators)
        hand = [d.actuators[i] for i in self._hand]
        self._open = np.array([a.open for a in hand])
        self._stroke = np.array([a.close for a in hand]) - self._open

    def run(self, simulator: Simulator) -> Iterator[str]:
        """Play it; yields the phase before each control step's physics."""
        simulator.set_joint_positions(self.q[0])
        fingers = self.lengths[0][self._hand].copy()
        lead = np.zeros_like(fingers)
        for k in range(APPROACH + CLOSE + LIFT):
            closing, lifting = k - APPROACH, k - APPROACH - CLOSE
            row = min(k + 1, APPROACH) + max(lifting + 1, 0)
            targets = self.lengths[row].copy()
            now = simulator.actuator_positions()[self._hand]
            if lifting >= 0:
                fingers = now + lead
            elif closing >= 0:
                share = (closing + 1) / CLOSE
                fingers = np.where(
                    self._stroke == 0,
                    self._open,
                    np.minimum(now + self._stroke / 25, self._open + share * self._stroke),
                )
                lead = fingers - now
            targets[self._hand] = fingers
            simulator.set_targets(targets)
            yield "lift" if lifting >= 0 else "close" if closing >= 0 else "approach"


def physics_steps(seed: int, repeats: int) -> dict[str, Figure]:
    """Raw physics steps per second, mean over whole scripted episodes; also per phase."""
    robot, objects, rng = ICub(), YcbPrimitives(), np.random.default_rng(seed)
    rates: list[float] = []
    phases = {"approach": [0.0, 0.0], "close": [0.0, 0.0], "lift": [0.0, 0.0]}
    lifted = 0
    simulator = Mujoco()
    jobs = [(name, roll) for name, roll in OBJECTS.items() for _ in range(max(repeats // len(OBJECTS), 1))]
    for name, roll in track(jobs, description="physics", transient=True):
        spec = objects.get(name)
        place = (float(rng.uniform(-0.38, -0.32)), float(rng.uniform(-0.05, 0.05)))
        grasp = ScriptedGrasp(robot, spec, roll, place)
        simulator.load(robot.description, Scene(objects=(spec,)))
        simulator.set_object_pose(name, grasp.T_object)
        seconds, steps = 0.0, 0
        for phase in grasp.run(simulator):
            start = time.thread_time()
            simulator.step(SUBSTEPS)
            used = time.thread_time() - start
            seconds, steps = seconds + used, steps + SUBSTEPS
            phases[phase][0] += used
            phases[phase][1] += SUBSTEPS
        rates.append(steps / seconds)
        lifted += bool(simulator.object_pose(name)[2, 3] > grasp.T_object[2, 3] + 0.1)
    simulator.close()
    if lifted < len(jobs) // 2:
        raise SimulationError(f"only {lifted} of {len(jobs)} objects were lifted: this is not the scene that is meant")
    figures = {"sim.physics_steps_per_s": Figure(float(np.mean(rates)), "1/s", float(np.std(rates)), len(rates))}
    for phase, (used, done) in phases.items():
        figures[f"sim.physics_steps_per_s.{phase}"] = Figure(done / used, "1/s", None, len(rates))
    return figures


def task_calls(seed: int, repeats: int) -> dict[str, Figure]:
    """Microseconds of what a grasping task calls once per control step beside the physics steps."""
    objects = YcbPrimitives()
    spec = objects.get("006_mustard_bottle")
    simulator = Mujoco()
    simulator.load(ICub().description, Scene(objects=(spec,)))
    simulator.set_object_pose(spec.name, make_transform(None, [-0.35, 0.0, 0.95 + spec.rest_height]))
    simulator.step(10)
    targets = simulator.actuator_positions()
    calls: dict[str, Callable[[], object]] = {
        "set_targets": lambda: simulator.set_targets(targets),
        "actuator_positions": simulator.actuator_positions,
        "link_pose": lambda: simulator.link_pose("r_hand_dh_frame"),
        "object_pose": lambda: simulator.object_pose(spec.name),
        "fingertip_contacts": simulator.fingertip_contacts,
        "faults": simulator.faults,
    }
    times = []
    for _ in track(range(max(repeats, 10)), description="calls", transient=True):
        row = []
        for call in calls.values():
            start = time.thread_time()
            for _ in range(200):
                call()
            row.append((time.thread_time() - start) / 200 * 1e6)
        times.append(sum(row))
    simulator.close()
    return {"sim.task_calls_us": Figure(float(np.median(times)), "us", float(np.std(times)), len(times))}


def render(seed: int, repeats: int) -> dict[str, Figure]:
    """Milliseconds of a 160 x 120 color and depth image of the whole scene from the tracking head camera."""
    objects = YcbPrimitives()
    spec = objects.get("006_mustard_bottle")
    simulator = Mujoco()
    simulator.load(ICub().description, Scene(objects=(spec,)))
    simulator.set_object_pose(spec.name, make_transform(None, [-0.35, 0.0, 0.95 + spec.rest_height]))
    target = simulator.object_pose(spec.name)[:3, 3]
    figures = {}
    for key, size in (("sim.render_ms", (160, 120)), ("sim.render_320x240_ms", (320, 240))):
        simulator.render("head_cam", *size, look_at=target)
        times = []
        for _ in track(range(max(repeats, 30)), description=f"images {size[0]} x {size[1]}", transient=True):
            start = time.process_time()  # drawing may use threads of its own
            simulator.render("head_cam", *size, look_at=target)
            times.append((time.process_time() - start) * 1e3)
        figures[key] = Figure(float(np.median(times)), "ms", float(np.std(times)), len(times))
    simulator.close()
    return figures


FIGURES: dict[str, Callable[[int, int], dict[str, Figure]]] = {
    "physics": physics_steps,
    "calls": task_calls,
    "render": render,
}


def main(argv: Sequence[str]) -> None:
    """Measure, print and write simulation.json."""
    parser = make_parser("simulation", __doc__)
    parser.add_argument("--only", choices=list(FIGURES), action="append", help="measure only these (all by default)")
    parser.add_argument("--repeats", type=int, default=40, help="episodes, images, or rounds of calls")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    figures: dict[str, Figure] = {}
    for name in options.only or list(FIGURES):
        figures |= FIGURES[name](options.seed, options.repeats)
    table = TextTable("figure", "value", "spread", "n", "unit")
    for key, figure in figures.items():
        spread = "" if figure.spread is None else f"{figure.spread:.4g}"
        table.add_row(key, f"{figure.value:.5g}", spread, str(figure.n), figure.unit)
    Console().print(table)
    command = command_line("simulation", argv)
    write_figures(options.results / "simulation.json", figures, command=command, seed=options.seed)
