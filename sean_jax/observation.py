"""What a robot's policy sees (section IV-F; poses of people and the plan, as SEAN 2.0 publishes them)."""

from flax import struct

from sean_jax.base import Array


@struct.dataclass
class Observation:
    """In the robot's frame: x ahead, y to the left, the robot at the origin."""

    goal: Array  # (2,) m
    goal_heading: Array  # (2,) unit vector
    path: Array  # (2,) m, where the shortest path bends next, or the goal
    speed: Array  # () m/s
    turn_rate: Array  # () rad/s
    people: Array  # (N, 2) m
    people_velocity: Array  # (N, 2) m/s, over the ground
    people_present: Array  # (N,) bool
    situations: Array  # (S,) bool
