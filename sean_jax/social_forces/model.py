"""The social force model (section IV-D [28][44][45]): accelerations, and one semi-implicit Euler step."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from sean_jax.base import Array, Groups, Nearby, Pedestrians, Robot, Scenario, State
from sean_jax.geometry import angle_between, length, rotate, sum_vectors, unit
from sean_jax.platforms import by_platform
from sean_jax.social_forces.cohesion import cohesion_forces
from sean_jax.social_forces.neighbors import MANY, Neighbors, find, sum_pairs
from sean_jax.social_forces.parameters import Parameters, felt_within
from sean_jax.social_forces.repulsion import TINY, contact, sidestep
from sean_jax.social_forces.walls import keep_out, wall_forces

ABSENT = -2  # marks who is not there where a group index is -1 for nobody's member
PARTIES = 1 << 20  # added to the number of a party where it stands among those of groups


def move(scenario: Scenario, state: State) -> Pedestrians:
    """Goals attract; people, walls, groups and the robot repel.

    People one control step later, the robot held where it was.
    """
    time_step = scenario.time_step / scenario.substeps
    nearby, radius, companions = scenario.environment.nearby, scenario.robot.radius, scenario.behavior.companions

    near = neighbors(scenario.forces, state.pedestrians, scenario.time_step)

    def substep(people: Pedestrians, _):
        after = advance(scenario.forces, people, nearby, state.groups, state.robot, time_step, radius, companions, near)
        return after, None

    return jax.lax.scan(substep, state.pedestrians, length=scenario.substeps)[0]


def advance(
    parameters: Parameters,
    people: Pedestrians,
    nearby: Nearby | None,
    groups: Groups | None,
    robot: Robot | None,
    time_step: float,
    robot_radius: float = 0.0,
    companions: Array | None = None,
    near: Neighbors | None = None,
) -> Pedestrians:
    """People ``time_step`` [s] later; ``nearby`` obstacles, ``groups`` and ``robot`` may be None.

    So may ``companions`` (N, 2) int32, the indices of those that each person walks with, -1 none; and ``near``, which
    ``neighbors`` gives for some steps: those of a large crowd are found anew if it is None.
    """
    near = neighbors(parameters, people, 0.0) if near is None else near
    px, py = people.position[:, 0], people.position[:, 1]
    vx, vy = people.velocity[:, 0], people.velocity[:, 1]
    look_x, look_y = _look(people)
    fx, fy = pair_forces(parameters, people, look_x, look_y, companions is not None, near)
    if robot is not None:
        fx, fy = _add((fx, fy), robot_force(parameters, people, look_x, look_y, robot, robot_radius))
    if groups is not None:
        fx, fy = _add((fx, fy), group_forces(parameters, people, groups))
    if nearby is not None:
        fx, fy = _add((fx, fy), wall_forces(px, py, nearby, parameters))
    fx, fy = _yield(parameters, fx, fy, people.heading)
    if companions is not None:
        fx, fy = _add((fx, fy), cohesion_forces(parameters, people, companions, look_x, look_y))
    drive_x, drive_y = (people.desired_velocity[:, 0] - vx), (people.desired_velocity[:, 1] - vy)
    vx = vx + (drive_x / parameters.relaxation_time + fx) * time_step
    vy = vy + (drive_y / parameters.relaxation_time + fy) * time_step
    speed = length(vx, vy)
    greatest = parameters.speed_ratio * people.preferred_speed
    slower = jnp.where(speed > greatest, greatest / jnp.where(speed > greatest, speed, 1.0), 1.0)
    vx, vy = vx * slower, vy * slower
    if nearby is not None:
        rub = None if parameters.friction is None else parameters.friction / parameters.body
        vx, vy = keep_out(px, py, vx, vy, nearby, parameters.radius, time_step, rub)
        vx, vy = jax.lax.optimization_barrier((vx, vy))  # XLA for a GPU would compute both twice: for x and for y
    velocity = jnp.where(people.present[:, None], jnp.stack([vx, vy], -1), 0.0)
    heading = turn(people, velocity, parameters.turn_rate * time_step)
    return replace(people, position=people.position + velocity * time_step, velocity=velocity, heading=heading)


def neighbors(parameters: Parameters, people: Pedestrians, time: float) -> Neighbors | None:
    """Those who feel one another within the next ``time`` [s]; None for a crowd so small that all pairs are quicker."""
    within = felt_within(parameters)
    if within is None or people.group.shape[0] < MANY:
        return None
    fastest = parameters.speed_ratio * jnp.max(people.preferred_speed)
    return find(people.position, people.present, within + 2.0 * fastest * time)


def pair_forces(
    parameters: Parameters,
    people: Pedestrians,
    look_x: Array,
    look_y: Array,
    parties: bool = False,
    near: Neighbors | None = None,
) -> tuple[Array, Array]:
    """(N,) x and y parts [m/s2] of what each person feels from all others: repulsion in sight, sidestep, contact.

    Standing members of one group do not push one another: their formation holds them apart (section IV-D). Nor, if
    there are ``parties``, do those who walk in one: cohesion holds them together and apart. Who stands steps aside for
    nobody. Of a large crowd those ``near`` one another may be given: pairs of others are left out.
    """

    def pair(parameters, own, other):
        (px, py, vx, vy, group, hx, hy, side), (qx, qy, wx, wy, other_group) = own, other
        dx, dy = px - qx, py - qy
        fx, fy = parameters.repulsion(dx, dy, wx, wy, vx, vy, parameters)
        weight = parameters.sight(fx, fy, dx, dy, hx, hy, parameters)
        sx, sy = sidestep(dx, dy, wx, wy, vx, vy, hx, hy, side, parameters)
        bx, by = contact(dx, dy, wx, wy, vx, vy, 2.0 * parameters.radius, parameters)
        dd = dx * dx + dy * dy
        together = (group >= 0) & (group == other_group)
        felt = (other_group > ABSENT) & (dd > 0.0) & (dd < parameters.perception * parameters.perception) & ~together
        return jnp.where(felt, weight * fx + sx + bx, 0.0), jnp.where(felt, weight * fy + sy + by, 0.0)

    group = people.group
    if parties:
        group = jnp.where((group < 0) & (people.party >= 0), PARTIES + people.party, group)
    group = jnp.where(people.present, group, ABSENT).astype(float)
    other = people.position[:, 0], people.position[:, 1], people.velocity[:, 0], people.velocity[:, 1], group
    own = *other, look_x, look_y, _side(parameters, people)
    if near is not None:
        return sum_pairs(pair, near, parameters, jnp.stack(own), jnp.stack(other))
    return _sum_over_all(pair, parameters, own, other)


def _sum_over_all(pair: Callable, parameters: Parameters, own: tuple, other: tuple) -> tuple[Array, Array]:
    """(N,) x and y: the sums over all others of the law of one pair.

    On a GPU each thread takes two others, so it reads what is one's own half as often: a fifth less time.
    """

    def in_turns(turns: int, parameters, own, other):
        nobody = (0, -len(other[0]) % turns)
        other = tuple(jnp.pad(row, nobody, constant_values=ABSENT).reshape(turns, -1) for row in other)

        def several(parameters, own, others):
            turn = lambda total, one: (_add(total, pair(parameters, own, one)), None)  # noqa: E731
            nothing = jnp.zeros_like(own[0]), jnp.zeros_like(own[0])
            return jax.lax.scan(turn, nothing, others, unroll=turns)[0]

        each = jax.vmap(jax.vmap(several, in_axes=(None, None, 1)), in_axes=(None, 0, None))
        return sum_vectors(*each(parameters, own, other), 1)

    return by_platform(partial(in_turns, 1), partial(in_turns, 2))(parameters, own, other)


def robot_force(
    parameters: Parameters, people: Pedestrians, look_x: Array, look_y: Array, robot: Robot, radius: float
) -> tuple[Array, Array]:
    """(N,) x and y parts [m/s2] of the push of a robot of that radius [m].

    A person's, shifted by the distance drawn for a moving robot [45].
    """
    wx, wy = robot.speed * robot.heading[0], robot.speed * robot.heading[1]
    moving = jnp.abs(robot.speed) > parameters.robot_moving

    def push(px, py, vx, vy, hx, hy, side, extra):
        dx, dy = px - robot.position[0], py - robot.position[1]
        fx, fy = parameters.repulsion(dx, dy, wx, wy, vx, vy, parameters)
        weight = parameters.sight(fx, fy, dx, dy, hx, hy, parameters)
        weight = weight * jnp.where(moving, jnp.exp(extra / parameters.range), 1.0)
        sx, sy = sidestep(dx, dy, wx, wy, vx, vy, hx, hy, side, parameters)
        bx, by = contact(dx, dy, wx, wy, vx, vy, parameters.radius + radius, parameters)
        return weight * fx + sx + bx, weight * fy + sy + by

    one = people.position[:, 0], people.position[:, 1], people.velocity[:, 0], people.velocity[:, 1]
    return jax.vmap(push)(*one, look_x, look_y, _side(parameters, people), people.robot_distance)


def group_forces(parameters: Parameters, people: Pedestrians, groups: Groups) -> tuple[Array, Array]:
    """(N,) x and y parts [m/s2] by which the o-spaces of groups keep out whoever is no standing member (Kendon)."""

    def push(px, py, member_of, index, center, radius, present):
        dx, dy = px - center[0], py - center[1]
        dd = dx * dx + dy * dy + TINY
        inverse = jax.lax.rsqrt(dd)
        size = parameters.group_strength * jnp.exp((radius - dd * inverse) / parameters.group_range) * inverse
        size = jnp.where(present & (member_of != index), size, 0.0)
        return size * dx, size * dy

    index = jnp.arange(groups.radius.shape[0], dtype=jnp.int32)
    each_group = jax.vmap(push, in_axes=(None, None, None, 0, 0, 0, 0))
    pushes = jax.vmap(each_group, in_axes=(0, 0, 0, None, None, None, None))(
        people.position[:, 0], people.position[:, 1], people.group, index, groups.center, groups.radius, groups.present
    )
    return sum_vectors(*pushes, 1)


def _look(people: Pedestrians) -> tuple[Array, Array]:
    """Direction in which each person looks: where they want to go, or their heading when they stand."""
    x, y = unit(people.desired_velocity[:, 0], people.desired_velocity[:, 1])
    standing = (people.group >= 0) | ((x == 0.0) & (y == 0.0))
    return jnp.where(standing, people.heading[:, 0], x), jnp.where(standing, people.heading[:, 1], y)


def _side(parameters: Parameters, people: Pedestrians) -> Array:
    """(N,) m/s2: the side preference, of which standing members of groups have none."""
    return jnp.where(people.group < 0, parameters.side_preference, 0.0)


def _yield(parameters: Parameters, fx: Array, fy: Array, heading: Array) -> tuple[Array, Array]:
    """The social force with its part against the heading scaled by ``reversing`` and that across it damped."""
    hx, hy = heading[:, 0], heading[:, 1]
    along, across = fx * hx + fy * hy, fy * hx - fx * hy
    along = jnp.where(along < 0.0, along * parameters.reversing, along)
    across = across / parameters.lateral_damping
    return along * hx - across * hy, along * hy + across * hx


def turn(people: Pedestrians, velocity: Array, most: Array) -> Array:
    """Headings turned towards the velocity by at most that angle [rad]; standing members keep theirs."""
    angle = angle_between(people.heading, velocity)
    walking = (people.group < 0) & (length(velocity[:, 0], velocity[:, 1]) > 0.1)
    angle = jnp.where(walking, jnp.clip(angle, -most, most), 0.0)
    x, y = rotate(people.heading[:, 0], people.heading[:, 1], jnp.cos(angle), jnp.sin(angle))
    return jnp.stack(unit(x, y), -1)


def _add(one: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[Array, Array]:
    return one[0] + other[0], one[1] + other[1]
