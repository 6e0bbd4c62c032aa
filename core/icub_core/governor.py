"""Safety governor: what stands between any policy and any robot.

Every command passes through it; the task has no path around it and no switch to turn it off. Three boxes hold at once
for every actuator: position within its range, speed and acceleration below their limits. Before each step the speed is
limited so that braking at full deceleration still stops inside the range: with room s to a limit, time step h and
deceleration a, a speed v is allowed when v h + v^2 / (2 a) <= s. If that held before a step, one step of full braking
keeps it, so the three boxes never contradict each other.
A command that is not finite is a fault: the actuator brakes to a stop and holds, until the next reset.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class SafetyGovernor:
    """Limits a batch of command streams (N worlds, m actuators).

    Args:
        lower, upper: (m,) position box, rad.
        max_speed: (m,) rad/s.
        max_acceleration: (m,) rad/s^2.
        control_step: Seconds between two commands.
        workspace: (2, 3) lowest and highest hand position that may be asked for, world, meters; None permits all.
        worlds: Number of command streams.
    """

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        max_speed: FloatArray,
        max_acceleration: FloatArray,
        control_step: float,
        workspace: FloatArray | None,
        worlds: int = 1,
    ) -> None:
        self._lower, self._upper = lower, upper
        self._max_speed = max_speed
        self._max_acceleration = max_acceleration
        self._step = control_step
        self._workspace = workspace
        self._last = np.tile((lower + upper) / 2, (worlds, 1))
        self._speed = np.zeros_like(self._last)
        self._held: BoolArray = np.zeros(worlds, dtype=np.bool_)

    def begin(self, world: int, command: FloatArray) -> None:
        """Start a stream at rest at `command` (m,), clipped to the position box; faults are forgotten."""
        self._last[world] = np.clip(command, self._lower, self._upper)
        self._speed[world] = 0.0
        self._held[world] = False

    @property
    def held(self) -> BoolArray:
        """(N,) streams that brake and hold after a fault."""
        return self._held

    def hold(self, world: int) -> None:
        """Brake one stream to a stop and hold it there until its next `begin`."""
        self._held[world] = True

    def clean_actions(self, actions: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return actions within [-1, 1] and the streams whose action was not finite (their action becomes 0)."""
        finite = np.isfinite(actions)
        if finite.all():
            return np.minimum(np.maximum(actions, -1.0), 1.0), np.zeros(len(actions), dtype=np.bool_)
        return np.clip(np.where(finite, actions, 0.0), -1.0, 1.0), np.logical_not(finite.all(axis=1))

    def limit_position(self, position: FloatArray) -> FloatArray:
        """Clip wanted hand positions (N, 3), meters, to the workspace."""
        if self._workspace is None:
            return position
        return np.minimum(np.maximum(position, self._workspace[0]), self._workspace[1])

    def limit(self, commands: FloatArray) -> FloatArray:
        """Return the commands (N, m) that may be sent now, given the wanted ones (N, m), rad; the caller owns them."""
        finite = np.isfinite(commands)
        if not finite.all():
            self._held |= ~finite.all(axis=1)
            commands = np.where(finite, commands, self._last)
        h, a = self._step, self._max_acceleration
        change = a * h
        wanted = (commands - self._last) / h
        if self._held.any():
            wanted[self._held] = 0.0
        brake = change * change
        room_up = np.maximum(self._upper - self._last, 0.0)
        room_down = np.maximum(self._last - self._lower, 0.0)
        fastest = np.minimum(np.sqrt(brake + 2 * a * room_up) - change, self._max_speed)
        slowest = -np.minimum(np.sqrt(brake + 2 * a * room_down) - change, self._max_speed)
        np.minimum(fastest, self._speed + change, out=fastest)
        np.maximum(slowest, self._speed - change, out=slowest)
        self._speed = np.minimum(np.maximum(wanted, slowest), fastest)
        self._last = np.minimum(np.maximum(self._last + self._speed * h, self._lower), self._upper)
        return self._last.copy()

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Return copies of what the next commands depend on."""
        return {"last": self._last.copy(), "speed": self._speed.copy(), "held": self._held.copy()}

    def load_state_dict(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Restore what `state_dict` returned."""
        self._last = np.array(state["last"], dtype=np.float64)
        self._speed = np.array(state["speed"], dtype=np.float64)
        self._held = np.array(state["held"], dtype=np.bool_)
