"""Experiments on the social forces (section IV-D): passing people, a robot, a bottleneck, walking groups.

benchmarks/forces.py prints the results, tests assert them.
"""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import social_forces
from sean_jax.core.data_types import Array, ObstacleGrid, Obstacles, Pedestrians, Robot, Scenario
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.people.behaviors.starts import WalkingGroups
from support import crowds

STEP = 0.05  # s
WALKING = 0.5  # m/s, slower is standing, as for the recordings


def walkers(position: Array, desired: Array, robot_distance: Array | float = 0.0) -> Pedestrians:
    """People at places (N, 2) [m] with desired velocities (N, 2) [m/s]."""
    number = position.shape[0]
    speed = jnp.linalg.norm(desired, axis=1)
    return Pedestrians(
        position=position,
        velocity=desired,
        heading=desired / jnp.maximum(speed, 1e-6)[:, None],
        desired_velocity=desired,
        group=jnp.full(number, -1, jnp.int32),
        walking_group=jnp.full(number, -1, jnp.int32),
        present=jnp.ones(number, bool),
        preferred_speed=speed,
        robot_distance=jnp.broadcast_to(jnp.asarray(robot_distance, jnp.float32), (number,)),
    )


def side_preference(parameters: social_forces.Forces) -> str:
    """The parameter of the passing side: of ``Evasion`` [m], or of ``Sidestep`` [m/s2]."""
    return "sidestep.preference" if parameters.get(social_forces.Evasion) is None else "evasion.side"


def right_share(parameters: social_forces.Forces, preferences, meetings: int = 1000, seed: int = 0) -> np.ndarray:
    """(P,) share of head-on meetings in which both keep to their right, for each side preference.

    Two people approach from 8 m apart on parallel lines up to 0.3 m apart on either side, with
    speeds drawn as for any crowd.
    """

    def meet(preference, key):
        offset_key, trait_key = jax.random.split(key)
        offset = jax.random.uniform(offset_key, (), jnp.float32, -0.15, 0.15)
        speed = social_forces.draw_traits(parameters, trait_key, 2)[0]
        people = walkers(
            jnp.stack([jnp.stack([jnp.float32(-4.0), offset]), jnp.stack([jnp.float32(4.0), -offset])]),
            jnp.stack([speed, jnp.zeros(2, jnp.float32)], -1) * jnp.array([[1.0], [-1.0]]),
        )
        chosen = parameters.tree_replace({side_preference(parameters): preference})

        def step(people, _):
            after = social_forces.integrate(chosen, people, None, None, None, STEP)
            return after, after.position

        x, y = jnp.moveaxis(jax.lax.scan(step, people, length=400)[1], -1, 0)
        met = jnp.argmax(x[:, 0] > x[:, 1])
        return jnp.where((x[:, 0] > x[:, 1]).any(), (y[met, 0] < y[met, 1]).astype(jnp.float32), jnp.nan)

    keys = jax.random.split(jax.random.key(seed), meetings)
    run = jax.jit(jax.vmap(jax.vmap(meet, (None, 0)), (0, None)))
    return np.asarray(run(jnp.asarray(preferences, jnp.float32), keys), float)


def robot_gaps(
    parameters: social_forces.Forces,
    distances,
    crossings: int = 200,
    robot_speed: Array | float = 0.5,
    seed: int = 0,
) -> Array:
    """(R, crossings) closest approach [m], centre to centre, of a walker to an approaching robot.

    ``distances`` (R,) [m] is the person's ``robot_distance``, or (R, crossings) for each. They start 8 m apart on
    parallel lines up to 0.5 m apart on either side.
    """

    def meet(distance, key):
        offset_key, trait_key = jax.random.split(key)
        offset = jax.random.uniform(offset_key, (), jnp.float32, -0.5, 0.5)
        speed = social_forces.draw_traits(parameters, trait_key, 1)[0]
        people = walkers(
            jnp.stack([jnp.float32(-4.0), offset])[None], jnp.stack([speed, jnp.zeros_like(speed)], -1), distance
        )
        heading = jnp.array([-1.0, 0.0])

        def step(carry, _):
            people, x = carry
            place = jnp.stack([x, jnp.zeros_like(x)])
            robot = Robot(place, heading, jnp.asarray(robot_speed, jnp.float32), jnp.float32(0.0), ())
            after = social_forces.integrate(parameters, people, None, None, robot, STEP, 0.16)
            gap = jnp.linalg.norm(after.position[0] - place)
            return (after, x - STEP * robot_speed), gap

        return jax.lax.scan(step, (people, jnp.float32(4.0)), length=240)[1].min()

    keys = jax.random.split(jax.random.key(seed), crossings)
    distances = jnp.asarray(distances, jnp.float32)
    return jax.vmap(jax.vmap(meet), (0, None))(
        jnp.broadcast_to(distances[:, None] if distances.ndim == 1 else distances, (distances.shape[0], crossings)),
        keys,
    )


def doorway(width: float, length: float = 1.0, room: float = 6.0, depth: float = 8.0) -> ObstacleGrid:
    """A room on the left of x = 0 whose only exit is a passage of this width and length [m] along y = 0."""
    side, wall = (room + 0.4 - width) / 4, 0.1
    boxes = [
        (-depth / 2, room / 2 + wall, depth / 2 + 2 * wall, wall),
        (-depth / 2, -room / 2 - wall, depth / 2 + 2 * wall, wall),
        (-depth - wall, 0.0, wall, room / 2),
        (length / 2, width / 2 + side, length / 2, side),
        (length / 2, -width / 2 - side, length / 2, side),
    ]
    rows = jnp.asarray(np.array(boxes, np.float32))
    obstacles = Obstacles(rows[:, :2], rows[:, 2:], jnp.zeros(5, jnp.float32), jnp.ones(5, jnp.float32))
    return build_obstacle_grid(obstacles, jnp.asarray([-depth, -room / 2, depth, room / 2], jnp.float32))


@functools.partial(jax.jit, static_argnames=("people", "seconds", "time_step"))
def bottleneck(
    parameters: social_forces.Forces,
    table: ObstacleGrid,
    width: Array | float,
    key: Array,
    people: int = 60,
    seconds: float = 60.0,
    time_step: float = STEP,
) -> tuple[Array, Array]:
    """(N,) time [s] at which each leaves a passage of this width [m], and (T, N) m, overlap of their bodies.

    The table is from a ``doorway``. People stand at about 2 / m2 in front of it, and walk through at speeds
    drawn as for any crowd. People who do not get through have an infinite time. The overlap is with the nearest other,
    negative if they do not touch.
    """
    place_key, trait_key = jax.random.split(key)
    columns = -(-people // 6)
    x, y = jnp.meshgrid(jnp.linspace(-0.66 * columns, -0.6, columns), jnp.linspace(-2.6, 2.6, 6), indexing="ij")
    start = jnp.stack([x.ravel(), y.ravel()], -1)[-people:].astype(jnp.float32)
    start = start + jax.random.uniform(place_key, start.shape, jnp.float32, -0.1, 0.1)
    speed = social_forces.draw_traits(parameters, trait_key, people)[0]
    crowd = walkers(start, jnp.stack([speed, jnp.zeros_like(speed)], -1))
    crowd = replace(crowd, velocity=jnp.zeros_like(start))
    half = width / 2 - parameters.walking.radius - 0.05
    itself = jnp.eye(people, dtype=jnp.float32) * 99.0

    def step(carry, tick):
        crowd, left = carry
        x, y = crowd.position[:, 0], crowd.position[:, 1]
        inside = x > 0.0
        aim_x, aim_y = jnp.where(inside, 1.0, 0.3 - x), jnp.where(inside, 0.0, jnp.clip(y, -half, half) - y)
        scale = crowd.preferred_speed / jnp.sqrt(aim_x * aim_x + aim_y * aim_y)
        crowd = replace(crowd, desired_velocity=jnp.stack([aim_x * scale, aim_y * scale], -1))
        crowd = social_forces.integrate(parameters, crowd, table, None, None, time_step)
        left = jnp.where((crowd.position[:, 0] > 1.0) & jnp.isinf(left), (tick + 1) * time_step, left)
        dx, dy = (part[:, None] - part[None, :] for part in (crowd.position[:, 0], crowd.position[:, 1]))
        nearest = (jnp.sqrt(dx * dx + dy * dy) + itself).min(1)
        return (crowd, left), 2.0 * parameters.walking.radius - nearest

    ticks = jnp.arange(round(seconds / time_step), dtype=jnp.float32)
    (_, left), overlap = jax.lax.scan(step, (crowd, jnp.full(people, jnp.inf, jnp.float32)), ticks)
    return left, overlap


def flow(left) -> float:
    """People per second from times (N,) [s], between the 20th and the 80th percentile; NaN if fewer got out."""
    times = np.sort(np.asarray(left, float))
    first, last = int(0.2 * len(times)), int(0.8 * len(times))
    return (last - first) / (times[last] - times[first]) if np.isfinite(times[last]) else float("nan")


def in_the_open(
    parameters: social_forces.Forces, size: int, number: int = 64, seconds: float = 40.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, N, 2) places and velocities and (N, 2) companions of walking groups of one size, each without other people.

    They start at random within 1.2 m of each other and walk along x; the first 10 s are left out.
    """
    table = WalkingGroups(int(size == 2), int(size == 3)).companions(size)

    def walk(key):
        place_key, trait_key = jax.random.split(key)
        place = jax.random.uniform(place_key, (size, 2), jnp.float32, -0.6, 0.6)
        speed = social_forces.draw_traits(parameters, trait_key, 1)[0]
        speed = speed - parameters.walking.companion_slowdown * (size - 1)
        people = walkers(place, jnp.stack([jnp.broadcast_to(speed, (size,)), jnp.zeros(size, jnp.float32)], -1))
        people = replace(people, walking_group=jnp.full(size, -1 if table is None else 0, jnp.int32))

        def step(people, _):
            after = social_forces.integrate(parameters, people, None, None, None, STEP, companions=table)
            return after, (after.position, after.velocity)

        return jax.lax.scan(step, people, length=round(seconds / STEP))[1]

    history = jax.jit(jax.vmap(walk))(jax.random.split(jax.random.key(seed), number))
    skip = round(10 / STEP)
    place, velocity = (np.moveaxis(np.asarray(part), 0, 1)[skip:] for part in history)
    none = np.full((size, 2), -1) if table is None else np.asarray(table)
    others = np.concatenate([np.where(none >= 0, none + k * size, -1) for k in range(number)])
    shape = (len(place), number * size, 2)
    return place.reshape(shape), velocity.reshape(shape), others


def in_scenario(
    scenario: Scenario, episodes: int = 8, seconds: float = 60.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As ``in_the_open``, of all people of a scenario, alone."""

    def walk(key):
        people, _ = crowds.walk(scenario, key, round(seconds / scenario.time_step))
        return people.position, people.velocity

    history = jax.jit(jax.vmap(walk))(jax.random.split(jax.random.key(seed), episodes))
    place, velocity = (np.moveaxis(np.asarray(part), 0, 1)[round(10 / scenario.time_step) :] for part in history)
    table, people = np.asarray(scenario.behavior.companions), scenario.people
    others = np.concatenate([np.where(table >= 0, table + k * people, -1) for k in range(episodes)])
    shape = (len(place), episodes * people, 2)
    return place.reshape(shape), velocity.reshape(shape), others


def together(place: np.ndarray, velocity: np.ndarray, others: np.ndarray) -> dict[int, dict[str, float]]:
    """Speed and spacing of walking groups of 1, 2 and 3 people while they walk, measured as in recordings.

    The mean speed [m/s]; the mean distance [m] to the nearest companion; the share of time in which it is
    beside, more than 60 degrees off the direction of motion; and in which a companion is farther than 2 m away.
    """
    speed, found = np.linalg.norm(velocity, axis=-1), {}
    for size in (1, 2, 3):
        member = np.flatnonzero((others >= 0).sum(1) == size - 1)
        walks = speed[:, member] > WALKING
        if not walks.any():
            continue
        found[size] = {"speed": float(speed[:, member][walks].mean())}
        if size == 1:
            continue
        gap = np.stack([place[:, others[member, k]] - place[:, member] for k in range(size - 1)])
        distance = np.linalg.norm(gap, axis=-1)
        nearest = np.take_along_axis(gap, distance.argmin(0)[None, ..., None], axis=0)[0]
        least = np.maximum(distance.min(0), 1e-9)
        cosine = np.abs((nearest * velocity[:, member]).sum(-1)) / (least * np.maximum(speed[:, member], 1e-9))
        found[size] |= {
            "spacing": float(least[walks].mean()),
            "beside": float((cosine < 0.5)[walks].mean()),
            "apart": float((distance.max(0) > 2.0)[walks].mean()),
        }
    return found
