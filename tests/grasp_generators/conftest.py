from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # the synthetic clouds


@pytest.fixture(scope="session")
def icub():
    from icub_robots.icub import ICub

    return ICub(hands=("right", "left"))
