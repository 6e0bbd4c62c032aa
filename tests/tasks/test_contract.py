"""The grasping task keeps the contract of tasks in each of its forms, with a claw in a world without dynamics."""

import pytest

from icub_testing.contracts import TaskContract
from icub_testing.fakes import with_tiny_dependencies


class TestTwoWorlds(TaskContract):
    options = {"num_envs": 2}

    @pytest.fixture
    def make_plugin(self):
        return with_tiny_dependencies("task", "grasp", self.options)


class TestKeptStartsAndThreads(TestTwoWorlds):
    options = {"num_envs": 3, "starts": 2, "threads": 2}


class TestSignalsOfTheHand(TestTwoWorlds):
    options = {"num_envs": 2, "signals": "hand"}


class TestImages(TestTwoWorlds):
    options = {"num_envs": 2, "visual": True, "width": 32, "height": 24}
