"""How an episode ends (thesis 12.3.1), and which ends are the world's fault instead of the policy's."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from icub_core.interfaces.world import Fault
from icub_tasks.grasping.spaces import FINGERTIPS_OF_A_GRASP


class EndReason(IntEnum):
    """Why an episode ended; 0 while it runs."""

    RUNNING = 0
    SUCCESS = 1
    MOVED = 2
    TIME_LIMIT = 3
    IK_FAILURE = 4
    ACTION_NOT_FINITE = 5
    HIDDEN_RESET = 6
    NOT_A_NUMBER = 7
    DROPPED_CONTACTS = 8
    EXPLODING_VELOCITY = 9
    WORKER_LOST = 10
    STALE_DATA = 11
    HARDWARE = 12


FIRST_FAULT = EndReason.IK_FAILURE
"""Reasons from here on are faults: truncations whose transition is never learned from."""

OF_WORLD = {
    Fault.HIDDEN_RESET: EndReason.HIDDEN_RESET,
    Fault.NOT_A_NUMBER: EndReason.NOT_A_NUMBER,
    Fault.DROPPED_CONTACTS: EndReason.DROPPED_CONTACTS,
    Fault.EXPLODING_VELOCITY: EndReason.EXPLODING_VELOCITY,
    Fault.STALE_DATA: EndReason.STALE_DATA,
    Fault.HARDWARE: EndReason.HARDWARE,
}


def end_reasons(
    displacement: NDArray[np.float64],
    contacts: NDArray[np.float64],
    steps: NDArray[np.int64],
    *,
    lift: float,
    moved: float,
    fallen: float,
    max_steps: int,
) -> NDArray[np.int64]:
    """Return the reasons (N,) of worlds without a fault.

    Success needs the object `lift` meters up and at least two fingertips on it ("grasped and uplifted"); the released
    code asks for the height only. An object has "moved too far" when it went more than `moved` meters sideways before
    it was lifted that far, or its center sank by `fallen` meters because it toppled or left the table; the released
    code tests the height alone.

    Args:
        displacement: (N, 3) object center now minus at the start, meters.
        contacts: (N,) fingertips in contact.
        steps: (N,) steps done in the episode.
        lift: Rise that counts as lifted, meters.
        moved: Sideways motion that is too far, meters.
        fallen: Sinking that counts as toppled or fallen, meters.
        max_steps: Time limit.
    """
    reasons = np.where(steps >= max_steps, int(EndReason.TIME_LIMIT), int(EndReason.RUNNING))
    sideways = np.hypot(displacement[:, 0], displacement[:, 1])
    reasons[(sideways > moved) | (displacement[:, 2] < -fallen)] = EndReason.MOVED
    reasons[(displacement[:, 2] >= lift) & (contacts >= FINGERTIPS_OF_A_GRASP)] = EndReason.SUCCESS
    return reasons
