"""What the policies achieve on real physics and camera-planned poses; minutes, so only in the slow run."""

from __future__ import annotations

import pytest

import icub_core as icub
from icub_policies.demonstrations import Demonstrations
from icub_policies.gpayn import Gpayn

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["004_sugar_box", "006_mustard_bottle", "010_potted_meat_can"])
def test_demonstrations_and_base_policy_grasp_what_they_should(name):
    env = icub.make_env("grasp", objects=[name], num_envs=8, starts=12, threads=2)
    assert icub.evaluate(Demonstrations(), env, 16, seed=11).success_rate >= 0.8
    assert icub.evaluate(Gpayn(weights="base_gpayn"), env, 16, seed=11).success_rate >= 0.6
