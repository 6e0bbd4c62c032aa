"""What the tests of every folder share."""

import sys
from importlib.util import find_spec

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Skip tests marked `pybullet` where the package has no wheel and is not installed."""
    if item.get_closest_marker("pybullet") and sys.version_info >= (3, 12) and find_spec("pybullet") is None:
        pytest.skip("pybullet is not installed; it has no wheel for this Python")
