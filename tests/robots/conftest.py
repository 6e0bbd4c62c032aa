"""One robot for the whole folder: building one takes a few hundredths of a second."""

import pytest

from icub_robots.icub import ICub


@pytest.fixture(scope="session")
def icub() -> ICub:
    return ICub()


@pytest.fixture(scope="session")
def both_hands() -> ICub:
    return ICub(hands=("right", "left"))
