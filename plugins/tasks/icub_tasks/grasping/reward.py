"""Reward of the grasping task.

r = r_fingers + r_distance + r_height + r_end, with n the number of fingertips in contact (thesis 12.3.1, eq. 12.1):

- r_fingers = n(t+1) - n(t);
- r_distance = d(t) - d(t+1) in cm, d the distance of the estimated object center from the hand frame's z axis, that
  is the norm of its x and y coordinates in that frame, as long as fewer than two fingers have touched;
- r_height = n(t+1) * (h(t+1) - h(t)) in mm, for a rise when n(t+1) >= 2, for a fall once two fingers have touched;
- r_end = +1 for success, -1 for every failure, the time limit included.

DIFF: the thesis prints r_distance with the opposite sign, which would reward moving away; approaching is rewarded here
(as in the released code). The released code scales a rise by n/5 and a fall not at all, replaces the whole reward by -1
at a failure, and carries d, n and the two-finger flag over from the motion before the episode; here the thesis's text
holds and an episode starts afresh.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from icub_tasks.grasping.spaces import FINGERTIPS_OF_A_GRASP

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MILLIMETERS = 1000.0
CENTIMETERS = 100.0


class GraspReward:
    """Rewards of a batch of worlds; remembers what the differences need."""

    def __init__(self, worlds: int) -> None:
        self._contacts = np.zeros(worlds)
        self._distance = np.zeros(worlds)
        self._height = np.zeros(worlds)
        self.two_touched: BoolArray = np.zeros(worlds, dtype=np.bool_)

    def begin(self, world: int, *, contacts: float, distance: float, height: float) -> None:
        """Start an episode of one world from what holds at its first step: count, meters, meters."""
        self._contacts[world], self._distance[world], self._height[world] = contacts, distance, height
        self.two_touched[world] = contacts >= FINGERTIPS_OF_A_GRASP

    def __call__(
        self, contacts: FloatArray, distance: FloatArray, height: FloatArray, success: BoolArray, failure: BoolArray
    ) -> FloatArray:
        """Return the rewards (N,) of one step.

        Args:
            contacts: (N,) fingertips in contact after the step.
            distance: (N,) distance of the object center from the hand's z axis after the step, meters.
            height: (N,) height of the object after the step, meters.
            success: (N,) the episode ends with the object lifted.
            failure: (N,) the episode ends otherwise.
        """
        holds = contacts >= FINGERTIPS_OF_A_GRASP
        self.two_touched |= holds
        rise = (height - self._height) * MILLIMETERS
        counts = np.where(rise > 0, holds, self.two_touched)
        rewards = (contacts - self._contacts) + counts * contacts * rise
        rewards += ~self.two_touched * (self._distance - distance) * CENTIMETERS
        rewards += success
        rewards -= failure
        self._contacts, self._distance, self._height = contacts, distance, height
        return rewards

    def state_dict(self) -> dict[str, NDArray[np.generic]]:
        """Return copies of what the next rewards depend on."""
        return {
            "contacts": self._contacts.copy(),
            "distance": self._distance.copy(),
            "height": self._height.copy(),
            "two_touched": self.two_touched.copy(),
        }

    def load_state_dict(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Restore what `state_dict` returned."""
        self._contacts = np.array(state["contacts"], dtype=np.float64)
        self._distance = np.array(state["distance"], dtype=np.float64)
        self._height = np.array(state["height"], dtype=np.float64)
        self.two_touched = np.array(state["two_touched"], dtype=np.bool_)
