"""The five social situations, equations (1)-(5) of section III-A, for a robot among people.

Each equation is about one agent; a situation occurs when it holds for any of them. A situation is a function
``(snapshot, thresholds) -> () bool`` of a ``sean_jax.Snapshot`` and ``Thresholds``. It reads arrays only, so it works
for recordings as well. A user's situation may omit thresholds: ``as_situation`` takes ``snapshot -> () bool``, too.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float

from sean_jax.classifiers.predicates import (
    any_person,
    member,
    near,
    parallel_trajectory,
    perpendicular_trajectory,
    walking,
)
from sean_jax.core import user_calls
from sean_jax.core.data_types import Array, Pedestrians, Snapshot
from sean_jax.core.devices import parameter
from sean_jax.core.errors import InputError


@struct.dataclass
class Thresholds:
    """Constants of the predicates (section V-B), and of the situations beyond the paper's five."""

    near: Float[Array, ""] = parameter(2.4)  # m, D: twice the personal distance of Hall
    walking: Float[Array, ""] = parameter(1.4)  # m/s, V
    angle: Float[Array, ""] = parameter(np.pi / 12)  # rad, A
    arrival: Float[Array, ""] = parameter(0.2)  # m, within which x_r = x'_r of equation (3) holds; ours
    reach: Float[Array, ""] = parameter(3.6)  # m, at which an encounter begins: where Hall's social distance ends
    personal: Float[Array, ""] = parameter(1.2)  # m, Hall's personal distance: passing within it is passing close
    moving: Float[Array, ""] = parameter(0.1)  # m/s, slower agents stand, in the situations beyond the five; ours
    gaining: Float[Array, ""] = parameter(0.2)  # m/s, difference in speed of overtaking, below it of following; ours
    crowd: Float[Array, ""] = parameter(0.31)  # 1/m2, of people: where Fruin's best level of service for walkways ends
    hides: Float[Array, ""] = parameter(1.0)  # m, height of an obstacle that people and robots cannot look over; ours
    engaged: Float[Array, ""] = parameter(2.4)  # m, from a person to the object of their activity; ours
    imminent: Float[Array, ""] = parameter(3.0)  # s, time to collision within which people react: Karamouzas et al.
    hurry: Float[Array, ""] = parameter(1.86)  # m/s, faster people hurry: Weidmann's mean and two standard deviations


RESERVED = ("overall", "none")  # other rows of tables
Situation = Callable[[Snapshot, Thresholds], Array]  # (snapshot, thresholds) -> () bool


def thresholds(**values: Any) -> Thresholds:
    """The paper's thresholds, D = 2.4 m, V = 1.4 m/s, A = 15 degrees (section V-B), and other thresholds.

    They are arrays, which can be swept.

    Args:
        values: fields of ``Thresholds`` that differ: numbers or () arrays in its units.
    """
    return jax.tree.map(lambda value: jnp.asarray(value, float), Thresholds(**values))


def cross_path(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (1): near a walking agent with an orientation perpendicular to the robot's."""

    def holds(agent: Pedestrians) -> Array:
        return (
            near(snapshot.position, agent.position, thresholds.near)
            & walking(agent.velocity, thresholds.walking)
            & perpendicular_trajectory(snapshot.heading, agent.heading, thresholds.angle)
        )

    return any_person(snapshot, holds)


def down_path(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (2): near an agent with an orientation parallel to the robot's. As printed: it need not walk."""

    def holds(agent: Pedestrians) -> Array:
        return near(snapshot.position, agent.position, thresholds.near) & parallel_trajectory(
            snapshot.heading, agent.heading, thresholds.angle
        )

    return any_person(snapshot, holds)


def join_group(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (3): near a member of the group that the goal belongs to, and not yet at the goal."""

    def holds(agent: Pedestrians) -> Array:
        return near(snapshot.position, agent.position, thresholds.near) & member(agent.group, snapshot.goal_group)

    return any_person(snapshot, holds) & ~near(snapshot.position, snapshot.goal, thresholds.arrival)


def leave_group(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (4): near a member of the group that the start belongs to."""

    def holds(agent: Pedestrians) -> Array:
        return near(snapshot.position, agent.position, thresholds.near) & member(agent.group, snapshot.start_group)

    return any_person(snapshot, holds)


def empty(snapshot: Snapshot, thresholds: Thresholds) -> Bool[Array, ""]:
    """Equation (5): no agent is near."""

    def holds(agent: Pedestrians) -> Array:
        return near(snapshot.position, agent.position, thresholds.near)

    return ~any_person(snapshot, holds)


SITUATIONS: dict[str, Situation] = {
    "cross_path": cross_path,
    "down_path": down_path,
    "join_group": join_group,
    "leave_group": leave_group,
    "empty": empty,
}
"""The paper's five: name -> (snapshot, thresholds) -> () bool"""

PAPER = tuple(SITUATIONS.items())


def classify(
    snapshot: Snapshot, thresholds: Thresholds, situations: tuple[tuple[str, Situation], ...] = PAPER
) -> Bool[Array, " S"]:
    """Whether each of S situations, by default the paper's five, occurs at a snapshot."""
    return jnp.stack([holds(snapshot, thresholds) for _, holds in situations])


def as_situation(value: Callable, name: str = "") -> Situation:
    """A user's function ``(snapshot, thresholds) -> () bool`` or ``snapshot -> () bool`` as a situation.

    The result checks the function's values while the program is traced. The package's own situations are returned
    unchanged. Equal arguments give equal results, so nothing is compiled again.

    Raises:
        InputError: it is not such a function, or results use the name.
    """
    if name in RESERVED:
        raise InputError(f"situations: '{name}' means something else in results; choose another name.")
    if isinstance(value, _Situation) or str(getattr(value, "__module__", "")).startswith("sean_jax.classifiers."):
        return value
    try:
        parameters = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):  # not callable, or a builtin without a signature
        parameters = ()
    number = sum(parameter.default is parameter.empty for parameter in parameters)
    if number not in (1, 2):
        raise InputError(
            f"situations: {name or 'a situation'} is {value!r}; give a function (snapshot, thresholds) -> bool or "
            "snapshot -> bool."
        )
    return _Situation(value, name or getattr(value, "__name__", repr(value)), number == 2)


@dataclass(frozen=True)
class _Situation:
    """A user's function as a situation; equal ones are equal, as static fields of a scenario must be."""

    function: Callable
    name: str
    with_thresholds: bool

    def __call__(self, snapshot: Snapshot, thresholds: Thresholds) -> Array:
        names = "snapshot, thresholds" if self.with_thresholds else "snapshot"
        arguments = (snapshot, thresholds) if self.with_thresholds else (snapshot,)
        value = user_calls.call("situations", self.function, names, *arguments)
        cure = "compare numbers, and reduce over people with any"
        user_calls.check_array("situations", self.function, value, bool, (), cure)
        return jnp.asarray(value)
