"""Where the files of icub-models are: the installed package, or another installation that the environment names."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Literal, get_args

from icub_core.errors import ConfigError, DataError, unknown_name

Model = Literal["iCubGazeboV2_7", "iCubGazeboV2_5_visuomanip"]
MODELS: tuple[Model, ...] = get_args(Model)
BODY_MODEL, HAND_MODEL = MODELS
SEARCH_VARIABLES = ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "ROS_PACKAGE_PATH", "YARP_DATA_DIRS")
"""Variables that installations of icub-models set; their entries end in share, share/iCub or share/iCub/robots."""


def model_file(name: str) -> Path:
    """Return the URDF of a model of icub-models.

    Raises:
        ConfigError: Unknown name.
        DataError: That model is not installed.
    """
    if name not in MODELS:
        raise ConfigError(unknown_name("model of icub-models", name, MODELS))
    variables = tuple(os.environ.get(variable, "") for variable in SEARCH_VARIABLES)
    found = _packaged(name) or _searched(name, variables)
    if found is None:
        raise DataError(
            f"model '{name}' is not installed; expected icub-models 3.0 or newer"
            + (", built from its sources, in GAZEBO_MODEL_PATH" if name == HAND_MODEL else "")
        )
    return found


@cache
def _packaged(name: str) -> Path | None:
    import icub_models

    try:
        return Path(icub_models.get_model_file(name)).resolve()
    except Exception:  # the package raises bare exceptions for a model that it does not have
        return None


@cache
def _searched(name: str, variables: tuple[str, ...]) -> Path | None:
    for entry in (entry for variable in variables for entry in variable.split(os.pathsep) if entry):
        for middle in ("", "robots", "iCub/robots"):
            path = Path(entry) / middle / name / "model.urdf"
            if path.is_file():
                return path.resolve()
    return None


def resolve_mesh(uri: str, model: Path) -> Path:
    """Return the file of a ``package://iCub/`` address in `model`; DataError names a missing one."""
    share = model.parents[2]  # .../share/iCub/robots/<model>/model.urdf; package://iCub is .../share/iCub
    path = share / uri.removeprefix("package://iCub/")
    if not path.is_file():
        raise DataError(f"mesh {path} of {model} is missing; expected a complete icub-models installation")
    return path
