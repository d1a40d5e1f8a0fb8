"""Policies: who drives. Pure functions (scenario, state, key) -> (2,) command [m/s, rad/s]."""

from sean_jax.base import Policy
from sean_jax.policies.go_to_goal import go_to_goal

POLICIES: dict[str, Policy] = {"go_to_goal": go_to_goal}

__all__ = ["POLICIES", "go_to_goal"]
