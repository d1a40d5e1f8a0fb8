"""The social force model (section IV-D [28][44][45]): the sum of its terms, integrated by semi-implicit Euler steps."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Int

from sean_jax.core.data_types import Array, Groups, ObstacleGrid, Pedestrians, Robot, Scenario, State, Traits
from sean_jax.social_forces.forces import (
    MIN_SPEED,
    PUSHED_SPEED,
    Crowd,
    Force,
    Forces,
    GatherTerm,
    Pair,
    PairTerm,
    PersonTerm,
    Walking,
    components,
    force_of,
    gather,
    is_standing,
    look_direction,
    over_robots,
    sum_pair_terms,
    turn,
)
from sean_jax.social_forces.neighbors import ABSENT, MIN_PEOPLE, Neighbors, find, sum_pairs
from sean_jax.social_forces.reactions import Reactions, nearest_robot
from sean_jax.social_forces.terms import Cohesion, Noise, Repulsion, RobotRepulsion, evasion_factors
from sean_jax.social_forces.walls import Contact, project_velocity

SUMS = "pair sums"  # reverse mode stores these of a step, and the state; the rest is recomputed
ALONE = -2  # group of a person in none, on whom forces act; the other of a pair has -1, so the two differ
DEVIATIONS = "relaxation_deviation", "deviation", "width_deviation", "side_deviation"  # parameters of traits
MOST_UNLIKE = 2.0  # standard deviations, at which traits are truncated
WALKING_GROUPS = 1 << 20  # added to the number of a walking group, to distinguish it from a standing group


def draw_traits(forces: Forces, key: Array, people: int) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Traits of people: preferred speeds [m/s], normal and truncated, and extra distances [m] from a moving robot.

    A uniformly drawn factor f of the robot's repulsion A exp(-b / B) is a distance of B ln(f) [45]. ``Walking`` and
    ``RobotRepulsion`` have the parameters of both distributions.
    """
    walking = forces.walking
    speed_key, robot_key = jax.random.split(key)
    deviation = jnp.maximum(walking.speed_deviation, 1e-6)
    lower = (walking.speed_min - walking.speed_mean) / deviation
    lower = jnp.minimum(lower, -1e-3)
    upper = (walking.speed_max - walking.speed_mean) / deviation
    upper = jnp.maximum(upper, 1e-3)
    normal = jax.random.truncated_normal(speed_key, lower, upper, (people,), float)
    speed = walking.speed_mean + walking.speed_deviation * normal

    robot = forces.get(RobotRepulsion)
    repulsion = forces.get(Repulsion)
    if robot is None or repulsion is None:
        return speed, jnp.zeros(people, float)
    factor = jax.random.uniform(robot_key, (people,), float, robot.factor_min, robot.factor_max)
    distance = repulsion.range * jnp.log(factor)
    return speed, distance


def individualize(forces: Forces, people: Pedestrians, key: Array) -> Pedestrians:
    """People with the traits, the noise and the reactions that the forces have use for, drawn once per episode."""
    n_people = people.present.shape[0]
    trait_key, noise_key, reaction_key = jax.random.split(key, 3)

    traits = None
    deviations = [getattr(term, name, None) for term in forces for name in DEVIATIONS]
    if any(deviation is not None for deviation in deviations):
        keys = jax.random.split(trait_key, len(Traits.__dataclass_fields__))
        shape = (n_people,)
        draw = partial(jax.random.truncated_normal, lower=-MOST_UNLIKE, upper=MOST_UNLIKE, shape=shape, dtype=float)
        traits = Traits(*map(draw, keys))

    noise = None
    if forces.get(Noise) is not None:
        noise = jax.random.normal(noise_key, (n_people, 2), float)

    reaction = None
    reactions = forces.get(Reactions)
    if reactions is not None:
        reaction = reactions.draw(reaction_key, n_people)
    return replace(people, traits=traits, noise=noise, reaction=reaction)


def move(scenario: Scenario, state: State) -> Pedestrians:
    """People one control step later, in ``scenario.substeps`` steps of the social forces; the robot stays in place."""
    time_step = scenario.time_step / scenario.substeps
    grid = scenario.environment.obstacle_grid
    radius = scenario.robot.radius
    companions = scenario.behavior.companions
    people = _advance_noise_and_attention(scenario, state)
    near = neighbors(scenario.forces, state.pedestrians, scenario.time_step)
    numbers, unravel = ravel_pytree(scenario.forces)  # reverse mode adds up one array, not one for each number

    def substep(people: Pedestrians, _):
        forces = unravel(numbers)
        people = integrate(forces, people, grid, state.groups, state.robot, time_step, radius, companions, near)
        return people, None

    # Without this, reverse mode would store every number of every substep.
    keep = jax.checkpoint_policies.save_only_these_names(SUMS)
    substep = jax.checkpoint(substep, prevent_cse=False, policy=keep)
    people, _ = jax.lax.scan(substep, people, length=scenario.substeps)
    return people


def _advance_noise_and_attention(scenario: Scenario, state: State) -> Pedestrians:
    """People with the noise and the reactions that they have for this control step."""
    people = state.pedestrians
    noise = scenario.forces.get(Noise)
    if noise is not None and people.noise is not None:
        key = jax.random.fold_in(state.streams.noise, state.tick)
        people = replace(people, noise=noise.advance(people.noise, key, scenario.time_step))

    reactions = scenario.forces.get(Reactions)
    if reactions is not None and state.robot is not None:
        robot = nearest_robot(people, state.robot)
        people = reactions.attend(people, robot, scenario.environment.obstacles, scenario.time_step)
    return people


def integrate(
    forces: Forces,
    people: Pedestrians,
    obstacle_grid: ObstacleGrid | None,
    groups: Groups | None,
    robot: Robot | None,
    time_step: Float[Array, ""] | float,
    robot_radius: Float[Array, "*M"] | float = 0.0,
    companions: Int[Array, "N 2"] | None = None,
    near: Neighbors | None = None,
) -> Pedestrians:
    """People one step of the social forces later.

    Args:
        groups: people avoid their o-spaces.
        robot: or several, (M, ...), of a team: each acts on people as one alone.
        time_step: s.
        robot_radius: m, or (M,).
        companions: indices of each person's companions, -1 none; None if nobody has any.
        near: the result of ``neighbors`` for some steps; None: computed for this step.
    """
    # Callers of several steps find neighbors once, with a margin for motion; a single step needs none (0 s).
    if near is None:
        near = neighbors(forces, people, 0.0)
    walking = forces.walking
    reactions = forces.get(Reactions)
    desired_velocity = people.desired_velocity

    # People who attend to the robot want another velocity for this step; their plan, kept above, comes back.
    gaze = None
    if reactions is not None and robot is not None:
        nearest = nearest_robot(people, robot)
        wanted_velocity = reactions.desire(people, nearest)
        people = replace(people, desired_velocity=wanted_velocity)
        gaze = reactions.gaze(people, nearest)

    # A semi-implicit Euler step: positions follow from the new velocities, which obstacles have bounded.
    px, py = components(people.position)
    vx, vy = components(people.velocity)
    look_x, look_y = look_direction(people)
    crowd = Crowd(forces, people, look_x, look_y, obstacle_grid, groups, robot, robot_radius, companions)
    ax, ay = _accelerations(crowd, near, vx, vy)
    vx = vx + ax * time_step
    vy = vy + ay * time_step
    vx, vy = walking.limit_speed(vx, vy, people.preferred_speed)
    if obstacle_grid is not None:
        friction = _wall_friction(forces)
        vx, vy = project_velocity(px, py, vx, vy, obstacle_grid, walking.radius, time_step, friction)
        vx, vy = jax.lax.optimization_barrier((vx, vy))  # XLA for a GPU would compute both twice: for x and for y

    # Absent people have no velocity, or padding would drift; bodies turn into their motion, or to the robot.
    velocity = jnp.stack([vx, vy], -1)  # (N, 2)
    velocity = jnp.where(people.present[:, None], velocity, 0.0)
    towards = velocity
    min_speed = MIN_SPEED
    if walking.facing is not None:
        towards = towards + walking.facing * desired_velocity
        min_speed = PUSHED_SPEED
    if gaze is not None:
        towards = towards + gaze
    heading = turn(people, towards, walking.turn_rate * time_step, min_speed)
    position = people.position + velocity * time_step
    return replace(people, position=position, velocity=velocity, heading=heading, desired_velocity=desired_velocity)


def _accelerations(
    crowd: Crowd, near: Neighbors | None, vx: Float[Array, "N"], vy: Float[Array, "N"]
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """The accelerations [m/s2] by the desired velocity and all forces, bounded but for what others push."""
    people = crowd.people
    walking = crowd.forces.walking
    fx, fy, push_x, push_y = _forces(crowd, near)
    relaxation_time = walking.relaxation(people)
    desired_x, desired_y = components(people.desired_velocity)
    ax = (desired_x - vx) / relaxation_time + fx
    ay = (desired_y - vy) / relaxation_time + fy

    # Others push however hard; people bound only what they do on purpose.
    ax, ay = walking.bound(ax - push_x, ay - push_y)
    return ax + push_x, ay + push_y


def _forces(crowd: Crowd, near: Neighbors | None) -> tuple[Array, Array, Array | float, Array | float]:
    """The sum of all forces (N,) [m/s2], and those of pair terms alone."""
    heading = crowd.people.heading
    damp = crowd.forces.walking.damp
    terms = crowd.forces.person_terms
    pushes, acts = pair_forces(crowd, near)
    damped = [_person_force(term, crowd) for term in terms if getattr(term, "damped", True)]
    force = _add_up([pushes, acts, *damped])
    if force is not None:
        force = damp(*force, heading)
    if pushes is not None:
        pushes = damp(*pushes, heading)

    undamped = [_person_force(term, crowd) for term in terms if not getattr(term, "damped", True)]
    force = _add_up([force, *undamped])
    if force is None:
        zero = jnp.zeros_like(crowd.look_x)
        force = zero, zero
    fx, fy = force
    if pushes is None:
        return fx, fy, 0.0, 0.0
    push_x, push_y = pushes
    return fx, fy, push_x, push_y


def _wall_friction(forces: Forces) -> Float[Array, ""] | None:
    """The friction of ``project_velocity`` [s/m]."""
    contact = forces.get(Contact)
    if contact is None or contact.friction is None:
        return None
    return contact.friction / contact.stiffness


def cutoff(forces: Forces) -> Float[Array, ""] | None:
    """The distance [m] beyond which pairs are left out, for no term pushes by more than 1e-4 m/s2 there.

    None if a term has no cutoff.
    """
    distances = []
    for term in (*forces.pair_terms, *forces.gather_terms):
        function = getattr(term, "cutoff", None)
        distance = None if function is None else function(forces.walking)
        if distance is None:
            return None
        distances.append(distance)
    if not distances:
        return None
    longest = jnp.stack(distances).max()
    return jnp.minimum(forces.walking.perception, longest)


def neighbors(forces: Forces, people: Pedestrians, time: float) -> Neighbors | None:
    """The pairs of people who interact within ``time`` [s]; None: sum all pairs, faster in small crowds."""
    distance = cutoff(forces)
    if distance is None or people.group.shape[0] < MIN_PEOPLE:
        return None
    speed_max = forces.walking.speed_ratio * jnp.max(people.preferred_speed)
    return find(people.position, people.present, distance + 2.0 * speed_max * time)


def pair_forces(crowd: Crowd, near: Neighbors | None = None) -> tuple[Force | None, Force | None]:
    """The forces (N,) [m/s2] of all other people on each person: of pair terms and of gather terms, None without.

    Between standing members of one group there is contact alone: their formation keeps them apart (section IV-D). The
    same holds for companions, if there is ``Cohesion``, which keeps them together and apart. Gather terms count the
    robot as one of the others. ``near`` are the pairs of a large crowd; other pairs are left out.
    """
    forces = crowd.forces
    if not forces.pair_terms and not forces.gather_terms:
        return None, None

    # People are farther from absent ones than the reach, whatever it is.
    own, other = _rows(crowd)
    reach = cutoff(forces)
    if reach is None:
        reach = forces.walking.perception
    shared = SharedTerms(
        pair_terms=tuple(term for term in forces.pair_terms if not isinstance(term, Contact)),
        contact=forces.get(Contact),
        gather_terms=forces.gather_terms,
        walking=forces.walking,
        reach=jnp.minimum(reach, 0.1 * ABSENT),
    )
    totals = sum_pairs(_pair_law, near, shared.reach, shared, own, other)
    force, sums = checkpoint_name(totals, SUMS)

    # The robot is one of the others in the sums of gather terms.
    robot = forces.get(RobotRepulsion)
    if robot is not None and sums:
        by_robot = over_robots(crowd, robot.gathered)
        if by_robot is not None:
            sums = jax.tree.map(jnp.add, sums, by_robot)
    acts = [_act(term, crowd, numbers) for term, numbers in zip(forces.gather_terms, sums, strict=True)]
    return force, _add_up(acts)


def _act(term: GatherTerm, crowd: Crowd, sums: tuple[Array, ...]) -> Force:
    names = ", ".join(f"sum_{k}" for k in range(len(sums)))
    return force_of(term.act, f"crowd, {names}", crowd, *sums)


class SharedTerms(NamedTuple):
    """What all pairs share: the terms of the law of a pair, with their parameters."""

    pair_terms: tuple[PairTerm, ...]  # but contact
    contact: Contact | None
    gather_terms: tuple[GatherTerm, ...]
    walking: Walking
    reach: Float[Array, ""]  # m, beyond which nobody is felt


def _rows(crowd: Crowd) -> tuple[tuple[Float[Array, "N"], ...], tuple[Float[Array, "N"], ...]]:
    """The rows of ``_pair_law``: of people as persons, and of people as the others."""
    forces = crowd.forces
    people = crowd.people
    group = people.group
    if crowd.companions is not None and forces.get(Cohesion) is not None:
        in_walking_group = (group < 0) & (people.walking_group >= 0)
        group = jnp.where(in_walking_group, WALKING_GROUPS + people.walking_group, group)

    # A person has the rows of an other, but another number for no group, so that two people alone differ.
    rows = *components(people.position), *components(people.velocity), group.astype(float)
    other = [jnp.where(people.present, row, ABSENT) for row in rows]
    own_group = jnp.where(group >= 0, group, ALONE).astype(float)
    shape = forces.walking.shape(crowd.look_x, crowd.look_y) or ()
    standing = is_standing(people).astype(float)
    own = [*other[:-1], own_group, *shape, crowd.look_x, crowd.look_y, standing]

    # Factors of ``Evasion`` are rows only if people differ.
    factors = evasion_factors(crowd)
    if people.reaction is None:
        factors = factors[:2]
    if any(not isinstance(factor, float) for factor in factors):
        own += [jnp.broadcast_to(jnp.asarray(factor, float), people.present.shape) for factor in factors]
    return tuple(own), (*other, *shape)


def _pair_law(shared: SharedTerms, own: Sequence[Array], other: Sequence[Array]) -> tuple[Force | None, tuple]:
    """The force [m/s2] of one other on one person, and the other's contributions to gather terms; all in scalars."""
    # One pair in scalars: vmap on a CPU and the kernel of a GPU trace the same law.
    qx, qy, wx, wy, other_group, *other_shape = other
    px, py, vx, vy, group, *rows = own
    n_shape = len(other_shape)
    own_shape = rows[:n_shape]
    look_x, look_y, standing, *factors = rows[n_shape:]

    # From the other to the person, so a repulsion is positive along (dx, dy).
    dx = px - qx
    dy = py - qy
    dd = dx * dx + dy * dy

    # If both sums use the same radii, XLA of jax 0.10 writes them to a GPU's memory for each pair. The radii of
    # (dy, dx) are equal to rounding, and each sum computes its own.
    shape = tuple(map(jnp.add, own_shape, other_shape)) or None
    mirrored = None
    if shape is not None:
        mirrored = -shape[0], shape[1]
    radii = shared.walking.radii(dx, dy, shape)
    gather_radii = shared.walking.radii(dy, dx, mirrored)

    # Factors of ``Evasion`` are rows only where people differ in them.
    pair = Pair(dx, dy, wx, wy, vx, vy, look_x, look_y, radii, standing.astype(bool))
    if factors:
        names = "width", "side", "alertness"
        pair = pair._replace(**dict(zip(names, factors, strict=False)))
    force = None
    if shared.pair_terms:
        force = sum_pair_terms(shared.pair_terms, pair)
    sums = gather(shared.gather_terms, pair._replace(radii=gather_radii))

    # Members of a group touch at most; people alone match no group. dd = 0 is oneself, or somebody at one's place.
    within = (dd > 0.0) & (dd < shared.reach * shared.reach)
    felt = within & (group != other_group)
    force, sums = jax.tree.map(lambda number: jnp.where(felt, number, 0.0), (force, sums))
    if shared.contact is not None:
        contact_radii = jnp.where(within, radii, -ABSENT)  # no contact with oneself
        touch = shared.contact.pair(pair._replace(radii=contact_radii))
        force = _add_up([force, touch])
    return force, sums


def _person_force(term: PersonTerm, crowd: Crowd) -> Force | None:
    def law(crowd: Crowd) -> Force | None:
        return force_of(term.person, "crowd", crowd, optional=True)

    if crowd.robot is None or crowd.robot.position.ndim == 1:
        return law(crowd)
    without = law(crowd._replace(robot=None, robot_radius=0.0))
    if without is None:
        return over_robots(crowd, law)

    def by_robot(with_robot: Crowd) -> Force:
        return jax.tree.map(jnp.subtract, law(with_robot), without)

    by_robots = over_robots(crowd, by_robot)
    return jax.tree.map(jnp.add, without, by_robots)


def _add_up(forces: Iterable[Force | None]) -> Force | None:
    """The sum of the forces that are not None, in their order; None if all are."""
    total = None
    for force in forces:
        if total is None:
            total = force
        elif force is not None:
            total = total[0] + force[0], total[1] + force[1]
    return total
