"""The five situations as in SEAN 2.0's code, which differs from the equations of section III-A.

All five differ from the paper in three ways:
- Directions are directions of motion. SEAN fits a line to an agent's last 30 poses and takes the vector along it; for a
  standing robot it takes the forward axis. Here the velocity is that vector.
- SEAN classifies once a second. Here the caller chooses the rate.
- SEAN's distances are to colliders. Ours are to centres, as in the paper.
"""

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from sean_jax.classifiers.predicates import any_person, cosine, near, walking
from sean_jax.classifiers.situations import Situation, Thresholds, empty, thresholds
from sean_jax.core.data_types import Array, Pedestrians, Snapshot

STILL = 0.02  # m/s: SEAN's 0.01 m within the half second that its 30 poses span


def sean2_thresholds() -> Thresholds:
    """The paper's thresholds but V = 0.4 m/s: SEAN's pedestrians, at most 0.6 m/s fast, never reach 1.4 m/s."""
    return thresholds(walking=0.4)


def cross_path(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (1) on directions of motion instead of orientations; the limits of the angle are not included."""
    direction = robot_direction(snapshot)

    def holds(agent: Pedestrians) -> Array:
        across = jnp.abs(cosine(direction, agent.velocity)) < jnp.sin(thresholds.angle)
        return _nearby_walker(snapshot, agent, thresholds) & across

    return any_person(snapshot, holds)


def down_path(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (2), but the agent must walk, and the opposite direction counts as well."""
    direction = robot_direction(snapshot)

    def holds(agent: Pedestrians) -> Array:
        between = cosine(direction, agent.velocity)
        # -2 means no direction, which must not count as the opposite one.
        along = (between >= -1.5) & (jnp.abs(between) > jnp.cos(thresholds.angle))
        return _nearby_walker(snapshot, agent, thresholds) & along

    return any_person(snapshot, holds)


def join_group(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (3), but for any agent near, member or not, and the robot must be within D of its goal, or at it."""
    return _at_group(snapshot, snapshot.goal_group, snapshot.goal, thresholds)


def leave_group(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (4), but for any agent near, member or not, and the robot must still be within D of its start."""
    return _at_group(snapshot, snapshot.start_group, snapshot.start, thresholds)


def robot_direction(snapshot: Snapshot) -> Float[Array, "2"]:
    """The robot's direction: its velocity [m/s], or its unit heading if it stands."""
    moves = (snapshot.velocity * snapshot.velocity).sum() >= STILL * STILL
    return jnp.where(moves, snapshot.velocity, snapshot.heading)


def _at_group(
    snapshot: Snapshot, group: Int[Array, ""], place: Float[Array, "2"], thresholds: Thresholds
) -> Bool[Array, ""]:
    """Somebody is near, and the robot is near a place [m] that belongs to a group."""
    return ~empty(snapshot, thresholds) & (group >= 0) & near(snapshot.position, place, thresholds.near)


def _nearby_walker(snapshot: Snapshot, agent: Pedestrians, thresholds: Thresholds) -> Bool[Array, ""]:
    return near(snapshot.position, agent.position, thresholds.near) & walking(agent.velocity, thresholds.walking)


SEAN2_SITUATIONS: dict[str, Situation] = {
    "cross_path": cross_path,
    "down_path": down_path,
    "join_group": join_group,
    "leave_group": leave_group,
    "empty": empty,
}
