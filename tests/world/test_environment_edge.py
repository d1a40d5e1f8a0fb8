"""The floor's edge holds people and robots unless the environment is open, and the report's check measures it."""

import dataclasses
from itertools import chain
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import sensors, social_forces
from sean_jax.core.data_types import Pedestrians
from sean_jax.core.geometry import from_box, to_edge
from sean_jax.evaluation import batches
from sean_jax.people.behaviors.starts import anywhere
from sean_jax.policies import POLICIES
from sean_jax.policies.costmap import map_frame, static_cells
from sean_jax.policies.expert import obstacle_rate
from sean_jax.simulation.scenario import reset, snapshot
from sean_jax.simulation.scenario_stack import Stack
from sean_jax.world import environment as environments
from support.scenes import box, room

FLOOR = -6.0, -5.0, 6.0, 5.0
WALLS = (  # on the edge, beyond it, of two parts side by side, and one that leaves 0.3 m free
    [box((-5.9, 0), (0.1, 5))],
    [box((0, 5.5), (6.2, 0.5))],
    [box((6, -3), (0.1, 2)), box((6, 2), (3, 0.1), turn=90)],
    [box((0.3, -5), (6, 0.1))],
)
PEOPLE, STEPS = 64, 100


def plaza(folder, boxes=(), more=""):
    return room(folder, FLOOR, boxes, 6, more=more)


@pytest.fixture(scope="module")
def plazas(tmp_path_factory):
    """Closed and open, without a single box."""
    folders = plaza(tmp_path_factory.mktemp("closed")), plaza(tmp_path_factory.mktemp("open"), more="open: true\n")
    return [environments.load(folder) for folder in folders]


@pytest.fixture(scope="module")
def scenarios(plazas, tmp_path_factory):
    made = []
    for name, more in (("closed", ""), ("open", "open: true\n")):
        folder = plaza(tmp_path_factory.mktemp(name), more=more)
        made.append(sean_jax.make(folder, behavior="random", task="busy_ab_nav", dynamics="twin"))
    return made


def test_edges_are_added_where_no_walls_cover_them(tmp_path):
    """None for the environments of the package, whose walls cover theirs; each one by itself for a plaza."""
    for name in environments.available():
        assert (np.asarray(environments.load(name).obstacles.height) > 0).all(), name
    for number in range(len(WALLS) + 1):
        boxes = environments.load(plaza(tmp_path, chain.from_iterable(WALLS[:number]))).obstacles
        edge = np.asarray(boxes.height) == 0
        assert edge.sum() == max(4 - number, 1) and (edge == np.sort(edge)).all()  # after the boxes
    surface = jax.vmap(lambda x, y: from_box(x, y, jax.tree.map(lambda part: part[-1], boxes))[0])
    x = jnp.linspace(-6.0, 6.0, 50)
    np.testing.assert_allclose(surface(x, jnp.full_like(x, -4.0)), 1.0, atol=1e-5)


def walk(place, key):
    """Least distance to the floor's edge over the steps of people who want to leave it, shoved by one another."""
    parameters = social_forces.preset("helbing1995")
    keys = jax.random.split(key, 3)
    lower, upper = jnp.asarray(FLOOR[:2]) + 0.2, jnp.asarray(FLOOR[2:]) - 0.2
    position = jax.random.uniform(keys[0], (PEOPLE, 2), jnp.float32, lower, upper)
    angle = jax.random.uniform(keys[1], (PEOPLE,), jnp.float32, 0.0, 2 * jnp.pi)
    heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    speed = jax.random.uniform(keys[2], (PEOPLE, 1), jnp.float32, 1.0, 20.0)
    nobody = jnp.full(PEOPLE, -1, jnp.int32)
    people = Pedestrians(
        position=position, velocity=heading * speed, heading=heading, desired_velocity=heading * speed, group=nobody,
        walking_group=nobody, present=jnp.ones(PEOPLE, bool), preferred_speed=speed[:, 0],
        robot_distance=jnp.zeros(PEOPLE),
    )  # fmt: skip

    def step(people, _):
        people = social_forces.integrate(parameters, people, place.obstacle_grid, None, None, 0.05)
        return people, to_edge(place, *people.position.T).min()

    return jax.lax.scan(step, people, length=STEPS)[1].min()


def test_nobody_is_pushed_off_the_floor(plazas):
    """8 crowds of 64 in 100 steps, all at up to 20 m/s towards an edge; where it is open, they leave."""
    least = [jax.jit(jax.vmap(walk, (None, 0)))(place, jax.random.split(jax.random.key(2), 8)) for place in plazas]
    assert np.asarray(least[0]).min() >= 0.2 - 1e-3
    assert np.asarray(least[1]).max() < -1.0


@pytest.mark.slow
def test_a_robot_stays_on_the_floor_and_sees_no_edge(scenarios):
    """It drives at an edge from 32 places; nothing but the floor is in its pictures, and metrics know of the edge."""

    def run(scenario, key):
        state = reset(scenario, key)
        drive = jnp.asarray([2.0, 0.0], jnp.float32)
        last = jax.lax.fori_loop(
            0, 300, lambda _, state: sean_jax.simulation.scenario.move_robot(scenario, state, drive), state
        )
        return last, dict(scenario.metrics)["min_distance_to_obstacles"].init(snapshot(scenario, last))

    found = []
    for scenario in scenarios:
        empty = dataclasses.replace(scenario, people=0)
        last, distance = jax.jit(jax.vmap(run, (None, 0)))(empty, jax.random.split(jax.random.key(1), 32))
        found.append(np.asarray(to_edge(scenario.environment, *last.robot.position.T)))
        assert scenario.environment.scenery.solids.boxes.shape == (0, 8)
        if not scenario.environment.open:
            np.testing.assert_allclose(np.asarray(distance)[:, 0], found[0], atol=1e-3)
            one = jax.tree.map(lambda leaf: leaf[0], last)
            sensor = sensors.lidar(scenario, count=16, far=100.0)
            assert (np.asarray(jax.jit(sensors.scan, static_argnums=2)(empty, one, sensor)) == 100.0).all()
    assert found[0].min() >= scenarios[0].robot.radius - 2e-3
    assert found[1].min() < -1.0


def test_the_check_measures_the_edge(scenarios):
    """Of people half a metre off the floor: the truth where it holds them, nothing where they may leave."""
    spots = np.array([[[0.0, -4.0], [6.5, 0.0], [-4.0, 4.0]]], np.float32)
    shapes = jax.eval_shape(reset, dataclasses.replace(scenarios[0], people=3), jax.random.key(0))
    shapes = dataclasses.replace(shapes, streams=())  # keys have no zeros
    states = jax.tree.map(lambda leaf: np.zeros((1, *leaf.shape), leaf.dtype), shapes)
    people = dataclasses.replace(states.pedestrians, position=spots, present=np.ones((1, 3), bool))
    states, actions = dataclasses.replace(states, pedestrians=people), np.zeros((1, 1, 2), np.float32)
    for scenario, wanted in zip(scenarios, (0.5 + 0.2, -1.0), strict=True):
        three = dataclasses.replace(scenario, people=3)
        empty = batches._init((4, 4), Stack(three, {}), states)
        found, _ = batches._update((4, 4), 1, Stack(three, {}), states, states, actions, jnp.ones(1, bool), empty)
        found = found.penetration
        assert (found < wanted) if scenario.environment.open else (abs(found - wanted) < 1e-5)


@pytest.mark.slow
def test_a_plaza_has_free_places_and_straight_ways(scenarios):
    for scenario, people in zip(scenarios, (0, 6), strict=True):
        navigation = scenario.navigation
        assert np.asarray(to_edge(scenario.environment, *navigation.places.T)).min() >= scenario.robot.radius
        assert len(anywhere(scenario.environment, navigation, 100)) >= 100
        task = jax.jit(reset)(dataclasses.replace(scenario, people=people), jax.random.key(0)).task
        np.testing.assert_allclose(task.geodesic, np.linalg.norm(task.goal - task.start), rtol=1e-6)


def test_planners_mind_the_edge_where_it_holds_people_alone(scenarios):
    x, y = jnp.array([0.0, 5.9, 8.0]), jnp.zeros(3)  # in the middle, at the edge, off the floor
    expert: Any = POLICIES["expert"]
    for scenario in scenarios:
        rates = jax.jit(obstacle_rate)(scenario, expert.params.weights, x[None], y[None])[0]
        (origin, cell), cells = map_frame(scenario.environment), jax.jit(static_cells)(scenario.environment)
        places = (np.stack([x + 0.15, y], -1) - np.asarray(origin)) // np.asarray(cell)  # the cell beyond the edge
        for cost in (rates, np.asarray(cells)[tuple(places.astype(int).T)]):
            assert (np.asarray(cost) > 0).tolist() == [False, *2 * [not scenario.environment.open]]
