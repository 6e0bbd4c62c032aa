"""The physics of one compiled world: stepping, state, contacts, faults. Knows nothing about images."""

from __future__ import annotations

import functools
import logging
import math
import zlib

import mujoco
import numpy as np
from numpy.typing import NDArray

from icub_core.errors import ConfigError, SimulationError, unknown_name
from icub_core.geometry import FloatArray, matrix_to_quat_wxyz
from icub_core.interfaces.simulator import Fault
from icub_core.robot_description import RobotDescription
from icub_core.scene import Scene
from icub_simulators.mujoco.builder import build_physics, parking_place
from icub_simulators.mujoco.index import ObjectSlots, build_index

logger = logging.getLogger(__name__)

# left alone, the engine prints each warning and appends it to a file in the working directory; `faults` reports them
mujoco.set_mju_user_warning(lambda text: logger.debug("mujoco: %s", text))

GRAVITY = 9.81
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_WARNING = mujoco.mjtWarning
_RESET_WARNINGS = [int(w) for w in (_WARNING.mjWARN_BADQPOS, _WARNING.mjWARN_BADQVEL, _WARNING.mjWARN_BADQACC)]
"""After each of these the engine resets the world by itself."""
_CONTROL_WARNING = int(_WARNING.mjWARN_BADCTRL)
_FULL_WARNINGS = [int(w) for w in (_WARNING.mjWARN_CONTACTFULL, _WARNING.mjWARN_CNSTRFULL)]
_Places = tuple[FloatArray, FloatArray, FloatArray | None, list[int], int, FloatArray]
"""Rotation and position of a body (views), T_body_link, contact codes and fingertip count of a hand, position of an
object (view)."""
_OBJECT, _OTHER = 100, 300
"""Fingertips are 0, 1, ...: fingertip + object from 100 on, two objects 200, anything else 300 and more."""


@functools.cache
def _touches(bits: int, count: int) -> NDArray[np.bool_]:
    """Return the fingertips (count,) in contact of a number with one bit for each, as a shared, read-only array."""
    return np.array([bool(bits >> finger & 1) for finger in range(count)], dtype=np.bool_)


class Physics:
    """A model, its data, and where things stand in them.

    Positions, contacts and velocities always belong to the same moment: a step ends with the position stage of the
    next one (`mj_step1`), which the next step then leaves out, so that this costs nothing.
    """

    def __init__(self, robot: RobotDescription | None, scene: Scene) -> None:
        self.robot = robot
        self.scene = scene
        self.model, frames = build_physics(robot, scene)
        self.data = mujoco.MjData(self.model)
        self.index = build_index(self.model, frames, robot, scene)
        self.parked = np.ones(len(scene.objects), dtype=bool)
        self._state_size = mujoco.mj_stateSize(self.model, _STATE)
        self._mark = float(zlib.crc32(self.model.names))  # of what stands where in a state
        index = self.index
        self._number = {item.name: i for i, item in enumerate(scene.objects)}
        self._is_object = index.object_of_geom >= 0
        self._A, self._b = index.lengths
        # views: MjData never moves its arrays
        self._q = self.data.qpos[index.qpos] if isinstance(index.qpos, slice) else None
        self._dq = self.data.qvel[index.qvel] if isinstance(index.qvel, slice) else None
        self._ctrl, self._qvel, self._lengths = self.data.ctrl, self.data.qvel, self.data.actuator_length
        self._positions, self._rotations = self.data.xpos, self.data.xmat.reshape(-1, 3, 3)
        self._ones = np.ones(self.model.nu)
        self._warnings = self.data.warning.number
        self._frame = np.eye(4)
        self._frame_rotation, self._frame_position = self._frame[:3, :3], self._frame[:3, 3]
        self._places: dict[tuple[str, str, str], _Places] = {}
        self._no_warnings = bytes(self._warnings.nbytes)
        self._slow = float(index.velocity_limits.min(initial=np.inf)) ** 2
        self._tip_codes = {hand: self._contact_codes(tips) for hand, tips in index.fingertip_of_geom.items()}
        hands = self.robot.hands.values() if self.robot is not None else ()
        self._tip_counts = {hand.name: len(hand.fingertips) for hand in hands}
        self._stale = True
        self._seen: set[Fault] = set()
        self._clock = 0.0
        self._half_step = 0.5 * scene.timestep
        self.reset()

    @property
    def time(self) -> float:
        """Simulated seconds since reset."""
        return float(self.data.time)

    def reset(self) -> None:
        """Time 0, home pose at rest, objects parked, faults cleared."""
        mujoco.mj_resetData(self.model, self.data)
        self.parked[:] = True
        if self.robot is not None and not self.robot.gravity_compensation:
            for body in self.index.robot_bodies:
                self._put_weight(body, True)
        self._seen.clear()
        self._clock = 0.0
        if self.robot is not None:
            self.set_joint_positions(self.robot.home_q)
        self._stale = True

    def step(self, n: int) -> None:
        """Advance by n timesteps."""
        if n <= 0:
            return
        model, data = self.model, self.data
        if self._stale:
            self._refresh()
        mujoco.mj_step2(model, data)
        if n > 1:
            mujoco.mj_step(model, data, n - 1)
        mujoco.mj_step1(model, data)
        self._clock += n * self.scene.timestep
        if abs(data.time - self._clock) > self._half_step:
            self._seen.add(Fault.HIDDEN_RESET)
            self._clock = data.time

    def joint_positions(self) -> FloatArray:
        """Return q (n,), rad."""
        return self.data.qpos[self.index.qpos].copy() if self._q is None else self._q.copy()

    def joint_velocities(self) -> FloatArray:
        """Return dq (n,), rad/s."""
        return self.data.qvel[self.index.qvel].copy() if self._dq is None else self._dq.copy()

    def actuator_positions(self) -> FloatArray:
        """Return the actuators' lengths (m,), rad."""
        if self._stale:
            return self._A @ self.joint_positions() + self._b
        return self._lengths + self._b

    def set_joint_positions(self, q: FloatArray) -> None:
        """Teleport the robot, at rest, with targets that hold it."""
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (self._A.shape[1],):
            raise SimulationError(f"joint vector has shape {q.shape}; expected ({self._A.shape[1]},)")
        if not np.all(np.isfinite(q)):
            self._seen.add(Fault.NOT_A_NUMBER)
            return
        self.data.qpos[self.index.qpos] = q
        self.data.qvel[self.index.qvel] = 0.0
        self.data.qacc_warmstart[:] = 0.0
        self._ctrl[:] = self._A @ q + self._b
        self._stale = True

    def set_targets(self, targets: FloatArray) -> None:
        """Command every actuator; a command that is not finite is a fault and changes nothing.

        The engine itself keeps forces to what the actuators' ranges allow.
        """
        targets = np.asarray(targets, dtype=np.float64)
        if targets.shape != self._ctrl.shape:
            raise SimulationError(
                f"command has shape {targets.shape}; expected {self._ctrl.shape}, one length per actuator"
            )
        # a sum is finite only if every command is; faster than isfinite().all()
        if not math.isfinite(self._ones.dot(targets)):
            self._seen.add(Fault.NOT_A_NUMBER)
            return
        self._ctrl[:] = targets

    def link_pose(self, link: str) -> FloatArray:
        """Return T_world_link (4, 4)."""
        slot = self.index.links.get(link)
        if slot is None:
            raise ConfigError(unknown_name("link", link, self.index.links))
        if self._stale:
            self._refresh()
        T = np.zeros((4, 4))
        T[:3, :3] = self._rotations[slot.body]
        T[:3, 3] = self._positions[slot.body]
        T[3, 3] = 1.0
        return T if slot.offset is None else T.dot(slot.offset)

    def object_pose(self, name: str) -> FloatArray:
        """Return T_world_object (4, 4)."""
        slots = self.slots(name)
        if self._stale:
            self._refresh()
        T = np.zeros((4, 4))
        T[:3, :3] = self._rotations[slots.body]
        T[:3, 3] = self._positions[slots.body]
        T[3, 3] = 1.0
        return T

    def set_object_pose(self, name: str, T_world_object: FloatArray) -> None:
        """Teleport an object, at rest."""
        slots = self.slots(name)
        T = np.asarray(T_world_object, dtype=np.float64)
        if not np.all(np.isfinite(T)):
            self._seen.add(Fault.NOT_A_NUMBER)
            return
        self._place(slots, np.concatenate([T[:3, 3], matrix_to_quat_wxyz(T[:3, :3])]))
        self._set_parked(name, False)

    def park_object(self, name: str) -> None:
        """Put an object far away, weightless."""
        slots = self.slots(name)
        self._place(slots, np.array([*parking_place(self._number[name]), 1.0, 0.0, 0.0, 0.0]))
        self._set_parked(name, True)

    def slots(self, name: str) -> ObjectSlots:
        """Return an object's place; raises ConfigError for an unknown one."""
        slots = self.index.objects.get(name)
        if slots is None:
            raise ConfigError(unknown_name("object in the scene", name, self.index.objects))
        return slots

    def fingertip_contacts(self, hand: str) -> NDArray[np.bool_]:
        """Return (t,) bool: which fingertips of a hand touch any object."""
        codes = self._tip_codes.get(hand)
        if codes is None:
            raise ConfigError(unknown_name("hand with fingertips", hand, self._tip_codes))
        if self._stale:
            self._refresh()
        return self._touched(codes, self._tip_counts[hand]).copy()

    def _touched(self, codes: list[int], count: int) -> NDArray[np.bool_]:
        bits = 0
        if self.data.ncon:
            for first, second in self.data.contact.geom.tolist():  # a few contacts: faster than five array operations
                finger = codes[first] + codes[second] - _OBJECT
                if 0 <= finger < count:
                    bits |= 1 << finger
        return _touches(bits, count)

    def hand_and_object(
        self, frame: str, hand: str, name: str
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]:
        """Return T_world_frame (4, 4), actuator lengths (m,), fingertip contacts (t,), object position (3,).

        The caller copies what it keeps: these are buffers and views.
        """
        places = self._places.get((frame, hand, name))
        if places is None:
            self.link_pose(frame), self.fingertip_contacts(hand)  # refuse unknown names once
            link, thing = self.index.links[frame], self.slots(name).body
            body = self._rotations[link.body], self._positions[link.body]
            places = self._places[frame, hand, name] = (
                *body,
                link.offset,
                self._tip_codes[hand],
                self._tip_counts[hand],
                self._positions[thing],
            )
        rotation, position, offset, codes, count, object_position = places
        if self._stale:
            self._refresh()
        self._frame_rotation[...] = rotation
        self._frame_position[...] = position
        T = self._frame if offset is None else self._frame.dot(offset)
        return T, self._lengths + self._b, self._touched(codes, count), object_position

    def _contact_codes(self, fingertip_of_geom: NDArray[np.int8]) -> list[int]:
        """Number geoms such that only the sum of finger f and an object is `_OBJECT` + f."""
        codes = np.full(self.model.ngeom, _OTHER, dtype=np.intp)
        codes[self._is_object] = _OBJECT
        fingers = fingertip_of_geom >= 0
        codes[fingers] = fingertip_of_geom[fingers]
        numbers: list[int] = codes.tolist()
        return numbers

    def touching(self, name: str) -> bool:
        """Return True if the robot touches the object anywhere."""
        self.slots(name)
        if self._stale:
            self._refresh()
        if not self.data.ncon:
            return False
        geoms = self.data.contact.geom
        other = self.index.object_of_geom[geoms] == self._number[name]
        robot = self.index.robot_geom[geoms]
        return bool(np.any(other[:, 0] & robot[:, 1]) or np.any(other[:, 1] & robot[:, 0]))

    def save(self) -> FloatArray:
        """Return everything that decides the future as one vector: the engine's, what is parked, the world's mark."""
        size = self._state_size
        state = np.empty(size + len(self.parked) + 1)
        mujoco.mj_getState(self.model, self.data, state[:size], _STATE)
        state[size:-1] = self.parked
        state[-1] = self._mark
        return state

    def restore(self, state: FloatArray) -> None:
        """Continue from `save`; raises SimulationError for a vector of another world."""
        size = self._state_size
        state = np.ascontiguousarray(state, dtype=np.float64)
        if state.shape != (size + len(self.parked) + 1,):
            raise SimulationError(f"state has shape {state.shape}; this world's has ({size + len(self.parked) + 1},)")
        if state[-1] != self._mark:
            raise SimulationError("the state is that of a world with other joints or objects, or in another order")
        mujoco.mj_resetData(self.model, self.data)  # also forgets the warnings
        mujoco.mj_setState(self.model, self.data, state[:size], _STATE)
        self.parked[:] = state[size:-1] > 0.5
        self._seen.clear()
        self._clock = self.data.time
        self._stale = True

    def faults(self) -> tuple[Fault, ...]:
        """Return what went wrong since the last reset or restore."""
        warnings = self._warnings
        if warnings.tobytes() != self._no_warnings:  # half the time of a task's readings went into warnings.any()
            if warnings[_RESET_WARNINGS].any():
                self._seen.update((Fault.HIDDEN_RESET, Fault.NOT_A_NUMBER))
            if warnings[_CONTROL_WARNING]:
                self._seen.add(Fault.NOT_A_NUMBER)
            if warnings[_FULL_WARNINGS].any():
                self._seen.add(Fault.DROPPED_CONTACTS)
        # cheap test first, which a NaN fails: below the smallest limit as a whole, every speed is below its own
        if not self._qvel.dot(self._qvel) <= self._slow and not np.all(
            np.abs(self._qvel) <= self.index.velocity_limits
        ):
            finite = bool(np.all(np.isfinite(self._qvel)))
            self._seen.add(Fault.EXPLODING_VELOCITY if finite else Fault.NOT_A_NUMBER)
        return tuple(fault for fault in Fault if fault in self._seen) if self._seen else ()

    def _place(self, slots: ObjectSlots, pose: FloatArray) -> None:
        self.data.qpos[slots.qpos] = pose
        self.data.qvel[slots.qvel] = 0.0
        self.data.qacc_warmstart[slots.qvel] = 0.0
        self._stale = True

    def _set_parked(self, name: str, parked: bool) -> None:
        self.parked[self._number[name]] = parked
        self._put_weight(self.slots(name).body, not parked)

    def _put_weight(self, body: int, on: bool) -> None:
        """Let a body feel gravity.

        The world has none: a force of the weight on the one body that is in play is the same physics as compensating
        gravity in each of the robot's sixty bodies, and saves a seventh of a step's time. Parked objects float.
        """
        self.data.xfrc_applied[body, 2] = -GRAVITY * self.model.body_mass[body] if on else 0.0

    def _refresh(self) -> None:
        mujoco.mj_step1(self.model, self.data)
        self._stale = False
