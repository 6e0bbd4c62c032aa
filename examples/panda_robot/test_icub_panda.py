"""The plugin keeps the contract of its kind: `pytest` in this folder."""

import pytest
from icub_panda.robot import Panda

from icub_testing.contracts import RobotContract


class TestPanda(RobotContract):
    """Every check of robots."""

    @pytest.fixture
    def make_plugin(self):
        """Build the plugin as a user would."""
        return Panda
