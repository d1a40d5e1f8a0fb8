"""Robot tasks (section IV-E): where the robot starts and where it shall go."""

from sean_jax.tasks.ab_tasks import busy_ab_nav, random_ab_nav
from sean_jax.tasks.custom import custom, poses
from sean_jax.tasks.group_tasks import join_group, leave_group
from sean_jax.tasks.handcrafted_task import check_room, handcrafted, pair

TASKS = {
    "join_group": join_group,
    "leave_group": leave_group,
    "random_ab_nav": random_ab_nav,
    "busy_ab_nav": busy_ab_nav,
    "custom": custom,
    "handcrafted": handcrafted,
}
"""name -> (scenario, pedestrians, groups, memory, key) -> RobotTask; the memory is the behavior's"""

NEEDS_GROUPS = ("join_group", "leave_group")
"""tasks that depend on group nodes, and so on the graph behavior (section IV-E)"""

__all__ = ["NEEDS_GROUPS", "TASKS", "check_room", "pair", "poses"]
