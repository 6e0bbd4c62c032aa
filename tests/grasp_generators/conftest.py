from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def icub():
    from icub_robots.icub import ICub

    return ICub(hands=("right", "left"))
