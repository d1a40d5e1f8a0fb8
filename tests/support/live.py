"""Frames of two episodes side by side, for a page that shows them."""

import jax
import numpy as np
import pytest

import sean_jax
from sean_jax.policies import go_to_goal


@pytest.fixture(scope="module")
def walked():
    """A scenario, and 60 frames of two of its episodes side by side, (T, B, ...)."""
    scenario = sean_jax.make("lab", people=3, dynamics="twin", time_limit=30.0)
    roll = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, steps=60)[1])
    frames = [jax.tree.map(np.asarray, roll(jax.random.key(k))) for k in (0, 1)]
    return scenario, jax.tree.map(lambda *leaves: np.stack(leaves, 1), *frames)
