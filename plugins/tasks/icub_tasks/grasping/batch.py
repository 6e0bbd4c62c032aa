"""Steps many worlds of the grasping task at once: numpy in, numpy out; everything but physics is vectorized."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError
from icub_core.interfaces.world import Fault
from icub_tasks.grasping.fault_filter import FaultFilter
from icub_tasks.grasping.reward import GraspReward
from icub_tasks.grasping.signals import HandReader, ObjectReader, Signals
from icub_tasks.grasping.spaces import (
    FINGERS,
    HAND_POSE,
    OBJECT_CENTER,
    PLAN_CLOSED,
    PLAN_GRASP,
    PLAN_OPENED,
    PLAN_START,
    STEP,
    TOUCH,
    matrix_to_euler,
)
from icub_tasks.grasping.termination import EndReason, end_reasons
from icub_tasks.grasping.tracking import HandTracker
from icub_tasks.grasping.world import CONTROL_STEP, GraspWorld, StartState, make_governor

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Observation = dict[str, NDArray[np.float32]]


MAX_LEAD, MAX_TURN = 0.01, 0.15
"""Meters and radians that the commanded hand pose may lie beyond what the arm reaches.

DIFF: unlimited in the thesis, where drifting out of reach ends the episode; here the command waits at the edge, and
only a solver that diverges is a fault."""
NOT_BEGUN = -1
"""Stands in a state for the object of a world in which no episode has begun."""


@dataclass(frozen=True, eq=False)
class StepResult:
    """What one step gave, by world.

    Attributes:
        reward: (N,).
        reason: (N,) `EndReason`, 0 while the episode runs.
        fault: (N,) the transition must not be learned from.
    """

    reward: FloatArray
    reason: NDArray[np.int64]
    fault: BoolArray


class TaskBatch:
    """N worlds of one robot, each with its own simulator.

    Args:
        worlds: Same robot, hand and settings.
        threads: Threads that step physics; 1 steps in the caller's.
        signals: How the object's motion is known.
    """

    def __init__(self, worlds: Sequence[GraspWorld], threads: int = 1, signals: Signals = "object") -> None:
        if not worlds:
            raise ConfigError("a grasping task needs at least one world")
        first = worlds[0]
        self.worlds = list(worlds)
        self.layout, self.settings = first.layout, first.settings
        self.fault_filter = FaultFilter()
        count, description = len(worlds), first.robot.description
        self._scale = self.layout.action_scale
        self._simulators = [world.simulator for world in worlds]
        self._tracker = HandTracker(first.robot, self.layout)
        self._governor = make_governor(self.layout, count)
        self._reader = ObjectReader(self.layout) if signals == "object" else HandReader(self.layout, count)
        self._reward = GraspReward(count)
        self._objects = [""] * count
        self._q = np.zeros((count, len(description.joint_names)))
        self._target = np.zeros((count, 6))
        self._command = np.zeros((count, len(description.actuators)))
        self._center = np.zeros((count, 3))
        self._rest = np.zeros((count, 3))
        self._plan_start, self._plan_grasp = np.zeros((count, 3)), np.zeros((count, 3))
        self._steps = np.zeros(count, dtype=np.int64)
        self._hand = np.tile(np.eye(4), (count, 1, 1))
        self._lengths = np.zeros_like(self._command)
        self._fingers = np.zeros((count, len(self.layout.fingers)))
        self._faults: list[tuple[Fault, ...]] = [()] * count
        self._touch = np.zeros((count, len(self.layout.hand.fingertips)))
        self._object = np.zeros((count, 3))
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._shares: list[Sequence[int]] = [range(k, count, max(threads, 1)) for k in range(max(threads, 1))]

    def __len__(self) -> int:
        return len(self.worlds)

    def begin(self, world: int, start: StartState) -> None:
        """Put one world at the start of an episode."""
        self._simulators[world].restore_state(start.simulation)
        self._objects[world] = start.plan.object_name
        self._q[world], self._target[world], self._command[world] = start.q_command, start.hand_target, start.command
        self._center[world], self._rest[world] = start.plan.grasp.object_center, start.object_rest
        self._plan_start[world] = start.plan.T_near[:3, 3]
        self._plan_grasp[world] = start.plan.grasp.T_world_hand[:3, 3]
        self._steps[world] = 0
        self._governor.begin(world, start.command)
        self._reader.begin(world, start.object_rest)
        self._read(world)
        self._fingers[world] = self._lengths[world, self.layout.fingers]
        self._reward.begin(
            world,
            contacts=float(self._touch[world].sum()),
            distance=float(self._distance()[world]),
            height=float(self._object[world, 2]),
        )

    def step(self, actions: FloatArray, active: Sequence[bool] | None = None) -> StepResult:
        """Do one control step (25 ms) with actions (N, 6 + F) in [-1, 1]; anything else is made safe.

        Args:
            actions: (N, 6 + F).
            active: Worlds whose physics advances; what is returned of the others means nothing.
        """
        actions, bad = self._governor.clean_actions(np.asarray(actions, dtype=np.float64))
        if bad.any():
            for world in np.flatnonzero(bad):
                self._governor.hold(int(world))
        offsets = actions * self._scale
        before = self._target.copy()
        self._target += offsets[:, :6]
        self._target[:, :3] = self._governor.limit_position(self._target[:, :3])
        errors = self._follow(active)
        ahead = (errors[:, 0] > MAX_LEAD) | (errors[:, 1] > MAX_TURN)
        if ahead.any():  # out of reach: the target waits for the hand instead of running away from it
            self._target[ahead] = before[ahead]
        layout = self.layout
        self._command[:, layout.reach_actuators] = self._q[:, layout.reach_joints]
        self._command[:, layout.fingers] = self._fingers + offsets[:, 6:]
        self._command = self._governor.limit(self._command)
        self._q[:, layout.reach_joints] = self._command[:, layout.reach_actuators]
        self._advance(active)
        self._steps += 1
        contacts = self._touch.sum(axis=1)
        displacement = self._object - self._rest
        settings = self.settings
        reasons = end_reasons(
            displacement,
            contacts,
            self._steps,
            lift=settings.lift,
            moved=settings.moved,
            fallen=settings.fallen,
            max_steps=settings.max_steps,
        )
        readings = (self._object, self._hand.reshape(len(self.worlds), 16), self._fingers)
        finite = np.isfinite(sum(np.add.reduce(reading, axis=1) for reading in readings))
        fault = self.fault_filter.inspect(reasons, self._faults, errors, bad, finite, active)
        success = reasons == EndReason.SUCCESS
        failure = (reasons == EndReason.MOVED) | (reasons == EndReason.TIME_LIMIT)
        reward = self._reward(contacts, self._distance(), self._object[:, 2].copy(), success, failure)
        if fault.any():
            reward[fault] = 0.0
        return StepResult(reward, reasons, fault)

    def observation(self) -> Observation:
        """Return what a policy may know, float32 arrays (N, ...) that the caller owns (see `spaces`)."""
        pose = np.empty((len(self.worlds), 6), dtype=np.float32)
        pose[:, :3] = self._hand[:, :3, 3]
        pose[:, 3:] = matrix_to_euler(self._hand[:, :3, :3])
        return {
            HAND_POSE: pose,
            FINGERS: self._fingers.astype(np.float32),
            TOUCH: self._touch.astype(np.float32),
            OBJECT_CENTER: self._center.astype(np.float32),
            PLAN_START: self._plan_start.astype(np.float32),
            PLAN_GRASP: self._plan_grasp.astype(np.float32),
            PLAN_OPENED: np.tile(self.layout.opened.astype(np.float32), (len(self.worlds), 1)),
            PLAN_CLOSED: np.tile(self.layout.closed.astype(np.float32), (len(self.worlds), 1)),
            STEP: self._steps.astype(np.float32)[:, None],
        }

    def object_name(self, world: int) -> str:
        """Return what one world's episode is about."""
        return self._objects[world]

    def _follow(self, active: Sequence[bool] | None) -> FloatArray:
        """Move the commanded joints towards the targets; returns what is left, (N, 2) m and rad, 0 where not active."""
        if active is None or all(active):
            return self._tracker.follow(self._q, self._target)
        worlds, errors = np.flatnonzero(active), np.zeros((len(self.worlds), 2))
        q = self._q[worlds]
        errors[worlds] = self._tracker.follow(q, self._target[worlds])
        self._q[worlds] = q
        return errors

    def _advance(self, active: Sequence[bool] | None) -> None:
        shares = self._shares
        if active is not None:
            shares = [[world for world in share if active[world]] for share in shares]
        if self._pool is None:
            self._advance_share(shares[0])
        else:
            list(self._pool.map(self._advance_share, shares))
        self._lengths.take(self.layout.fingers, axis=1, out=self._fingers)

    def _advance_share(self, share: Sequence[int]) -> None:
        # a loop for each task: physics throws the interpreter out of the processor's caches
        for world in share:
            self._simulators[world].set_targets(self._command[world])
        self.simulate(share)
        for world in share:
            self._read(world)

    def simulate(self, worlds: Sequence[int]) -> None:
        """Advance the physics of some worlds by one control step; everything else of a step is `step`'s."""
        for world in worlds:
            self._simulators[world].tick(CONTROL_STEP)

    def _read(self, world: int) -> None:
        simulator = self._simulators[world]
        readings = self._reader.read(world, simulator, self._objects[world])
        self._hand[world], self._lengths[world], self._touch[world], self._object[world] = readings
        self._faults[world] = simulator.faults()

    def _distance(self) -> FloatArray:
        """(N,) distance of the estimated center from the hand's z axis, meters."""
        local = np.einsum("nji,nj->ni", self._hand[:, :3, :2], self._center - self._hand[:, :3, 3])
        return np.sqrt(np.sum(local * local, axis=1))

    def object_positions(self) -> FloatArray:
        """Return where the objects are, (N, 3) world, meters."""
        return self._object.copy()

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Return everything that decides the future of all worlds, as arrays."""
        arrays: dict[str, NDArray[np.generic]] = {name: getattr(self, f"_{name}").copy() for name in _ARRAYS}
        arrays.update({f"governor.{k}": v for k, v in self._governor.state_dict().items()})
        arrays.update({f"reward.{k}": v for k, v in self._reward.state_dict().items()})
        arrays.update({f"reader.{k}": v for k, v in self._reader.state_dict().items()})
        arrays.update({f"simulation.{i}": s.save_state() for i, s in enumerate(self._simulators)})
        pairs = zip(self.worlds, self._objects, strict=True)
        names = [world.objects.index(name) if name else NOT_BEGUN for world, name in pairs]
        arrays["objects"] = np.array(names, dtype=np.int64)
        counts = [self.fault_filter.ends.get(reason, 0) for reason in EndReason]
        arrays["ends"] = np.array(counts, dtype=np.int64)
        return arrays

    def load_state_dict(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore what `state_dict` returned, in a batch of the same worlds."""
        for name in _ARRAYS:
            getattr(self, f"_{name}")[...] = arrays[name]
        self._governor.load_state_dict(part(arrays, "governor."))
        self._reward.load_state_dict(part(arrays, "reward."))
        self._reader.load_state_dict(part(arrays, "reader."))
        for i, simulator in enumerate(self._simulators):
            simulator.restore_state(np.asarray(arrays[f"simulation.{i}"], dtype=np.float64))
        pairs = zip(self.worlds, arrays["objects"].tolist(), strict=True)
        self._objects = ["" if k == NOT_BEGUN else world.objects[k] for world, k in pairs]
        self.fault_filter.ends = Counter(
            {reason: int(n) for reason, n in zip(EndReason, arrays["ends"], strict=True) if n}
        )

    def close(self) -> None:
        """Free threads and simulators; may be called twice."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
        for simulator in self._simulators:
            simulator.close()


def part(arrays: Mapping[str, NDArray[np.generic]], prefix: str) -> dict[str, NDArray[np.generic]]:
    """Return the arrays whose names begin with `prefix`, without it."""
    return {key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)}


_ARRAYS = (
    "q",
    "target",
    "command",
    "center",
    "rest",
    "plan_start",
    "plan_grasp",
    "steps",
    "hand",
    "fingers",
    "touch",
    "object",
)
