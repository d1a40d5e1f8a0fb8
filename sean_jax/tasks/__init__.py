"""Robot tasks (section IV-E): where the robot starts and where it shall go."""

from sean_jax.tasks.ab_tasks import busy_ab_nav, random_ab_nav
from sean_jax.tasks.custom import custom, poses
from sean_jax.tasks.group_tasks import join_group, leave_group

TASKS = {
    "join_group": join_group,
    "leave_group": leave_group,
    "random_ab_nav": random_ab_nav,
    "busy_ab_nav": busy_ab_nav,
    "custom": custom,
}
"""name -> (scenario, pedestrians, groups, key) -> RobotTask"""

NEEDS_GROUPS = ("join_group", "leave_group")
"""tasks that depend on group nodes, and so on the graph behavior (section IV-E)"""

__all__ = ["NEEDS_GROUPS", "TASKS", "poses"]
