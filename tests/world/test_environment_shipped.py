"""Every environment of the package (section IV-C): minutes of people in it, and its shortest paths against float64."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.graph import annotation
from sean_jax.world import environment as environments
from sean_jax.world import navigation
from support import crowds, programs
from support import shortest_paths as oracle
from support.quick import quick, slow

NAMES = environments.available()
# Whole rollouts take long to compile.
ROLLED_OUT = slow(NAMES, "warehouse", "lab")
SECONDS = 240  # stays in groups take 60 s and more
BODY, RADIUS = 0.2, 0.25  # m


@functools.cache
def minutes(name: str):
    """The scenario, and minutes of its people alone and of their memory, as numpy arrays."""
    scenario = sean_jax.make(name, dynamics="twin")
    history = jax.jit(lambda key: crowds.walk(scenario, key, 10 * SECONDS))(jax.random.key(0))
    return scenario, *jax.tree.map(np.asarray, history)


@pytest.mark.parametrize("name", ROLLED_OUT)
def test_resets_are_valid(name):
    scenario = minutes(name)[0]
    states = programs.resets(scenario, jax.random.split(jax.random.key(1), 32))
    clearance = jax.jit(jax.vmap(environments.clearance, in_axes=(None, 0)))
    assert clearance(scenario.environment, states.pedestrians.position).min() > BODY
    for place in (states.task.start, states.task.goal):
        assert clearance(scenario.environment, place[:, None]).min() > scenario.robot.radius
    geodesic = np.asarray(states.task.geodesic)
    assert np.isfinite(geodesic).all()
    people = np.asarray(states.pedestrians.position)
    apart = np.linalg.norm(people[:, :, None] - people[:, None], axis=-1) + 9 * np.eye(people.shape[1])
    assert apart.min() > 2 * BODY


@pytest.mark.parametrize("name", ROLLED_OUT)
def test_minutes_of_people(name):
    """Nobody is inside an obstacle or off the floor, nobody is stuck, and groups are joined."""
    scenario, history, memory = minutes(name)
    place, people, group = scenario.environment, history.position, history.group
    clear = np.asarray(programs.clearance(place, jnp.asarray(people.reshape(-1, 2))))
    assert clear.min() > BODY - 0.01
    far = np.linalg.norm(people[200:] - people[:-200], axis=-1)  # from 20 s to 20 s
    # Errands take up to 40 s, and who has left does not walk.
    stands = (group >= 0) | (memory.trip.errand > 0) | ~history.present
    standing = np.stack([stands[k : k + 201].any(0) for k in range(len(far))])
    assert ((far < 0.05) & ~standing).mean() < 0.01
    joined = (group[1:] >= 0) & (group[:-1] < 0)
    assert joined.sum() >= 1
    capacity = np.asarray(scenario.behavior.data.graph.capacity)[np.asarray(scenario.behavior.data.graph.groups)]
    most = [(group == number).sum(1).max() for number in range(len(capacity))]
    assert most == capacity.tolist()


@pytest.mark.parametrize("name", quick(NAMES, "lab"))
def test_ways_between_the_nodes_of_the_graph_are_shortest(name):
    place = environments.load(name)
    tables = navigation.build(place, RADIUS)
    nodes = np.asarray(annotation.read_graph(environments.find(name) / "graph.yaml", place).position)
    i, j = np.triu_indices(len(nodes), 1)
    truth = oracle.geodesics(oracle.boxes_of(place), RADIUS, nodes[i].astype(float), nodes[j].astype(float), arc=12)
    ours = np.asarray(oracle.lengths(tables, nodes[i], nodes[j]), float)
    np.testing.assert_allclose(ours, truth, rtol=5e-3)
    assert (ours >= np.linalg.norm(nodes[i] - nodes[j], axis=1) - 1e-4).all()


@pytest.mark.slow
def test_large_floors_have_wider_cells():
    """A grid of at most some 100,000 cells, of a multiple of a quarter of a metre."""
    outdoor = navigation.build(environments.load("outdoor"), RADIUS)
    assert float(outdoor.cell) == 0.5 and tuple(outdoor.visible.shape[:2]) == (198, 304)
    ways = navigation.build_next_corner_table(outdoor, outdoor.places[:2])
    assert tuple(ways.first_arc.shape) == (396, 608, 2)  # what people look up stays at a quarter
    assert sum(leaf.nbytes for leaf in jax.tree.leaves((outdoor, ways))) < 100e6
    lab = navigation.build(environments.load("lab"), RADIUS)
    assert float(lab.cell) == navigation.CELL and tuple(lab.visible.shape[:2]) == (44, 26)
