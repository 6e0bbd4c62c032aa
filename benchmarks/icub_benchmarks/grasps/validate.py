"""Trial of a grasp: close the hand, lift, shake, hold. The same script in any engine, for any hand.

The arm's trajectory is planned once, without a simulator, so every engine executes the same one; what happens to
fingers and object is simulated by each engine. Engines that agree make it less likely that a grasp only suits one of
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Grasp
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Simulator
from icub_core.robot_description import RobotDescription

FloatArray = NDArray[np.float64]

STEP = 0.025
"""Seconds between two commands, as in the grasping task."""
SPEED = 0.002
"""Meters the hand moves in a step while it approaches and lifts."""
NEAR = 0.05
"""Meters before the grasp where the approach begins (thesis 12.3.1)."""
PAST = 0.01
"""Meters that the approach goes on beyond the grasp, stopped by contact, as the scripted demonstrations do."""
LIFT = 0.10
SHAKE = 0.02
"""Meters to either side, along both horizontal axes, one after the other."""
SHAKE_PERIOD, SHAKE_CYCLES = 0.8, 2
"""Seconds and number: the hand is accelerated by up to 1.2 m/s^2."""
HOLD_SECONDS = 1.0
CLOSE_STEPS, FINGER_LEAD = 100, 1 / 25
"""Steps of closing, and the share of its stroke by which a finger's command may lead (see `demonstrations`)."""
SETTLE_STEPS = 4
SAG = 0.03
"""Meters that the object may lack to the height of the lift: arms give way to weight."""
TRACKING_ITERATIONS = 10
LAG = 0.01
"""Meters by which the planned arm may miss the wanted hand position on its way to the grasp and up; where shaking meets
the end of its reach it turns back earlier."""


class Outcome(Enum):
    """How the trial of a grasp ended; only `HELD` is a success."""

    HELD = "lifted, shaken and held"
    UNREACHABLE = "the arm does not reach the whole way"
    NOT_LIFTED = "the object did not come up with the hand"
    SHAKEN_OFF = "the object was lost in shaking"
    DROPPED = "the object was lost while it was held still"
    FAULT = "the physics failed"


@dataclass(frozen=True, eq=False)
class Trial:
    """The arm's commands for one grasp, phase by phase.

    Attributes:
        q_start: (n,) joints 5 cm before the grasp, hand open.
        approach, lift, shake: (k, m) actuator commands; the fingers' columns are the open hand's.
        hand: Name of the hand.
    """

    q_start: FloatArray
    approach: FloatArray
    lift: FloatArray
    shake: FloatArray
    hand: str


def plan_trial(robot: Robot, grasp: Grasp, q_seed: FloatArray) -> Trial | None:
    """Plan the whole trajectory: straight to the grasp, straight up, along two axes to and fro; None if out of reach.

    Args:
        robot: Whose arm and hand.
        grasp: From any generator.
        q_seed: (n,) joints near the grasp, such as a plan's.
    """
    description = robot.description
    hand = description.hand(grasp.hand)
    frame, group = hand.frame, hand.reach
    inward = grasp.T_world_hand[:3, 3] - grasp.backed_off(NEAR)[:3, 3]
    steps = int(np.ceil((NEAR + PAST) / SPEED))
    approach = grasp.backed_off(NEAR)[:3, 3] + np.linspace(0, 1 + PAST / NEAR, steps + 1)[:, None] * inward
    rise = LIFT + PAST  # contact may have stopped the hand before the end of the approach
    lift = approach[-1] + np.linspace(0, rise, round(rise / SPEED) + 1)[1:, None] * [0.0, 0.0, 1.0]
    sway = SHAKE * np.sin(2 * np.pi * np.arange(1, round(SHAKE_CYCLES * SHAKE_PERIOD / STEP) + 1) * STEP / SHAKE_PERIOD)
    shake = np.concatenate([lift[-1] + sway[:, None] * axis for axis in np.eye(3)[:2]])

    T = grasp.T_world_hand.copy()
    T[:3, 3] = approach[0]
    first = robot.inverse_kinematics(T, q_seed, frame, group=group)
    if not first.reached:
        return None
    A, b = description.actuator_matrix()
    opened = _finger_commands(description, grasp.hand)[0]
    fingers = description.actuator_indices(hand.actuators)
    q, phases = first.q, []
    for way in (approach, lift, shake):
        commands = np.empty((len(way), len(b)))
        for row, point in zip(commands, way, strict=True):
            T[:3, 3] = point
            solution = robot.inverse_kinematics(T, q, frame, group=group, max_iterations=TRACKING_ITERATIONS)
            if way is not shake and solution.position_error > LAG:
                return None
            q = solution.q if solution.position_error <= LAG else q
            row[:] = A @ q + b
            row[fingers] = opened
        phases.append(commands)
    return Trial(first.q, phases[0], phases[1], phases[2], grasp.hand)


def run_trial(
    simulator: Simulator, description: RobotDescription, trial: Trial, name: str, T_world_object: FloatArray
) -> Outcome:
    """Carry a trial out and return its outcome.

    Args:
        simulator: Loaded with the robot and the object; its state is lost.
        description: The robot's.
        trial: From `plan_trial`.
        name: The object.
        T_world_object: (4, 4) where it stands.
    """
    engine = _Runner(simulator, description, trial.hand, name)
    simulator.reset()
    simulator.set_object_pose(name, T_world_object)
    q = trial.q_start.copy()
    simulator.set_joint_positions(engine.open_hand(q))
    engine.play(np.repeat(trial.approach[:1], SETTLE_STEPS, axis=0), closing=False)
    rest = simulator.object_pose(name)[:3, 3].copy()
    engine.play(trial.approach, closing=False)
    engine.play(np.repeat(trial.approach[-1:], CLOSE_STEPS, axis=0))
    engine.play(trial.lift)
    wanted = rest[2] + LIFT - SAG
    outcome = Outcome.HELD
    if not engine.holds(wanted):
        outcome = Outcome.NOT_LIFTED
    else:
        engine.play(trial.shake)
        if not engine.holds(wanted):
            outcome = Outcome.SHAKEN_OFF
        else:
            engine.play(np.repeat(trial.shake[-1:], round(HOLD_SECONDS / STEP), axis=0))
            if not engine.holds(wanted):
                outcome = Outcome.DROPPED
    return Outcome.FAULT if simulator.faults() else outcome


class _Runner:
    """Sends commands to one engine and looks after fingers and object."""

    def __init__(self, simulator: Simulator, description: RobotDescription, hand: str, name: str) -> None:
        self._simulator, self._name, self._hand = simulator, name, hand
        self._substeps = round(STEP / simulator.scene.timestep)
        self._fingers = description.actuator_indices(description.hand(hand).actuators)
        self._opened, self._closed = _finger_commands(description, hand)
        self._description = description
        self._share = 0.0

    def open_hand(self, q: FloatArray) -> FloatArray:
        """Return joints (n,) with the hand's where its open command puts them, within their limits."""
        d, q = self._description, q.copy()
        for name in d.hand(self._hand).actuators:
            actuator = d.actuators[int(d.actuator_indices((name,))[0])]
            for joint, coefficient in actuator.coefficients.items():
                share = (actuator.open - actuator.offset) / (coefficient * len(actuator.coefficients))
                i = d.joint_names.index(joint)
                q[i] = np.clip(share, d.lower[i], d.upper[i])
        return q

    def play(self, commands: FloatArray, closing: bool = True) -> None:
        """Send commands (k, m), one per 25 ms; the fingers close and keep squeezing unless `closing` is False."""
        span = self._closed - self._opened
        for row in commands:
            command = row.copy()
            if closing:
                self._share = min(self._share + 1 / CLOSE_STEPS, 1.0)
                now = self._simulator.actuator_positions()[self._fingers]
                lead = np.clip(
                    self._opened + self._share * span - now, -np.abs(span) * FINGER_LEAD, np.abs(span) * FINGER_LEAD
                )
                command[self._fingers] = np.where(span == 0, self._opened, now + lead)
            self._simulator.set_targets(command)
            self._simulator.step(self._substeps)

    def holds(self, height: float) -> bool:
        """Return True if the robot touches the object and the object is at least `height` meters up."""
        up = self._simulator.object_pose(self._name)[2, 3] >= height
        return bool(up and self._simulator.touching(self._name))


def _finger_commands(description: RobotDescription, hand: str) -> tuple[FloatArray, FloatArray]:
    """Return the commands of the open and of the closed hand, each (k,), rad."""
    actuators = [description.actuators[i] for i in description.actuator_indices(description.hand(hand).actuators)]
    return np.array([a.open for a in actuators]), np.array([a.close for a in actuators])
