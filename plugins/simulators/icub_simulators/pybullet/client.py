"""One Bullet server in this process, and what makes its library quiet and its absence clear."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from icub_core.errors import SimulationError


def check_installed() -> None:
    """Raise SimulationError unless the engine is installed; nothing is imported."""
    if importlib.util.find_spec("pybullet") is None:
        raise SimulationError(
            "simulator 'pybullet' needs the package pybullet, which is not installed; type: "
            "pip install 'icub-kit[pybullet]' (it is built from source on Python 3.12 and later)"
        )


def connect() -> Any:
    """Start a server; the returned client has every function of the library."""
    with silence():
        import pybullet
        from pybullet_utils.bullet_client import BulletClient

        return BulletClient(connection_mode=pybullet.DIRECT)


@contextmanager
def silence() -> Iterator[None]:
    """Send what C code prints to nowhere: the library reports every frame without mass, at the level of descriptors."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        for descriptor, target in zip(saved, (1, 2), strict=True):
            os.dup2(descriptor, target)
            os.close(descriptor)
        os.close(nowhere)
