"""One Bullet server in this process, and what makes its library quiet and its absence clear."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from icub_core.errors import SimulationError


def connect() -> Any:
    """Start a server; the returned client has every function of the library.

    Raises:
        SimulationError: When the engine is not installed.
    """
    with silence():
        try:
            import pybullet
            from pybullet_utils.bullet_client import BulletClient
        except ImportError as error:
            raise SimulationError("simulator 'pybullet' needs the package pybullet: pip install pybullet") from error
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
