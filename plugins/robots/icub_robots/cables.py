"""The shoulder's cables: combinations of shoulder angles that would overstretch them on the real robot."""

from __future__ import annotations

import numpy as np

_C = 1.71  # ratio of the shoulder's cable transmission
CABLE_MATRIX = np.array([[_C, -_C, 0], [_C, -_C, -_C], [0, 1, 1], [-_C, _C, _C], [0, -1, -1]])
CABLE_OFFSET = np.deg2rad([347.0, 366.57, 66.6, 112.42, 213.3])
"""The cables are slack where CABLE_MATRIX (pitch, roll, yaw) + CABLE_OFFSET > 0, rad.

Source: the joint limits that the real robot's Cartesian controller adds for the shoulder (iKin), as used in the
deployment of thesis chapter 12.
"""


def shoulder(side: str) -> tuple[str, str, str]:
    """Return the three joints that CABLE_MATRIX multiplies, of the ``"right"`` or ``"left"`` arm."""
    return f"{side[0]}_shoulder_pitch", f"{side[0]}_shoulder_roll", f"{side[0]}_shoulder_yaw"
