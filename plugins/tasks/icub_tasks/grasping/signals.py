"""Where a task learns how the object moves: reward and ends of episodes depend on it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from icub_core.interfaces.simulator import Simulator
from icub_core.interfaces.world import World
from icub_tasks.grasping.spaces import FINGERTIPS_OF_A_GRASP, HandLayout

FloatArray = NDArray[np.float64]
Signals = Literal["object", "hand"]
"""``object``: the object's own position, which only a simulator has. ``hand``: the height of a hand that touches, which
a real robot has too."""

Reading = tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]
"""Hand pose (4, 4), actuator lengths (m,), fingertip contacts (t,), object position (3,)."""


class ObjectReader:
    """Reads a simulated world, the object's position included."""

    def __init__(self, layout: HandLayout) -> None:
        self._frame, self._hand = layout.hand.frame, layout.hand.name

    def begin(self, number: int, position: FloatArray) -> None:
        """Start an episode of one world."""

    def read(self, number: int, world: World, target: str) -> Reading:
        """Read one world."""
        assert isinstance(world, Simulator)
        return world.hand_and_object(self._frame, self._hand, target)

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Return what the next readings depend on beside the world: nothing."""
        return {}

    def load_state_dict(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Restore what `state_dict` returned."""


class HandReader:
    """Reads any world: the object is taken to rest where it was seen, and to move with a hand that holds it."""

    def __init__(self, layout: HandLayout, worlds: int) -> None:
        self._frame, self._hand = layout.hand.frame, layout.hand.name
        self._object = np.zeros((worlds, 3))
        self._last = np.full((worlds, 3), np.nan)

    def begin(self, number: int, position: FloatArray) -> None:
        """Start an episode of one world with the object at `position` (3,)."""
        self._object[number], self._last[number] = position, np.nan

    def read(self, number: int, world: World, target: str) -> Reading:
        """Read one world."""
        pose, contacts = world.link_pose(self._frame), world.fingertip_contacts(self._hand)
        if contacts.sum() >= FINGERTIPS_OF_A_GRASP and np.isfinite(self._last[number]).all():
            self._object[number] += pose[:3, 3] - self._last[number]
        self._last[number] = pose[:3, 3]
        return pose, world.actuator_positions(), contacts, self._object[number]

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Return what the next readings depend on beside the world."""
        return {"object": self._object.copy(), "last": self._last.copy()}

    def load_state_dict(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Restore what `state_dict` returned."""
        self._object[...], self._last[...] = state["object"], state["last"]
