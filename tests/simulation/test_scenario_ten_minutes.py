"""Ten simulated minutes of each environment and behavior: nobody in an obstacle, in somebody else, or stuck (slow)."""

import pytest

import sean_jax
from sean_jax.people.behaviors import BEHAVIORS
from sean_jax.world.environment import available
from support.checkout import benchmark

BODY = 0.2  # m, of a person


@pytest.mark.night
@pytest.mark.parametrize("behavior", [name for name in BEHAVIORS if name != "playback"])
@pytest.mark.parametrize("environment", sorted(available()))
def test_people_walk_as_people_do(environment, behavior):
    scenario = sean_jax.make(environment, behavior=behavior, task="random_ab_nav", dynamics="twin")
    found = benchmark("ten_minutes").conduct(scenario, minutes=10.0)
    assert found["people"] > 0
    assert found["inside"] == 0.0 and found["clearance"] >= BODY - 1e-3
    assert found["overlaps"] <= 1e-3
    assert found["stuck"] < 1e-2
    if behavior == "random":
        assert found["grouped"] == 0.0
    if behavior == "graph":
        assert found["grouped"] > 0.0
