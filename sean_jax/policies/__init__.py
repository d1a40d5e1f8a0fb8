"""Policies: who drives. Pure functions (scenario, state, key) -> (2,) command [m/s, rad/s], or drivers that remember."""

from sean_jax.base import Policy
from sean_jax.policies.expert import expert
from sean_jax.policies.go_to_goal import go_to_goal

POLICIES: dict[str, Policy] = {"go_to_goal": go_to_goal, "expert": expert}

__all__ = ["POLICIES", "expert", "go_to_goal"]
