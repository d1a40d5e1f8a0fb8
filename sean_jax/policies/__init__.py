"""Policies, which drive the robot: functions (scenario, state, key) -> (2,) [m/s, rad/s], or ``data_types.Policy``."""

from sean_jax.core.data_types import PolicyLike
from sean_jax.policies.dwa import dwa
from sean_jax.policies.expert import expert
from sean_jax.policies.go_to_goal import go_to_goal
from sean_jax.policies.mppi import mppi
from sean_jax.policies.orca import orca
from sean_jax.policies.ros_move_base import move_base, social_costmap
from sean_jax.policies.sensing_expert import sensing_expert
from sean_jax.policies.social_force import social_force

POLICIES: dict[str, PolicyLike] = {
    "go_to_goal": go_to_goal,
    "social_costmap": social_costmap,
    "move_base": move_base,
    "orca": orca,
    "social_force": social_force,
    "dwa": dwa,
    "mppi": mppi,
    "expert": expert,
    "sensing_expert": sensing_expert,
}

__all__ = [
    "POLICIES",
    "dwa",
    "expert",
    "go_to_goal",
    "move_base",
    "mppi",
    "orca",
    "sensing_expert",
    "social_costmap",
    "social_force",
]
