"""Fault filter: discards and counts transitions with a fault of the world."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from icub_core.interfaces.world import Fault
from icub_tasks.grasping.termination import FIRST_FAULT, OF_WORLD, EndReason

POSITION_LAG = 0.03
"""Meters between the wanted and the solved hand position at which inverse kinematics has failed (released code)."""
ROTATION_LAG = 0.5
"""Radians, likewise; the released code ignores orientation, which lets the hand turn over unnoticed."""


class FaultFilter:
    """Turns faults into typed end reasons, worst first, and counts every end of an episode.

    DIFF: the thesis rewards a failed inverse kinematics with -1; here it is a truncation like every other fault, since
    a solver's failure says nothing about the value of the state (the released code gives no -1 either).
    """

    def __init__(self) -> None:
        self.ends: Counter[EndReason] = Counter()

    def inspect(
        self,
        reasons: NDArray[np.int64],
        faults: Sequence[Sequence[Fault]],
        tracking_errors: NDArray[np.float64],
        bad_actions: NDArray[np.bool_],
        readings_finite: NDArray[np.bool_],
        active: Sequence[bool] | None = None,
    ) -> NDArray[np.bool_]:
        """Overwrite the `reasons` (N,) of worlds in which something failed, in place, and count all ends.

        Args:
            reasons: End reasons of a fault-free world.
            faults: Of N worlds, what they reported.
            tracking_errors: (N, 2) position and orientation that inverse kinematics left, m and rad.
            bad_actions: (N,) the policy's action was not finite.
            readings_finite: (N,) everything that was measured is finite.
            active: Worlds that count; None for all.

        Returns:
            (N,) worlds with a fault; their transition must not be stored.
        """
        lagging = (tracking_errors[:, 0] > POSITION_LAG) | (tracking_errors[:, 1] > ROTATION_LAG)
        reasons[lagging] = EndReason.IK_FAILURE
        reasons[bad_actions] = EndReason.ACTION_NOT_FINITE
        reasons[~readings_finite] = EndReason.NOT_A_NUMBER
        for i, found in enumerate(faults):
            if found:
                reasons[i] = OF_WORLD[found[0]]
        ended = reasons != EndReason.RUNNING
        if active is not None:
            ended = ended & np.asarray(active)
        if ended.any():
            self.ends.update(EndReason(int(r)) for r in reasons[ended])
        return reasons >= FIRST_FAULT

    def report(self) -> dict[str, int]:
        """Return the number of ends by reason, lower case, such as ``"success"`` and ``"dropped_contacts"``."""
        return {reason.name.lower(): count for reason, count in sorted(self.ends.items())}
