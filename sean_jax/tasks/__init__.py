"""Robot tasks (section IV-E): start and goal of the robot."""

from sean_jax.tasks.handcrafted_task import handcrafted, pair
from sean_jax.tasks.random_tasks import busy_ab_nav, join_group, leave_group, random_ab_nav
from sean_jax.tasks.task import Mixture, build_task, check_requirement, choose, custom, poses, requirement, requires

TASKS = {
    "join_group": join_group,
    "leave_group": leave_group,
    "random_ab_nav": random_ab_nav,
    "busy_ab_nav": busy_ab_nav,
    "custom": custom,
    "handcrafted": handcrafted,
}
"""name -> (scenario, pedestrians, groups, memory, key) -> RobotTask; the memory is the behavior's

A task that does not fit every behavior is decorated with ``requires``.
"""

__all__ = ["TASKS", "Mixture", "build_task", "check_requirement", "choose", "pair", "poses", "requirement", "requires"]
