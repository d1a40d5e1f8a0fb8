"""Choices with a temperature: their chances, the program without one, and derivatives against central differences."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import sean_jax
from sean_jax.graph import rerouted
from sean_jax.graph.annotation import to_yaml
from sean_jax.people.behaviors import Place, graph_behavior, graph_choices
from sean_jax.simulation import scenario as stages
from sean_jax.studies.inverse_graph.measuring import begin_alone
from support.graphs import ring, yard

STEPS = 160
TEMPERATURE = 1.0  # m


@pytest.fixture(scope="module")
def crowds(tmp_path_factory):
    """(people, temperature) -> people on a ring with a group beside it; one person has no group there."""
    folder = tmp_path_factory.mktemp("relaxation") / "ring"
    environment = yard(folder)
    made = sean_jax.make(folder, behavior="random", task="random_ab_nav", people=4, dynamics="twin")
    place = Place(folder, environment, made.behavior.data.navigation)

    def crowd(people: int, temperature: float):
        (folder / "graph.yaml").write_text(to_yaml(ring(int(people > 1))), encoding="utf-8")
        behavior = graph_behavior.build(place, people, temperature=temperature)
        return made.replace(behavior=behavior, people=people)

    return {each: crowd(*each) for each in ((4, 0.0), (4, TEMPERATURE), (1, TEMPERATURE))}


def changed(scenario, theta):
    """The scenario with a weight, the costs of an edge, the stays, and the place of a node changed by theta (4,)."""
    graph = scenario.behavior.data.graph
    factor = jnp.ones(graph.edge_cost.shape).at[0, 1].set(jnp.exp(theta[1])).at[1, 0].set(jnp.exp(theta[1]))
    graph = rerouted(graph, graph.position + theta[3] * jnp.zeros_like(graph.position).at[1, 0].set(1.0), factor)
    weight = graph.weight * jnp.ones_like(graph.weight).at[1].set(jnp.exp(theta[0]))
    graph = graph.replace(weight=weight, stay=graph.stay + theta[2])
    data = scenario.behavior.data.replace(graph=graph)
    return scenario.replace(behavior=scenario.behavior.replace(data=data))


def episode(scenario, theta, key, steps: int = STEPS):
    """How much people are near node 1 in the second half, and the log of the chance of all choices."""
    crowd, state = changed(scenario, theta), begin_alone(scenario, key)
    mark = scenario.behavior.data.graph.position[1] + jnp.asarray([2.0, 0.0])  # beyond the node, which may move to it

    def one(state, _):
        after = stages.direct_pedestrians(crowd, state, jax.random.fold_in(state.streams.people, state.tick))
        after = replace(stages.move_pedestrians(crowd, after), tick=state.tick + 1)
        gap = after.pedestrians.position - mark[None]
        return after, jnp.mean(jnp.exp(-jnp.sum(gap**2, axis=1) / (2 * 3.0**2)))

    state, near = jax.lax.scan(one, state, length=steps)
    return jnp.mean(near[steps // 2 :]), state.memory.log_chance


# --- The chances ---


def test_drawn_stays_have_the_chances_that_are_told():
    """Frequencies of ticks against the chances, and these against the convolution by scipy."""
    limits, width, dt = np.array([2.0, 5.0]), 0.4, 0.1
    chance = np.random.default_rng(0).random((2, 40_000)).astype(np.float32)
    rows = jnp.broadcast_to(jnp.asarray(limits, jnp.float32), (40_000, 2))
    ticks, log_chance = jax.jit(graph_choices.sample_stay, static_argnums=3)(
        rows, jnp.asarray(chance), jnp.float32(width), dt
    )
    ticks, told = np.asarray(ticks), np.exp(np.asarray(log_chance))
    offset = np.linspace(*limits, 4001)
    wanted = np.array(
        [np.diff([scipy.stats.logistic.cdf((k - s) * dt, offset, width).mean() for s in (1, 0)])[0] for k in range(90)]
    )
    for k in range(10, 70):
        np.testing.assert_allclose(told[ticks == k], wanted[k], rtol=0.03)
    counted = np.bincount(ticks, minlength=90)[:90] / len(ticks)
    assert np.abs(np.cumsum(counted) - np.cumsum(np.concatenate([[counted[0]], wanted[1:]]))).max() < 0.015
    cold, _ = graph_choices.sample_stay(rows[:500], jnp.asarray(chance[:, :500]), jnp.float32(1e-6), dt)
    assert np.abs(np.asarray(cold) - np.ceil((2.0 + 3.0 * chance[0, :500]) / dt - 1e-4)).max() <= 1


def test_draws_by_scores_are_as_frequent_as_told_and_the_best_one_when_cold():
    score = jnp.asarray([[1.0, 2.5, np.inf, 1.4]], jnp.float32)
    chance = jnp.asarray(np.random.default_rng(1).random(20_000), jnp.float32)
    logs = graph_choices.log_chances(jnp.broadcast_to(score, (20_000, 4)), jnp.float32(0.7))
    index, told = jax.jit(graph_choices.sample)(logs, chance)
    wanted = np.exp(-np.array([1.0, 2.5, np.inf, 1.4]) / 0.7)
    wanted /= wanted.sum()
    np.testing.assert_allclose(np.bincount(np.asarray(index), minlength=4) / 20_000, wanted, atol=0.01)
    np.testing.assert_allclose(np.exp(np.asarray(told)), wanted[np.asarray(index)], rtol=1e-4)
    assert (np.asarray(index) != 2).all()
    cold = graph_choices.sample(
        graph_choices.log_chances(jnp.broadcast_to(score, (500, 4)), jnp.float32(1e-3)), chance[:500]
    )
    assert (np.asarray(cold[0]) == 0).all()


def test_expectation_has_the_derivative_of_an_expected_value():
    """Of a coin with chance p, and a value that depends on the coin and on p: d E / d p is known."""
    heads = jnp.asarray(np.random.default_rng(2).random(40_000) < 0.3)

    def expected(p):
        values = jnp.where(heads, 5.0 * p, 1.0 + p**2)
        return graph_choices.expectation(values, jnp.where(heads, jnp.log(p), jnp.log(1.0 - p)))

    value, slope = jax.value_and_grad(expected)(jnp.float32(0.3))
    np.testing.assert_allclose(value, 0.3 * 1.5 + 0.7 * 1.09, atol=0.01)
    exact = (1.5 - 1.09) + 0.3 * 5.0 + 0.7 * 0.6  # of p 5 p + (1 - p)(1 + p^2)
    np.testing.assert_allclose(slope, exact, atol=0.04)


# --- The program ---


@pytest.mark.slow
def test_without_a_temperature_nothing_is_kept_and_a_cold_one_chooses_the_cheapest_ways(crowds):
    still, warm = crowds[4, 0.0], crowds[1, TEMPERATURE]
    assert still.behavior.data.temperature is None
    assert jax.eval_shape(begin_alone, still, jax.random.key(0)).memory.log_chance is None
    data = warm.behavior.data

    @jax.jit
    def ways(key, temperature):
        tables = data.replace(temperature=temperature)
        crowd = warm.replace(behavior=warm.behavior.replace(data=tables))

        def one(state, _):
            after = stages.direct_pedestrians(crowd, state, jax.random.fold_in(state.streams.people, state.tick))
            there = after.pedestrians.replace(position=after.memory.target)  # at a node in every step
            return replace(after, pedestrians=there, tick=state.tick + 1), (after.memory.origin, after.memory)

        return jax.lax.scan(one, begin_alone(crowd, key), length=200)[1]

    graph, free = jax.tree.map(np.asarray, data.graph), {}
    for temperature in (1e-3, 5.0):
        origin, memory = jax.tree.map(np.asarray, ways(jax.random.key(3), jnp.float32(temperature)))
        moved = (memory.hop[1:] != memory.hop[:-1]) & (memory.stay[1:] == 0)
        cheapest = graph.next_hop[origin[1:], memory.goal[1:]] == memory.hop[1:]
        free[temperature] = 1.0 - cheapest[moved].mean()
        assert moved.sum() > 100 and np.isfinite(memory.log_chance).all() and (np.diff(memory.log_chance) <= 1e-4).all()
        assert np.isfinite(graph.edge_cost[origin[1:][moved], memory.hop[1:][moved]]).all()
    assert free[1e-3] == 0.0 < 0.05 < free[5.0]


@pytest.mark.night
def test_gradients_with_a_temperature_are_finite_and_both_modes_agree(crowds):
    warm, keys = crowds[4, TEMPERATURE], jax.random.split(jax.random.key(1), 3)

    def expected(theta):
        return graph_choices.expectation(*jax.vmap(lambda key: episode(warm, theta, key, 60))(keys))

    theta = jnp.zeros(4)
    backward = np.asarray(jax.jit(jax.grad(expected))(theta))
    forward = np.asarray(jax.jit(jax.jacfwd(expected))(theta))
    assert np.isfinite(backward).all() and np.abs(backward[[0, 1, 3]]).min() > 0
    np.testing.assert_allclose(backward, forward, rtol=1e-2, atol=1e-5)


def test_moved_nodes_take_their_places_and_costs_along(crowds):
    graph = crowds[4, 0.0].behavior.data.graph
    shift = np.random.default_rng(0).normal(0, 0.3, graph.position.shape).astype(np.float32)
    factor = np.random.default_rng(1).uniform(0.5, 2.0, graph.edge_cost.shape).astype(np.float32)
    same = rerouted(graph)
    for name in ("edge_cost", "cost", "next_hop", "places"):
        np.testing.assert_allclose(getattr(same, name), getattr(graph, name), rtol=1e-5)
    moved = jax.jit(rerouted)(graph, graph.position + shift, jnp.asarray(factor))
    gap = np.asarray(moved.position)[:, None] - np.asarray(moved.position)
    wanted = np.where(np.isfinite(graph.edge_cost), np.linalg.norm(gap, axis=-1) * factor, np.inf)
    np.testing.assert_allclose(moved.edge_cost, wanted, rtol=1e-4)
    np.testing.assert_allclose(
        moved.places - graph.places, np.broadcast_to(shift[:, None], graph.places.shape), atol=1e-5
    )


# --- Against central differences ---

KEYS = 1000
STEP = np.array([0.5, 0.12, 1.0, 0.25])  # of the differences, in which what is measured is nearly linear


def compared(scenario, keys, which: list[int], steps: int = STEPS) -> dict[str, np.ndarray]:
    """Derivatives by some of the four parameters with their standard errors, and the same of central differences."""
    number, ways = len(keys), jnp.asarray(np.eye(4)[which], jnp.float32)

    @jax.jit
    def slopes(keys):
        def one(key):
            run = functools.partial(episode, scenario, key=key, steps=steps)
            slope = jax.vmap(lambda way: jax.jvp(run, (jnp.zeros(4),), (way,))[1])(ways)
            return run(jnp.zeros(4))[0], *slope

        return jax.lax.map(one, keys, batch_size=250)

    @jax.jit
    def values(theta, keys):
        return jax.lax.map(lambda key: episode(scenario, theta, key, steps)[0], keys, batch_size=250)

    value, slope, slope_of_chance = (np.asarray(part, float) for part in slopes(keys))
    others = (value.sum() - value) / (number - 1)
    each = slope + (value - others)[:, None] * slope_of_chance
    shift = np.asarray(ways) * STEP[which][:, None]
    ahead, behind = (np.stack([np.asarray(values(sign * s, keys)) for s in shift], -1) for sign in (1.0, -1.0))
    differences = (ahead - behind) / (2 * STEP[which])
    return {
        "gradient": each.mean(0),
        "error": each.std(0) / np.sqrt(number),
        "choices held fixed": slope.mean(0),
        "difference": differences.mean(0),
        "its error": differences.std(0) / np.sqrt(number),
    }


@pytest.mark.night
@pytest.mark.parametrize(("people", "which"), [(4, [0, 1, 2]), (1, [0])])
def test_derivatives_of_choices_are_those_of_central_differences_over_a_thousand_keys(crowds, people, which):
    """By a node's weight, an edge's cost and the stays of a few people, and by a node's weight of one person."""
    found = compared(crowds[people, TEMPERATURE], jax.random.split(jax.random.key(7), KEYS), which)
    error = np.hypot(found["error"], found["its error"])
    assert (np.abs(found["gradient"] - found["difference"]) < 3 * error).all(), found
    assert (np.abs(found["difference"]) > 3 * found["its error"]).all(), found  # which are no noise
    assert np.abs(found["gradient"][0]) > 3 * found["error"][0], found
    assert found["choices held fixed"][0] == 0.0  # then a weight changes nothing


@pytest.mark.night
def test_derivatives_by_a_nodes_place_are_those_of_central_differences_over_a_thousand_keys(crowds):
    """Over 6 s: it acts through choices and through where people head for; later chaos makes both errors larger."""
    found = compared(crowds[4, TEMPERATURE], jax.random.split(jax.random.key(7), KEYS), [3], steps=60)
    error = np.hypot(found["error"], found["its error"])
    assert (np.abs(found["gradient"] - found["difference"]) < 3 * error).all(), found
    assert (np.abs(found["difference"]) > 3 * found["its error"]).all(), found
    assert (np.abs(found["gradient"]) > 3 * found["error"]).all(), found
