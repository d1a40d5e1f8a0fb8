"""Gradients over a thousand states each: everything that can be differentiated is finite in degenerate cases too.

Half of the states are random. In the others somebody or something is at a distance that is swept through 0, almost 0,
touching and every threshold of the code, at rest or hardly moving, exactly aligned, on a wall, a corner or the goal.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import classifiers, metrics, sensors, social_forces
from sean_jax.classifiers import more_situations, predicates
from sean_jax.core import geometry
from sean_jax.core.data_types import Obstacles, Pedestrians, Policy, Snapshot
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.metrics import proximity
from sean_jax.people.orca_solver import VelocityProgram, best_velocity, half_plane
from sean_jax.people.pedestrian_models import MODELS
from sean_jax.policies import POLICIES, social_costmap
from sean_jax.policies.costmap import proxemic_cost
from sean_jax.policies.prediction import predict_people
from sean_jax.simulation import episodes
from sean_jax.social_forces import PRESETS, Pair, terms, walls
from sean_jax.world import navigation
from support.state_sweep import NUMBER, PEOPLE, SWEPT, TINY, directions, floats, gaps, met, speeds, state_of, states


def all_finite(gradients, *at):
    """Every leaf (NUMBER, ...) is finite, and so are squares, of which norms are made; else says of which state not."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(gradients):
        with np.errstate(over="ignore"):
            bad = np.flatnonzero(~np.isfinite(np.square(np.asarray(leaf))).reshape(len(leaf), -1).all(1))
        if len(bad):
            first = jax.tree.map(lambda part: np.asarray(part)[bad[0]].tolist(), at)  # noqa: B023
            pytest.fail(f"{jax.tree_util.keystr(path)}: {len(bad)} of {len(leaf)}, the first {bad[0]}: {first}")


def check(function, at, shared=(), smooth=0.0, step=2e-3, parts=1):
    """Gradients of ``function(at, shared) -> () or arrays`` by the rows of ``at`` and by ``shared``: all are finite.

    In at least the share ``smooth`` of the random states they agree with central differences. The rows are taken in
    ``parts``, where all at once would need much memory.
    """

    def value(at, shared):
        leaves = jax.tree.leaves(function(at, shared))
        return sum((0.5 + 0.3 * k) * jnp.sum(jnp.sin(1.0 + leaf)) for k, leaf in enumerate(leaves))

    slope = jax.jit(jax.vmap(jax.value_and_grad(value, (0, 1)), (0, None)))
    rows = np.split(np.arange(NUMBER), parts)
    found = [slope(jax.tree.map(lambda leaf: leaf[some], at), shared) for some in rows]  # noqa: B023
    values, (by_state, by_shared) = jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)
    all_finite(values, at)
    all_finite((by_state, by_shared), at)
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves(by_state)) > 1e-3
    if not smooth:
        return
    random = np.random.default_rng(9)
    some = slice(NUMBER // 2, None)
    change = jax.tree.map(lambda leaf: np.asarray(random.normal(size=leaf.shape), np.float32), at)
    ends = [slope(jax.tree.map(lambda x, dx: x + sign * step * dx, at, change), shared)[0] for sign in (1.0, -1.0)]  # noqa: B023
    measured = (np.asarray(ends[0]) - np.asarray(ends[1]))[some] / (2 * step)
    products = jax.tree.map(lambda slope, dx: (np.asarray(slope) * dx).reshape(NUMBER, -1).sum(1), by_state, change)
    computed = sum(jax.tree.leaves(products))[some]
    agree = np.abs(measured - computed) <= 0.02 + 0.05 * np.abs(computed)
    assert agree.mean() >= smooth, (agree.mean(), measured[~agree][:5], computed[~agree][:5])


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A room with two boxes, two people who stand in a group and two who walk, and a robot."""
    return met(tmp_path_factory.mktemp("room"))


def limits(scenario):
    """The constants of the robot that a policy or the step may be differentiated by, and where they go."""
    names = ("mass", "friction", "servo_gain", "max_speed", "max_turn_rate", "max_acceleration")
    values = {name: getattr(scenario.robot, name) for name in names}
    return values, lambda values: scenario.replace(robot=scenario.robot.replace(**values))


night = pytest.mark.night


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "go_to_goal" else [night]) for name in POLICIES]
)
def test_policies(room, name):
    scenario, state = room
    policy: Any = POLICIES[name]
    constants, with_limits = limits(scenario)
    settings, with_settings = floats(policy.params if isinstance(policy, Policy) else ())
    begun = episodes.init_policy(scenario, policy, state)

    def command(at, shared):
        world, now = with_limits(shared[0]), state_of((scenario, begun), at)
        if isinstance(policy, Policy):
            return policy.apply(world, with_settings(shared[1]), now, jax.random.key(1))[0]
        return policy(world, now, jax.random.key(1))

    plans = isinstance(policy, Policy)  # and jumps from one of its samples to another
    check(command, states(), (constants, settings), smooth=0.0 if plans else 0.8, parts=8 if plans else 1)


@night
def test_predictions_of_people_in_one_place(room):
    """Who stands in another, or all but, does not make each step's derivative thousands of times the last one's."""
    random = np.random.default_rng(8)
    near = [random.permutation(np.resize(np.float32([*TINY, 0.1]), NUMBER))[:, None] * directions(random, NUMBER)
            for _ in range(PEOPLE)]  # fmt: skip
    walking = [np.where(np.arange(NUMBER) % 2, 0.0, random.normal(size=(PEOPLE, 2, NUMBER))).transpose(2, 0, 1)
               for _ in range(2)]  # fmt: skip
    at = {**states(), "people": jnp.asarray(np.stack(near, 1), jnp.float32)}
    at |= {name: jnp.asarray(part, jnp.float32) for name, part in zip(("velocity", "desired"), walking, strict=True)}

    def end(at):
        now = state_of(room, at)
        return sum(jnp.sum(jnp.sin(part[-1])) for part in predict_people(room[0], now.pedestrians, now.groups, 16, 0.2))

    slopes = jax.jit(jax.vmap(jax.grad(end)))(at)
    all_finite(slopes, at)
    assert max(float(jnp.abs(slopes[name]).max()) for name in ("people", "desired")) < 1e8


@night
@pytest.mark.parametrize("name", PRESETS)
def test_social_forces(room, name):
    """Of a step among walls, a group and the robot, two people in a walking group; by everything, constants too."""
    scenario = room[0]
    constants, put = floats(social_forces.preset(name))
    companions = jnp.asarray([[1, -1], [0, -1], [-1, -1], [-1, -1]], jnp.int32)

    def after(at, shared):
        now = state_of(room, at)
        return social_forces.integrate(
            put(shared),
            now.pedestrians,
            scenario.environment.obstacle_grid,
            now.groups,
            now.robot,
            0.05,
            0.16,
            companions,
        )

    check(lambda at, shared: _seen(after(at, shared)), states(), constants, smooth=0.8)


def _seen(people: Pedestrians):
    return people.position, people.velocity, people.heading


@pytest.mark.parametrize("name", ["constant_velocity", pytest.param("orca", marks=night)])
def test_pedestrian_models(room, name):
    constants, put = floats(room[0].forces)

    def after(at, shared):
        return _seen(MODELS[name](room[0].replace(forces=put(shared)), state_of(room, at)))

    check(after, states(), constants, smooth=0.8)


@pytest.mark.parametrize("name", ["scan", *(pytest.param(name, marks=night) for name in ("depth", "render"))])
def test_sensors(room, name):
    scenario = room[0]
    if name == "scan":
        device = sensors.lidar(scenario, count=24)
        sense = lambda now: sensors.scan(scenario, now, device)  # noqa: E731
    else:
        device = sensors.camera(scenario, "depth" if name == "depth" else "third_person", width=8, height=6)
        sense = {
            "depth": lambda now: sensors.depth(scenario, now, device),
            "render": lambda now: (lambda seen: (seen.rgb, seen.depth))(sensors.render(scenario, now, device)),
        }[name]
    check(lambda at, _: sense(state_of(room, at)), states())


@night
def test_ways_to_the_goal(room):
    """Lengths and turning of shortest paths and the points ahead on them."""
    scenario, state = room
    task = state.task
    last = navigation.last_arc_to_goal(scenario.navigation, task.goal)

    def ways(at, _):
        given = scenario.navigation, at["robot"], task.goal, task.paths_to_goal
        far = navigation.geodesic(*given), navigation.geodesic_approx(*given)
        turned = navigation.path_rotation(given[0], given[1], at["ahead"], *given[2:])
        points = navigation.next_point(*given), navigation.next_point_approx(*given)
        return jnp.stack([*far, turned]), *points, navigation.plan(*given, last, points=3)

    check(ways, {name: part for name, part in states().items() if name in ("robot", "ahead")}, smooth=0.6)


@pytest.mark.parametrize("kind", ["situations", pytest.param("metrics", marks=night)])
def test_distances_that_classifiers_and_metrics_read(room, kind):
    scenario = room[0]
    limit = classifiers.thresholds()

    def snapshot(at) -> Snapshot:
        return sean_jax.simulation.scenario.snapshot(scenario, state_of(room, at))

    def read(at, _):
        now = snapshot(at)
        gap = now.people.position[0] - now.position
        if kind == "situations":
            first, second, cross = more_situations._crossing(now.position, now.heading, *_pose(now.people, 0))
            boxes = scenario.environment.obstacles
            room_left = geometry.signed_distances(scenario.environment, now.position[None])
            return (
                predicates.cosine(now.heading, gap),
                predicates.cosine(gap, now.people.velocity[0]),
                jnp.stack(predicates.ahead_and_aside(now.heading, gap)),
                jnp.tanh(jnp.stack([first, second, cross])),
                jnp.tanh(more_situations._ray_length(boxes, now.position, now.heading)),
                jnp.stack(room_left),
                jnp.where(classifiers.classify(now, limit), gap[0], gap[1]),
            )
        before = replace(now, position=now.position - 0.1 * now.velocity)
        values = {name: metric.update(metric.init(before), before, now) for name, metric in metrics.METRICS.items()}
        results = {name: metrics.METRICS[name].compute(value) for name, value in values.items()}
        never = jax.tree.map(lambda leaf: jnp.where(jnp.abs(leaf) < 1e3, leaf, 0.0), results)
        relative = now.people.velocity[0] - now.velocity
        soonest = proximity.collision_time(gap[0], gap[1], relative[0], relative[1], 0.46)
        return never, jnp.where(soonest < 100.0, soonest, 0.0), jnp.tanh(proximity._distance_to_people(now))

    check(read, states())


def _pose(people: Pedestrians, index: int):
    return people.position[index], people.heading[index]


def laws() -> dict[str, Any]:
    """name -> a law of two plane vectors (2,), (2,), and what it gives; distances [m], velocities [m/s]."""
    layers = social_costmap.params.global_costmap
    p = social_forces.preset("helbing2000").tree_replace({"sidestep.preference": 2.0})

    def pair(dx, dy, wx, wy, vx=0.0, vy=0.0, look_x=1.0, look_y=0.0):
        return Pair(dx, dy, wx, wy, vx, vy, look_x, look_y, 0.6)

    gap = Obstacles(
        *(jnp.asarray(part) for part in ([[0.75, 0.0], [-0.75, 0.0]], [[0.5, 3.0]] * 2, [0.0] * 2, [1.0] * 2))
    )
    floor = jnp.array([-5.0, -5.0, 5.0, 5.0])
    between = build_obstacle_grid(gap, floor)  # half a metre, too narrow for anybody
    found = {
        "length": lambda d, v: geometry.length(*d),
        "unit": lambda d, v: geometry.unit(*d),
        "unit_vectors": lambda d, v: geometry.unit_vectors(d, v),
        "angle_between": lambda d, v: geometry.angle_between(d, v),
        "from_rectangle": lambda d, v: geometry.from_rectangle(*d, 0.0, 0.0, 0.5, 0.25, 1.0, 0.0),
        "from_turned_rectangle": lambda d, v: geometry.from_rectangle(*d, 0.5, 0.0, 0.5, 0.25, 0.8, 0.6),
        "project_velocity": lambda d, v: walls.project_velocity(d[:1], d[1:], v[:1], v[1:], between, 0.3, 0.05, 1e-3),
        "limit_approach": lambda d, v: walls.limit_approach(d[:1], d[1:], v[:1], v[1:], between, 0.3, 1.25),
        "wall_forces": lambda d, v: walls.wall_forces(p.walls, d[:1], d[1:], between, 1e6),
        "contact": lambda d, v: p.contact.pair(pair(*d, *v)),
        "sidestep": lambda d, v: p.sidestep.pair(pair(*d, *v)),
        "gaze": lambda d, v: terms.gaze(p.cohesion, *d, *v, jnp.float32(1.0), jnp.float32(0.0)),
        "attraction": lambda d, v: terms.attraction(p.cohesion, *d, 2.0),
        "apart": lambda d, v: terms.companion_repulsion(p.cohesion, *d),
        "half_plane": lambda d, v: half_plane(*d, *v, 0.6, 3.0, 0.1, True),
        "proxemic": lambda d, v: proxemic_cost(layers, *d, *v),
        "collision_time": lambda d, v: jnp.tanh(proximity.collision_time(*d, *v, 0.6)),
    }
    wide = build_obstacle_grid(Obstacles(jnp.zeros((1, 2)), jnp.full((1, 2), 50.0), jnp.zeros(1), jnp.ones(1)), floor)
    for name in PRESETS:
        one = social_forces.preset(name)
        law, push = one.repulsion, one.walls
        found[f"{name}, deep in a wall"] = lambda d, v, push=push: walls.wall_forces(push, d[:1], d[1:], wide, 1e6)
        found[f"repulsion of {name}"] = lambda d, v, law=law: law.law(law, pair(*d, *v, 0.3, 0.0))
        found[f"sight of {name}"] = lambda d, v, law=law: law.sight(law, pair(*d, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8), *v)
    return found


def test_laws():
    """Of a pair, of an angle, of a box: each by itself, all in one program."""
    random = np.random.default_rng(4)
    each, found = (jnp.asarray(gaps(random)), jnp.asarray(speeds(random))), laws()
    aligned = jnp.asarray(np.resize([1.0, -1.0, 0.0], (NUMBER, 1)), jnp.float32)
    every = [each, (each[0], each[0] * aligned), (each[1], each[1] * aligned)]

    def slopes(d, v):
        def value(name):
            return lambda d, v: sum(
                jnp.sum(leaf) * (1.0 + k) for k, leaf in enumerate(jax.tree.leaves(found[name](d, v)))
            )

        return {name: jax.grad(value(name), (0, 1))(d, v) for name in found}

    run = jax.jit(jax.vmap(slopes))
    for d, v in every:
        all_finite(run(d, v), d, v)


def test_best_velocity_among_half_planes():
    """Parallel and opposite borders, through zero, at the speed limit, and such that nothing is left."""
    random = np.random.default_rng(5)
    normal = np.stack([directions(random, NUMBER) for _ in range(3)], 1)
    normal[: NUMBER // 4, 1] = -normal[: NUMBER // 4, 0]
    offset = np.stack([random.permutation(np.resize(SWEPT, NUMBER)) for _ in range(3)], 1) * [1, -1, 1]
    wish = np.where(random.random((NUMBER, 1)) < 0.3, normal[:, 0] * offset[:, :1], gaps(random))
    at = tuple(jnp.asarray(part, jnp.float32) for part in (normal, offset, wish))
    hard = jnp.array([False, False, True])

    def taken(at, limit):
        normal, offset, wish = at
        offset = jnp.where(hard, -jnp.abs(offset), offset)
        return jnp.stack(best_velocity(VelocityProgram(normal[:, 0], normal[:, 1], offset, hard, *wish, limit)))

    check(taken, at, jnp.float32(0.5))


@night
@pytest.mark.parametrize("dynamics", ["twin", "kinematic", "mjx"])
def test_the_whole_step(room, dynamics):
    """By the state, the action, and constants of robot and forces."""
    scenario, _ = room
    if dynamics != "twin":
        scenario = scenario.replace(robot=sean_jax.robots.load("kuri", dynamics))
    constants, with_limits = limits(scenario)
    forces, put = floats(scenario.forces)
    random = np.random.default_rng(6)
    action = np.where(random.random((NUMBER, 1)) < 0.3, 0.0, random.uniform((-0.7, -4.0), (0.7, 4.0), (NUMBER, 2)))
    at = {**states(), "action": jnp.asarray(action, jnp.float32)}

    def after(at, shared):
        world = with_limits(shared[0]).replace(forces=put(shared[1]))
        end = sean_jax.step(world, state_of((scenario, room[1]), at), at["action"])
        parts = floats((end.pedestrians, end.robot, end.metrics))[0]
        return [jnp.where(jnp.abs(part) < 1e3, part, 0.0) for part in parts]

    check(after, at, (constants, forces), smooth=0.8)
