"""The social force as a sum of terms (section IV-D, low level): the interface of a term, and the collection ``Forces``.

A term is a ``flax.struct.dataclass`` whose fields are its parameters. It has one or more of these methods:

- ``pair(self, pair: Pair) -> (fx, fy)``: the acceleration [m/s2] of one person by one other, written for one pair in
  scalars. All pair terms are evaluated in one fused sum over the others. With a ``RobotRepulsion`` the robot acts on
  people through the same terms.
- ``gather(self, pair: Pair) -> tuple`` and ``act(self, crowd: Crowd, *sums) -> (fx, fy)``: numbers that are summed over
  all others, including the robot, and the accelerations (N,) [m/s2] that follow from the sums. So a law can depend on
  all others together, such as on the room ahead. ``gather`` is part of the same fused sum.
- ``person(self, crowd: Crowd) -> (fx, fy) | None``: the accelerations (N,) [m/s2] of all people; None if the term does
  not apply, so that nothing is computed.

A term may also have ``limits`` (parameter -> minimum and maximum) and ``relations`` (description of a mistake -> a
function of the term that is true if the term has it). ``collect`` refuses terms that violate them.

Built-in terms and a user's terms have the same interface. docs/social_forces.md has examples.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any, ClassVar, NamedTuple, Protocol, Self, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.core import Tracer
from jaxtyping import Bool, Float, Int

from sean_jax.core import bounds, user_calls
from sean_jax.core.data_types import Array, Groups, ObstacleGrid, Pedestrians, Robot
from sean_jax.core.errors import InputError
from sean_jax.core.geometry import length, rotate, unit
from sean_jax.core.messages import shorten, suggest

Force = tuple[Array, Array]  # x and y parts of accelerations [m/s2]: of one person, or (N,) of all
T = TypeVar("T")

TINY = 1e-8  # m2: keeps lengths differentiable at zero, 1e-7 of the square of a distance of 0.3 m
MAX_EXPONENT = 20.0  # a push e^20 times the usual one is as good as any, and its square is still a number
MIN_SPEED = 0.1  # m/s: a slower body does not turn into its direction of motion
PUSHED_SPEED = 0.4  # m/s: who wants to stand and is pushed more slowly keeps the heading
STANDING_SPEED = 0.5  # m/s, desired: a faster member of a group walks to their place


@struct.dataclass
class Walking:
    """How people move. All forces have exactly one of these; it is the term that drives people."""

    limits: ClassVar[dict[str, tuple[float, float]]] = {
        "radius": (0.01, 10.0),
        "relaxation_time": (1e-3, 1e9),
        "speed_mean": (0.0, 100.0),
        "speed_deviation": (0.0, 100.0),
        "speed_min": (0.0, 100.0),
        "speed_max": (0.0, 100.0),
        "speed_ratio": (0.0, 100.0),
        "turn_rate": (0.0, 1e3),
        "perception": (0.0, 1e9),
        "lateral_damping": (1e-3, 1e6),
        "backward_scale": (0.0, 1e3),
        "acceleration": (1e-2, 1e9),
        "relaxation_deviation": (0.0, 2.0),
        "depth": (0.01, 10.0),
        "facing": (0.0, 100.0),
    }
    relations: ClassVar[dict[str, Callable[[Any], Any]]] = {
        "speed_min is more than speed_max": lambda term: term.speed_min > term.speed_max,
        "depth is more than radius": lambda term: term.depth is not None and term.depth > term.radius,
    }

    radius: Float[Array, ""]  # m, of a body; no obstacle enters it
    relaxation_time: Float[Array, ""]  # s, in which the desired velocity is taken up
    speed_mean: Float[Array, ""]  # m/s, of the preferred speeds drawn per person
    speed_deviation: Float[Array, ""]  # m/s, their standard deviation
    speed_min: Float[Array, ""]  # m/s, the draw is truncated here ...
    speed_max: Float[Array, ""]  # m/s, ... and here
    speed_ratio: Float[Array, ""]  # 1, top speed over preferred speed
    companion_slowdown: Float[Array, ""]  # m/s, by which each companion lowers the preferred speed
    turn_rate: Float[Array, ""]  # rad/s, at which a body turns into its direction of motion
    perception: Float[Array, ""]  # m, nobody and no wall farther away is felt
    lateral_damping: Float[Array, ""]  # 1, divides the part of the social force across the heading
    backward_scale: Float[Array, ""]  # 1, scales the part of the social force against the heading
    acceleration: Float[Array, ""]  # m/s2, the bound of what people do on purpose: of all but pushes of other bodies
    relaxation_deviation: Float[Array, ""] | None = None  # 1, of the logarithm of the relaxation time among people
    depth: Float[Array, ""] | None = None  # m, half the body from back to front; ``radius`` is half the shoulders
    facing: Float[Array, ""] | None = None  # 1, weight of the desired velocity in the direction into which a body turns

    def damp(
        self, fx: Float[Array, "N"], fy: Float[Array, "N"], heading: Float[Array, "N 2"]
    ) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        """The social force [m/s2] scaled by ``backward_scale`` against the heading and damped across it."""
        hx, hy = components(heading)
        along = fx * hx + fy * hy
        across = fy * hx - fx * hy
        along = jnp.where(along < 0.0, along * self.backward_scale, along)
        across = across / self.lateral_damping
        return along * hx - across * hy, along * hy + across * hx

    def relaxation(self, people: Pedestrians) -> Float[Array, ""] | Float[Array, "N"]:
        """The relaxation time [s], of each person if they differ."""
        if self.relaxation_deviation is None or people.traits is None:
            return self.relaxation_time
        return self.relaxation_time * jnp.exp(self.relaxation_deviation * people.traits.relaxation)

    def shape(
        self, look_x: Float[Array, "..."], look_y: Float[Array, "..."]
    ) -> tuple[Float[Array, "..."], Float[Array, "..."]] | None:
        """The two numbers [m] of a body with that look that ``radii`` adds up; None for a disc.

        A body is an oval that reaches ``depth`` along the look and ``radius`` across, between them by the squared sine
        of the angle. In the doubled angle that is linear, so numbers of two bodies add up.
        """
        if self.depth is None:
            return None
        half = 0.5 * (self.radius - self.depth)
        return half * (look_y * look_y - look_x * look_x), -4.0 * half * look_x * look_y

    def radii(
        self, dx: Float[Array, "..."], dy: Float[Array, "..."], shape: tuple[Array, ...] | None
    ) -> Float[Array, "..."]:
        """How far [m] two bodies reach together along the line (dx, dy) [m] between their centres.

        ``shape`` is the sum of both bodies' ``shape``.
        """
        if self.depth is None or shape is None:
            return 2.0 * self.radius
        along = dx * dx
        across = dy * dy
        inverse = jax.lax.rsqrt(along + across + TINY)
        turned = shape[0] * (along - across) + shape[1] * (dx * dy)
        return (self.radius + self.depth) + turned * (inverse * inverse)

    def bound(self, ax: Float[Array, "N"], ay: Float[Array, "N"]) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        """Accelerations [m/s2] shortened smoothly to less than ``acceleration``."""
        square = (ax * ax + ay * ay) / (self.acceleration * self.acceleration)
        scale = jax.lax.rsqrt(jnp.sqrt(1.0 + square * square))
        return ax * scale, ay * scale

    def limit_speed(
        self, vx: Float[Array, "N"], vy: Float[Array, "N"], preferred_speed: Float[Array, "N"]
    ) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
        """Velocities shortened to ``speed_ratio`` times the preferred speed [m/s]."""
        # A step of an optimizer may make a preferred speed negative: such a person stands.
        speed_max = jnp.maximum(self.speed_ratio * preferred_speed, 0.0)
        speed = length(vx, vy)
        too_fast = speed > speed_max
        divisor = jnp.where(too_fast, speed, 1.0)
        slower = jnp.where(too_fast, speed_max / divisor, 1.0)
        return vx * slower, vy * slower


def components(vectors: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """The x and the y of vectors, in which laws are written."""
    return vectors[..., 0], vectors[..., 1]


def is_standing(people: Pedestrians) -> Bool[Array, "N"]:
    """(N,) whether people stand in a group; members who walk to their place do not stand yet."""
    square = (people.desired_velocity * people.desired_velocity).sum(-1)
    return (people.group >= 0) & (square < STANDING_SPEED * STANDING_SPEED)


def look_direction(people: Pedestrians) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """The look of each person, a unit vector: along the desired velocity, or along the heading when they stand."""
    x, y = unit(*components(people.desired_velocity))
    heading_x, heading_y = components(people.heading)
    standing = is_standing(people) | ((x == 0.0) & (y == 0.0))
    look_x = jnp.where(standing, heading_x, x)
    look_y = jnp.where(standing, heading_y, y)
    return look_x, look_y


def turn(
    people: Pedestrians,
    velocity: Float[Array, "N 2"],
    max_angle: Float[Array, ""] | float,
    min_speed: float = MIN_SPEED,
) -> Float[Array, "N 2"]:
    """Headings turned towards the velocity [m/s] by ``max_angle`` [rad] at most.

    Standing group members keep theirs, and so do people who are slower than ``min_speed`` [m/s].
    """
    cosine, sine = _turn_by(people.heading, velocity, max_angle)
    speed = length(*components(velocity))
    walking = ~is_standing(people) & (speed > min_speed)
    cosine = jnp.where(walking, cosine, 1.0)
    sine = jnp.where(walking, sine, 0.0)
    x, y = rotate(*components(people.heading), cosine, sine)
    return jnp.stack(unit(x, y), -1)


def turn_heading(
    heading: Float[Array, "N 2"], goal: Float[Array, "N 2"], max_angle: Float[Array, ""] | float
) -> Float[Array, "N 2"]:
    """Headings turned towards other directions by ``max_angle`` [rad] at most."""
    cosine, sine = _turn_by(heading, goal, max_angle)
    x, y = rotate(*components(heading), cosine, sine)
    return jnp.stack(unit(x, y), -1)


def _turn_by(
    heading: Float[Array, "N 2"], goal: Float[Array, "N 2"], max_angle: Float[Array, ""] | float
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Cosine and sine of the angle from headings to other directions, bounded by ``max_angle`` [rad]."""
    x, y = components(heading)
    goal_x, goal_y = unit(*components(goal))

    # Of the angle between both, without trigonometry.
    cosine = x * goal_x + y * goal_y
    sine = x * goal_y - y * goal_x
    max_angle = jnp.minimum(max_angle, jnp.pi)
    within = cosine >= jnp.cos(max_angle)
    cosine = jnp.where(within, cosine, jnp.cos(max_angle))
    bounded = jnp.where(sine < 0.0, -jnp.sin(max_angle), jnp.sin(max_angle))
    sine = jnp.where(within, sine, bounded)
    return cosine, sine


class Pair(NamedTuple):
    """A person and another body that acts on it: a person or the robot. Every array is a scalar."""

    dx: Float[Array, "..."]  # m, from the other to the person
    dy: Float[Array, "..."]
    wx: Float[Array, "..."]  # m/s, velocity of the other
    wy: Float[Array, "..."]
    vx: Float[Array, "..."]  # m/s, velocity of the person
    vy: Float[Array, "..."]
    look_x: Float[Array, "..."]  # unit vector, the direction in which the person looks
    look_y: Float[Array, "..."]
    radii: Float[Array, "..."]  # m, sum of the radii of both
    standing: Bool[Array, "..."] | bool = False  # the person is a standing member of a group
    is_robot: bool = False  # the other is the robot; known when the program is traced
    repulsion_scale: Float[Array, "..."] | None = None  # 1, drawn factor of a moving robot's push; None for a person
    width: Float[Array, "..."] | float = 1.0  # 1, the person's factor of the width of ``Evasion``
    side: Float[Array, "..."] | float = 0.0  # m, added to its side
    alertness: Float[Array, "..."] | float = 1.0  # 1, the person's factor of its horizon


class Crowd(NamedTuple):
    """All people at one moment, and their surroundings; of several robots a term gets one at a time."""

    forces: "Forces"  # all terms, with their parameters
    people: Pedestrians
    look_x: Float[Array, "N"]  # unit vectors, the directions in which people look
    look_y: Float[Array, "N"]
    obstacle_grid: ObstacleGrid | None
    groups: Groups | None
    robot: Robot | None
    robot_radius: Float[Array, "*M"] | float  # m
    companions: Int[Array, "N 2"] | None  # indices of each person's companions, -1 none


@runtime_checkable
class PairTerm(Protocol):
    """A term that acts between two people.

    It may also have ``cutoff(walking) -> () m``, the distance beyond which it is negligible. Pairs beyond the largest
    cutoff are left out, if every term has one.
    """

    def pair(self, pair: Pair) -> Force:
        """The acceleration [m/s2] of one person by one other, in scalars."""
        ...


@runtime_checkable
class GatherTerm(Protocol):
    """A term that sums numbers over all others before it acts. It may have a ``cutoff``, as a ``PairTerm``."""

    def gather(self, pair: Pair) -> tuple[Array, ...]:
        """The contribution of one other to the sums: scalars of any unit."""
        ...

    act: Callable[..., Force]
    """``act(crowd, *sums)``: the accelerations (N,) [m/s2] of all people, from the sums (N,) of ``gather``."""


@runtime_checkable
class PersonTerm(Protocol):
    """A term that acts on each person.

    Its result is subject to ``Walking.damp``, unless the class has ``damped = False``.
    """

    def person(self, crowd: Crowd) -> Force | None:
        """The accelerations (N,) [m/s2] of all people; None if the term does not apply."""
        ...


Term = Walking | PairTerm | GatherTerm | PersonTerm


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False)
class Forces:
    """The terms whose sum moves people; a pytree. ``build`` makes checked forces from a name or a list.

    Iteration gives the terms. Each term is an attribute, named like its class in lower case:
    ``scenario.forces.repulsion.strength``, ``scenario.forces.robot_repulsion``.
    """

    terms: tuple[Term, ...]

    def __iter__(self) -> Iterator[Term]:
        return iter(self.terms)

    def __len__(self) -> int:
        return len(self.terms)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "terms":
            raise AttributeError(name)
        for term in self.terms:
            if term_name(term) == name:
                return term
        names = [term_name(term) for term in self.terms]
        raise AttributeError(f"forces: there is no term '{name}' among {', '.join(names)}{suggest(name, names)}")

    @property
    def walking(self) -> Walking:
        """How people move: the one ``Walking`` term."""
        term = self.get(Walking)
        if term is None:
            raise AttributeError("forces: there is no Walking term.")
        return term

    @property
    def pair_terms(self) -> tuple[PairTerm, ...]:
        """The terms that act between two people, in their order."""
        return tuple(term for term in self.terms if isinstance(term, PairTerm))

    @property
    def gather_terms(self) -> tuple[GatherTerm, ...]:
        """The terms that sum numbers over all others before they act, in their order."""
        return tuple(term for term in self.terms if isinstance(term, GatherTerm))

    @property
    def person_terms(self) -> tuple[PersonTerm, ...]:
        """The terms that act on each person, in their order."""
        return tuple(term for term in self.terms if isinstance(term, PersonTerm))

    def get(self, kind: type[T]) -> T | None:
        """The term of a class such as ``Contact``; None if there is none."""
        return next((term for term in self.terms if isinstance(term, kind)), None)

    def replace(self, **terms: Term) -> Self:
        """These forces with other terms by name: ``replace(repulsion=forces.repulsion.replace(strength=...))``.

        Raises:
            AttributeError: there is no term of that name.
        """
        for name in terms:
            getattr(self, name)
        return type(self)(tuple(terms.get(term_name(term), term) for term in self.terms))

    def tree_replace(self, values: dict[str, Any]) -> Self:
        """These forces with other parameters, such as ``{"repulsion.strength": 8.0, "contact.friction": None}``.

        Raises:
            AttributeError: there is no term of that name.
            InputError: the term has no parameter of that name.
        """
        changes: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            name, _, field = path.partition(".")
            fields = [known.name for known in dataclasses.fields(getattr(self, name))]
            if field not in fields:
                raise InputError(f"forces.{path}: '{name}' has no such parameter{suggest(field, fields)}")
            if isinstance(value, (int, float, np.ndarray, np.generic)) and not isinstance(value, bool):
                value = np.asarray(value, float)
            changes.setdefault(name, {})[field] = value
        terms = {name: dataclasses.replace(getattr(self, name), **fields) for name, fields in changes.items()}
        return self.replace(**terms)

    def tree_flatten_with_keys(self) -> tuple[list, None]:
        """Terms as children, each keyed by its name; part of being a pytree."""
        return [(jax.tree_util.GetAttrKey(term_name(term)), term) for term in self.terms], None

    @classmethod
    def tree_unflatten(cls, _: None, terms: Iterable) -> Self:
        """The inverse of ``tree_flatten_with_keys``."""
        return cls(tuple(terms))


def term_name(term: object) -> str:
    """The name of a term among the forces: its class in lower case, such as ``robot_repulsion``."""
    return class_name(type(term))


def class_name(kind: type) -> str:
    """The name of terms of a class."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def sum_pair_terms(terms: tuple[PairTerm, ...], pair: Pair) -> Force:
    """The acceleration [m/s2] of one person by one other: the sum of one or more pair terms, in their order."""
    fx, fy = force_of(terms[0].pair, "pair", pair)
    for term in terms[1:]:
        gx, gy = force_of(term.pair, "pair", pair)
        fx = fx + gx
        fy = fy + gy
    return fx, fy


def over_robots(crowd: Crowd, law: Callable[[Crowd], Any]) -> Any:
    """``law(crowd)``; of several robots (M, ...) with radii (M,), the sum of the law with each."""
    if crowd.robot is None or crowd.robot.position.ndim == 1:
        return law(crowd)

    def with_one(robot: Robot, radius: Array | float) -> Any:
        return law(crowd._replace(robot=robot, robot_radius=radius))

    results = jax.vmap(with_one)(crowd.robot, crowd.robot_radius)
    return jax.tree.map(lambda leaf: leaf.sum(0), results)


def gather(terms: tuple[GatherTerm, ...], pair: Pair) -> tuple[tuple[Array, ...], ...]:
    """The contributions of one other to the sums of the gather terms: a tuple of scalars for each term."""
    return tuple(tuple(user_calls.call("forces", term.gather, "pair", pair)) for term in terms)


def force_of(law: Callable, arguments: str, *values: Any, optional: bool = False) -> Any:
    """The force [m/s2] that a method of a term returns, or None if that is allowed.

    Raises:
        PartError: a user's term raised an error, or returned something else.
    """
    value = user_calls.call("forces", law, arguments, *values)
    if value is None and optional:
        return None
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise user_calls.wrong("forces", law, user_calls.describe(value), "(fx, fy)", "give both parts, in m/s2")
    for part in value:
        user_calls.check_array("forces", law, part, None, None, "give numbers, in m/s2")
    return value[0], value[1]


def collect(terms: Iterable[Term]) -> Forces:
    """Forces from terms, which are added up in this order. Parameters become float arrays on the default device.

    Raises:
        InputError: this is not a collection of terms, a name occurs twice, there is no ``Walking``, or a parameter is
            not finite or violates the limits of its term.
    """
    if isinstance(terms, PairTerm | GatherTerm | PersonTerm) or not isinstance(terms, Iterable):
        raise InputError(
            f"forces: {shorten(repr(terms))} must be the name of a preset or a list of terms, such as "
            "[*preset('helbing1995'), term]."
        )
    terms = tuple(terms)
    for term in terms:
        if isinstance(term, type) or not isinstance(term, Term):
            text = shorten(repr(term))
            raise InputError(f"forces: {text} is no term; a term has a method 'pair', 'gather' or 'person'.")
        if not dataclasses.is_dataclass(term) or any(leaf is term for leaf in jax.tree.leaves(term)):
            raise InputError(f"forces: {type(term).__name__} must be a flax.struct.dataclass.")
    names = [term_name(term) for term in terms]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"forces: the term '{name}' stands twice; give one, or a class of another name for the second."
            )
    if "walking" not in names:
        raise InputError("forces: there is no Walking term, which drives people; begin with [*preset('helbing1995')].")
    for name, term in zip(names, terms, strict=True):
        bounds.check_leaves(f"forces.{name}", term)
        _check_limits(name, term)
    return jax.tree.map(_parameter, Forces(terms))


def _check_limits(name: str, term: Term) -> None:
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(term)):
        return
    term = jax.tree.map(np.asarray, term)  # nothing is compiled
    for field, (low, high) in getattr(term, "limits", {}).items():
        value = getattr(term, field)
        if value is not None and not ((low <= value) & (value <= high)).all():
            raise InputError(f"forces.{name}.{field}: {value} must be from {low:,g} to {high:,g}.")
    for mistake, has_mistake in getattr(term, "relations", {}).items():
        if np.any(has_mistake(term)):
            raise InputError(f"forces.{name}: {mistake}; change one of the two.")


def _parameter(leaf: Any) -> Array:
    if isinstance(leaf, jax.Array):
        return leaf.astype(float)
    return jax.device_put(np.asarray(leaf, float))
