"""One world of the grasping task: places an object, looks, plans, and brings the hand in front of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.data import Grasp
from icub_core.errors import ConfigError, SimulationError, unknown_name
from icub_core.geometry import make_transform, quat_wxyz_to_matrix, rotation_about
from icub_core.governor import SafetyGovernor
from icub_core.interfaces.grasp_generator import GraspGenerator
from icub_core.interfaces.robot import Robot
from icub_core.interfaces.simulator import Rendering, Simulator
from icub_tasks.grasping.plan import FAR, GraspPlan, MaskProvider, PlanFailure, plan_grasp
from icub_tasks.grasping.spaces import TRANSLATION_STEP, HandLayout, hand_layout, pose_vector
from icub_tasks.grasping.tracking import HandTracker

FloatArray = NDArray[np.float64]

CONTROL_STEP = 0.025
"""Seconds of one action (thesis)."""
SETTLE_STEPS = 20
"""Physics steps after the object is placed, so that it rests before it is looked at."""
TRANSFER_STEPS = 50
TRANSFER_MOVING = 40
"""Control steps from home to the 10 cm pose; the joints arrive after the second number (released code)."""
APPROACH_STEP = TRANSLATION_STEP / 2
"""Meters a control step from the 10 cm to the 5 cm pose (released code)."""
MAX_RESAMPLES = 100
"""Object poses without a plan in a row after which the object counts as not graspable."""


@dataclass(frozen=True)
class TaskSettings:
    """Numbers of the task.

    Attributes:
        max_steps: Time limit of an episode, control steps (thesis 2000; scripted episodes here need about 190).
        lift: Meters the object must rise.
        moved: Meters sideways at which it was moved too far.
        fallen: Meters its center may sink before it counts as toppled or fallen.
        x_range, y_range: Where objects are placed, world, meters.
        camera: Name of the robot's camera; None takes the first.
        width, height: Pixels of the image that is planned from.
    """

    max_steps: int = 250
    lift: float = 0.10
    moved: float = 0.10
    fallen: float = 0.02
    x_range: tuple[float, float] = (-0.4, -0.3)
    y_range: tuple[float, float] = (-0.1, 0.1)
    camera: str | None = None
    width: int = 320
    height: int = 240


@dataclass(frozen=True, eq=False)
class StartState:
    """A world at the pre-grasp pose, ready for the first action.

    Attributes:
        plan: How it came there.
        simulation: What `Simulator.save_state` returned.
        q_command: (n,) commanded joints.
        hand_target: (6,) commanded hand pose, x, y, z, yaw, pitch, roll.
        command: (m,) command sent last.
        object_rest: (3,) object position at rest before the hand came, meters.
    """

    plan: GraspPlan
    simulation: FloatArray
    q_command: FloatArray
    hand_target: FloatArray
    command: FloatArray
    object_rest: FloatArray

    @property
    def target(self) -> str:
        """Name of the object that is grasped."""
        return self.plan.object_name


class GraspWorld:
    """One simulated robot at a table (thesis 12.3.1 and its reset).

    Args:
        simulator: A loaded world with the robot and every object that may be grasped.
        robot: The same robot.
        generator: Plans grasps from the masked cloud.
        objects: Names of the objects to grasp, one drawn for each episode; None takes all of the scene.
        masks: Finds the object in the image; None takes the simulator's own segmentation.
        hand: Name of the hand; None takes the robot's first.
        settings: Numbers of the task.
        seed: Decides object, place and turn of every episode.
    """

    def __init__(
        self,
        simulator: Simulator,
        robot: Robot,
        generator: GraspGenerator,
        objects: Sequence[str] | None = None,
        *,
        masks: MaskProvider | None = None,
        hand: str | None = None,
        settings: TaskSettings | None = None,
        seed: int = 0,
    ) -> None:
        self.simulator = simulator
        self.robot = robot
        self.generator = generator
        self.settings = settings or TaskSettings()
        self._specs = {spec.name: spec for spec in simulator.scene.objects}
        self.objects = tuple(self._specs) if objects is None else tuple(objects)
        for name in self.objects:
            if name not in self._specs:
                raise ConfigError(unknown_name("object in the scene", name, self._specs))
        if not self.objects:
            raise ConfigError("the scene has no object; the grasping task needs at least one")
        description = robot.description
        self.camera = description.camera(self.settings.camera).name
        self.layout: HandLayout = hand_layout(description, hand)
        self._masks = masks
        self._tracker = HandTracker(robot, self.layout)
        self._governor = make_governor(self.layout, worlds=1)
        self._actuator_matrix, self._actuator_offset = description.actuator_matrix()
        self._rng = np.random.default_rng(seed)
        self.plan_failures: Counter[PlanFailure] = Counter()

    def prepare(self, rng: np.random.Generator | None = None) -> StartState:
        """Draw objects and places until one has a plan, then go to its pre-grasp pose.

        Args:
            rng: Decides everything random; None continues the task's own stream.

        Raises:
            SimulationError: No plan for a hundred poses in a row.
        """
        rng = rng or self._rng
        failures: Counter[PlanFailure] = Counter()
        for _ in range(MAX_RESAMPLES):
            name = self.objects[int(rng.integers(len(self.objects)))]
            rest = self.place(name, rng)
            plan = self.plan(name)
            if isinstance(plan, GraspPlan):
                return self.approach(plan, rest)
            failures[plan] += 1
            self.plan_failures[plan] += 1
        worst = failures.most_common(1)[0][0]
        raise SimulationError(f"no grasp plan for {list(self.objects)} in {MAX_RESAMPLES} poses: mostly, {worst.value}")

    def place(self, name: str, rng: np.random.Generator) -> FloatArray:
        """Reset the world, put the object on the table at random, let it settle; returns its position (3,), meters."""
        spec, settings = self._specs[name], self.settings
        table = self.simulator.scene.table
        top = table.top if table is not None else 0.0
        x, y, yaw = rng.uniform(*settings.x_range), rng.uniform(*settings.y_range), rng.uniform(0.0, 2 * np.pi)
        R = rotation_about("z", yaw) @ quat_wxyz_to_matrix(spec.rest_quat_wxyz)
        self.simulator.reset()
        self.simulator.set_object_pose(name, make_transform(R, [x, y, top + spec.rest_height]))
        self.simulator.step(SETTLE_STEPS)
        return self.simulator.object_pose(name)[:3, 3].copy()

    def look(self, name: str) -> Rendering:
        """Take the image that grasps are planned from: the head camera turned to the object (thesis)."""
        return self.simulator.render(
            self.camera,
            self.settings.width,
            self.settings.height,
            look_at=self.simulator.object_pose(name)[:3, 3],
            segmentation=self._masks is None,
        )

    def plan(self, name: str) -> GraspPlan | PlanFailure:
        """Look at the object where it stands and plan its grasp."""
        image = self.look(name)
        if self._masks is not None:
            mask = self._masks(image.frame, name)
        else:
            assert image.segmentation is not None
            mask = image.segmentation == list(self._specs).index(name)
        return plan_grasp(
            image.frame,
            mask,
            name,
            self.generator,
            self.robot,
            self.robot.description.home_q,
            table=self.simulator.scene.table,
            hand=self.layout.hand,
        )

    def approach(self, plan: GraspPlan, object_rest: FloatArray) -> StartState:
        """Move from home to the 10 cm pose by minimum-jerk joint interpolation, then straight to the 5 cm pose."""
        home = self.robot.description.home_q
        q = home.copy()
        command = self._actuator_matrix @ q + self._actuator_offset
        command[self.layout.fingers] = self.layout.opened
        self._governor.begin(0, command)
        for step in range(1, TRANSFER_STEPS + 1):
            share = min(step / TRANSFER_MOVING, 1.0)
            q = home + (plan.q_far - home) * share**3 * (10 - 15 * share + 6 * share**2)
            command = self._send(q, command)
        target = pose_vector(plan.T_far)[None]
        way = plan.T_near[:3, 3] - plan.T_far[:3, 3]
        steps = max(1, round(float(np.linalg.norm(way)) / APPROACH_STEP))
        q = plan.q_far.copy()[None]
        for _ in range(steps):
            target[0, :3] += way / steps
            self._tracker.follow(q, target)
            command = self._send(q[0], command)
        return StartState(plan, self.simulator.save_state(), q[0], target[0], command, object_rest)

    def start_before(self, grasp: Grasp, distance: float, object_rest: FloatArray) -> StartState | None:
        """Return the present world with the arm put `distance` meters before a grasp; None where it is not reached."""
        description, hand = self.robot.description, self.layout.hand
        q = description.home_q
        T_far, T_near = grasp.backed_off(FAR), grasp.backed_off(distance)
        for T in (T_far, T_near):
            solution = self.robot.inverse_kinematics(T, q, hand.frame, group=hand.reach)
            if not solution.reached:
                return None
            q = solution.q
        command = self._actuator_matrix @ q + self._actuator_offset
        command[self.layout.fingers] = self.layout.opened
        self.simulator.set_joint_positions(q)
        self.simulator.set_targets(command)
        plan = GraspPlan(self.objects[0], grasp, T_far, T_near, q)
        return StartState(plan, self.simulator.save_state(), q, pose_vector(T_near), command, object_rest)

    def _send(self, q: FloatArray, command: FloatArray) -> FloatArray:
        wanted = command.copy()
        wanted[self.layout.reach_actuators] = q[self.layout.reach_joints]
        sent = self._governor.limit(wanted[None])[0]
        self.simulator.set_targets(sent)
        self.simulator.tick(CONTROL_STEP)
        return sent


def make_governor(layout: HandLayout, worlds: int) -> SafetyGovernor:
    """Build the governor of the task from the robot's own limits.

    A finger's command may move as fast as actions can ask: to the far side of the measured length and back.
    """
    speed, acceleration = layout.max_speed.copy(), layout.max_acceleration.copy()
    speed[layout.fingers] = 2 * layout.finger_step / CONTROL_STEP
    acceleration[layout.fingers] = 2 * speed[layout.fingers] / CONTROL_STEP
    return SafetyGovernor(layout.lower, layout.upper, speed, acceleration, CONTROL_STEP, layout.hand.workspace, worlds)
