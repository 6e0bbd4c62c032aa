"""The plugin keeps the contract of its kind: `pytest` in this folder."""

import pytest
from icub_top_down import TopDown

from icub_testing.contracts import GraspGeneratorContract


class TestTopDown(GraspGeneratorContract):
    """Every check of grasp generators."""

    @pytest.fixture
    def make_plugin(self):
        """Build the plugin as a user would."""
        return TopDown
