"""The social force model (section IV-D [28][44][45]): the sum of its terms, integrated by semi-implicit Euler steps."""

from collections.abc import Iterable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Float, Int

from sean_jax.base import Array, Groups, ObstacleGrid, Pedestrians, Robot, Scenario, State
from sean_jax.social_forces.forces import (
    Crowd,
    Force,
    Forces,
    Pair,
    PersonTerm,
    force_of,
    gather,
    look_direction,
    sum_pair_terms,
    turn,
)
from sean_jax.social_forces.neighbors import ABSENT, MIN_PEOPLE, Neighbors, find, sum_pairs
from sean_jax.social_forces.terms import Cohesion, Repulsion, RobotRepulsion
from sean_jax.social_forces.walls import Contact, project_velocity

SUMS = "pair sums"  # reverse mode stores these of a step, and the state; the rest is recomputed
ALONE = -2  # group of a person in none, on whom forces act; the other of a pair has -1, so the two differ
WALKING_GROUPS = 1 << 20  # added to the number of a walking group, to distinguish it from a standing group


def draw_traits(forces: Forces, key: Array, people: int) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Traits of people: preferred speeds [m/s], normal and truncated, and extra distances [m] from a moving robot.

    A uniformly drawn factor f of the robot's repulsion A exp(-b / B) is a distance of B ln(f) [45]. ``Walking`` and
    ``RobotRepulsion`` have the parameters of both distributions.
    """
    walking, robot, repulsion = forces.walking, forces.get(RobotRepulsion), forces.get(Repulsion)
    speed_key, robot_key = jax.random.split(key)
    deviation = jnp.maximum(walking.speed_deviation, 1e-6)
    lower = jnp.minimum((walking.speed_min - walking.speed_mean) / deviation, -1e-3)
    upper = jnp.maximum((walking.speed_max - walking.speed_mean) / deviation, 1e-3)
    normal = jax.random.truncated_normal(speed_key, lower, upper, (people,), float)
    speed = walking.speed_mean + walking.speed_deviation * normal
    if robot is None or repulsion is None:
        return speed, jnp.zeros(people, float)
    factor = jax.random.uniform(robot_key, (people,), float, robot.factor_min, robot.factor_max)
    return speed, repulsion.range * jnp.log(factor)


def move(scenario: Scenario, state: State) -> Pedestrians:
    """People one control step later, in ``scenario.substeps`` steps of the social forces; the robot stays in place."""
    time_step = scenario.time_step / scenario.substeps
    grid, radius, companions = scenario.environment.obstacle_grid, scenario.robot.radius, scenario.behavior.companions
    near = neighbors(scenario.forces, state.pedestrians, scenario.time_step)

    def substep(people: Pedestrians, _):
        after = integrate(scenario.forces, people, grid, state.groups, state.robot, time_step, radius, companions, near)
        return after, None

    keep = jax.checkpoint_policies.save_only_these_names(SUMS)
    substep = jax.checkpoint(substep, prevent_cse=False, policy=keep)
    return jax.lax.scan(substep, state.pedestrians, length=scenario.substeps)[0]


def integrate(
    forces: Forces,
    people: Pedestrians,
    obstacle_grid: ObstacleGrid | None,
    groups: Groups | None,
    robot: Robot | None,
    time_step: Float[Array, ""] | float,
    robot_radius: float = 0.0,
    companions: Int[Array, "N 2"] | None = None,
    near: Neighbors | None = None,
) -> Pedestrians:
    """People one step of the social forces later.

    Args:
        groups: people avoid their o-spaces.
        time_step: s.
        robot_radius: m.
        companions: indices of each person's companions, -1 none; None if nobody has any.
        near: the result of ``neighbors`` for some steps; None: computed for this step.
    """
    near = neighbors(forces, people, 0.0) if near is None else near
    walking, contact = forces.walking, forces.get(Contact)
    px, py = people.position[:, 0], people.position[:, 1]
    vx, vy = people.velocity[:, 0], people.velocity[:, 1]
    crowd = Crowd(forces, people, *look_direction(people), obstacle_grid, groups, robot, robot_radius, companions)
    damped = (_person_force(term, crowd) for term in forces.person_terms if getattr(term, "damped", True))
    undamped = (_person_force(term, crowd) for term in forces.person_terms if not getattr(term, "damped", True))
    force = _add_up([pair_forces(crowd, near), *damped])
    if force is not None:
        force = walking.damp(*force, people.heading)
    force = _add_up([force, *undamped])
    fx, fy = (jnp.zeros_like(px), jnp.zeros_like(py)) if force is None else force
    drive_x, drive_y = (people.desired_velocity[:, 0] - vx), (people.desired_velocity[:, 1] - vy)
    vx = vx + (drive_x / walking.relaxation_time + fx) * time_step
    vy = vy + (drive_y / walking.relaxation_time + fy) * time_step
    vx, vy = walking.limit_speed(vx, vy, people.preferred_speed)
    if obstacle_grid is not None:
        friction = None
        if contact is not None and contact.friction is not None:
            friction = contact.friction / contact.stiffness
        vx, vy = project_velocity(px, py, vx, vy, obstacle_grid, walking.radius, time_step, friction)
        vx, vy = jax.lax.optimization_barrier((vx, vy))  # XLA for a GPU would compute both twice: for x and for y
    velocity = jnp.where(people.present[:, None], jnp.stack([vx, vy], -1), 0.0)
    heading = turn(people, velocity, walking.turn_rate * time_step)
    return replace(people, position=people.position + velocity * time_step, velocity=velocity, heading=heading)


def cutoff(forces: Forces) -> Float[Array, ""] | None:
    """The distance [m] beyond which no pair term pushes by more than 1e-4 m/s2; None if a term has no cutoff."""
    functions = [getattr(term, "cutoff", None) for term in (*forces.pair_terms, *forces.gather_terms)]
    cutoffs = [function(forces.walking) for function in functions if function is not None]
    known = [distance for distance in cutoffs if distance is not None]
    if not known or len(known) < len(functions):
        return None
    return jnp.minimum(forces.walking.perception, jnp.stack(known).max())


def neighbors(forces: Forces, people: Pedestrians, time: float) -> Neighbors | None:
    """The pairs of people who interact within ``time`` [s]; None: sum all pairs, faster in small crowds."""
    distance = cutoff(forces)
    if distance is None or people.group.shape[0] < MIN_PEOPLE:
        return None
    speed_max = forces.walking.speed_ratio * jnp.max(people.preferred_speed)
    return find(people.position, people.present, distance + 2.0 * speed_max * time)


def pair_forces(crowd: Crowd, near: Neighbors | None = None) -> Force | None:
    """The force (N,) [m/s2] of all other people on each person: pair terms and gather terms, in one sum; None without.

    Standing members of one group do not interact: their formation keeps them apart (section IV-D). Nor do
    companions, if there is ``Cohesion``, which keeps them together and apart. Gather terms count the robot as one of
    the others. ``near`` are the pairs of a large crowd; other pairs are left out.
    """
    forces, people = crowd.forces, crowd.people
    if not forces.pair_terms and not forces.gather_terms:
        return None

    def law(shared, own, other):
        pair_terms, gather_terms, radius, perception = shared
        (px, py, vx, vy, group, look_x, look_y, standing), (qx, qy, wx, wy, other_group) = own, other
        dx, dy = px - qx, py - qy
        pair = Pair(dx, dy, wx, wy, vx, vy, look_x, look_y, 2.0 * radius, standing.astype(bool))
        force = sum_pair_terms(pair_terms, pair) if pair_terms else None
        numbers = force, gather(gather_terms, pair)
        dd = dx * dx + dy * dy
        felt = (dd > 0.0) & (dd < perception * perception) & (group != other_group)
        return jax.tree.map(lambda number: jnp.where(felt, number, 0.0), numbers)

    group = people.group
    if crowd.companions is not None and forces.get(Cohesion) is not None:
        group = jnp.where((group < 0) & (people.walking_group >= 0), WALKING_GROUPS + people.walking_group, group)
    position, velocity = people.position, people.velocity
    rows = position[:, 0], position[:, 1], velocity[:, 0], velocity[:, 1], group.astype(float)
    other = tuple(jnp.where(people.present, row, ABSENT) for row in rows)
    own_group = jnp.where(group >= 0, group, ALONE).astype(float)
    own = *other[:-1], own_group, crowd.look_x, crowd.look_y, (people.group >= 0).astype(float)
    perception = jnp.minimum(forces.walking.perception, 0.1 * ABSENT)
    shared = forces.pair_terms, forces.gather_terms, forces.walking.radius, perception
    force, gathered = checkpoint_name(sum_pairs(law, near, shared, own, other), SUMS)
    robot = forces.get(RobotRepulsion)
    by_robot = None if robot is None or not gathered else robot.gathered(crowd)
    if by_robot is not None:
        gathered = jax.tree.map(jnp.add, gathered, by_robot)
    acts = [
        force_of(term.act, "crowd, " + ", ".join(f"sum_{k}" for k in range(len(numbers))), crowd, *numbers)
        for term, numbers in zip(forces.gather_terms, gathered, strict=True)
    ]
    return _add_up([force, *acts])


def _person_force(term: PersonTerm, crowd: Crowd) -> Force | None:
    return force_of(term.person, "crowd", crowd, optional=True)


def _add_up(parts: Iterable[Force | None]) -> Force | None:
    """The sum of the forces that are not None, in their order; None if all are."""
    total = None
    for part in parts:
        if part is not None:
            total = part if total is None else (total[0] + part[0], total[1] + part[1])
    return total
