"""Robot tasks (section IV-E): where the robot starts and where it shall go."""

from sean_jax.tasks.ab_tasks import busy_ab_nav, random_ab_nav
from sean_jax.tasks.custom import custom, poses
from sean_jax.tasks.group_tasks import join_group, leave_group
from sean_jax.tasks.handcrafted_task import handcrafted, pair
from sean_jax.tasks.mixture import Mixture
from sean_jax.tasks.task import build_task, check_requirement, requirement, requires

TASKS = {
    "join_group": join_group,
    "leave_group": leave_group,
    "random_ab_nav": random_ab_nav,
    "busy_ab_nav": busy_ab_nav,
    "custom": custom,
    "handcrafted": handcrafted,
}
"""name -> (scenario, pedestrians, groups, memory, key) -> RobotTask; the memory is the behavior's

A task that not every behavior can serve says so with ``requires``.
"""

__all__ = ["TASKS", "Mixture", "build_task", "check_requirement", "pair", "poses", "requirement", "requires"]
