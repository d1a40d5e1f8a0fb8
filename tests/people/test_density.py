"""Congestion against histograms and walks counted by hand, and its picture."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import drawing
from sean_jax.core.data_types import Trajectory
from sean_jax.drawing import colors
from sean_jax.people import density
from support import drawn

STEPS, PEOPLE = 57, 9


@pytest.fixture(scope="module")
def scenario(whole_scenario):
    """People walk along whole paths."""
    return whole_scenario


def frames_of(people: np.ndarray, present: np.ndarray) -> Any:
    """Frames (T, N, 2), (T, N) in which nothing but people is of interest."""
    none: Any = jnp.zeros(people.shape[:1])
    fields = dict.fromkeys(Trajectory.__dataclass_fields__, none)
    fields |= {"people": jnp.asarray(people, jnp.float32), "present": jnp.asarray(present), "active": none > 0}
    return Trajectory(**fields)


def wandering(scenario, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """People who jump about the floor and a little beyond, some of whom are absent at times."""
    draw = np.random.default_rng(seed)
    x0, y0, x1, y1 = np.asarray(scenario.environment.floor)
    people = draw.uniform((x0 - 1, y0 - 1), (x1 + 1, y1 + 1), (STEPS, PEOPLE, 2))
    return people.astype(np.float32), draw.random((STEPS, PEOPLE)) < 0.8


def test_density_is_a_histogram_that_keeps_everybody(scenario):
    people, present = wandering(scenario, 0)
    found = sean_jax.congestion(scenario, frames_of(people, present), span=2.0, cells=(8, 10))
    x0, y0, x1, y1 = np.asarray(scenario.environment.floor)
    inside = np.clip(people, (x0 + 1e-3, y0 + 1e-3), (x1 - 1e-3, y1 - 1e-3))
    np.testing.assert_allclose(found.time, [2.0, 4.0, 5.7], rtol=1e-6)
    area = (x1 - x0) * (y1 - y0) / 80
    for span, begin in enumerate((0, 20, 40)):
        at, there = inside[begin : begin + 20], present[begin : begin + 20]
        counted = np.histogram2d(at[there][:, 1], at[there][:, 0], (8, 10), ((y0, y1), (x0, x1)))[0]
        np.testing.assert_allclose(found.density[span], counted / len(at) / area, rtol=1e-5)
        assert float(found.density[span].sum() * area) == pytest.approx(there.sum(1).mean(), rel=1e-5)


def test_a_walk_is_from_one_node_to_the_next(scenario):
    graph = scenario.behavior.data.graph
    number = {name: index for index, name in enumerate(graph.names)}
    at = np.asarray(graph.position)
    far = np.array([-19.0, -19.0])  # at no node
    a, b, c = (at[number[name]] for name in ("tables_2", "tables_3", "tables_4"))
    walks = [
        [a, a, (a + b) / 2, b, b, (b + c) / 2, c],  # two edges, in the first and in the second span
        [c, far, far, b, b + [0.5, 0.5], b, far],  # back by one of them, and lingers
        [a, far, far, c, c, c, c],  # no edge joins these two
        [a, far, far, far, far, b, b],  # was away in between
        [far, far, b, far, far, far, b],  # comes from nowhere and returns to where it was
    ]
    people = np.stack(walks, 1)
    present = np.ones(people.shape[:2], bool)
    present[2, 3] = False
    run = jax.jit(lambda scenario, frames: sean_jax.congestion(scenario, frames, span=0.4, cells=(4, 4)))
    found = run(scenario, frames_of(people, present))
    wanted = np.zeros((2, 15, 15))
    u, v, w = (number[name] for name in ("tables_2", "tables_3", "tables_4"))
    wanted[0, u, v], wanted[0, w, v], wanted[1, v, w] = 1, 1, 1
    np.testing.assert_allclose(found.flow, wanted / np.array([0.4, 0.3])[:, None, None] * 60, rtol=1e-5)


def test_batches_equal_their_episodes(scenario):
    both = [frames_of(*wandering(scenario, seed)) for seed in (1, 2)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *both)
    together = sean_jax.congestion(scenario, batch)
    for index, frames in enumerate(both):
        alone = sean_jax.congestion(scenario, frames)
        for one, row in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_allclose(one, row[index], rtol=1e-6, atol=1e-6)
    assert together.density.shape == (2, 1, *density.grid_shape(scenario.environment)) == (2, 1, 80, 80)


def test_what_cannot_be_counted_is_said(scenario):
    frames = frames_of(*wandering(scenario, 0))
    with pytest.raises(ValueError, match=r"span: 0.01 s is shorter than the control step of 0.1 s"):
        sean_jax.congestion(scenario, frames, span=0.01)
    with pytest.raises(ValueError, match=r"cells: are needed where the scenario is traced; give \(rows, columns\)"):
        jax.jit(sean_jax.congestion)(scenario, frames)


def test_without_a_graph_there_is_density_alone(scenario):
    behavior = scenario.behavior.replace(data=())
    found = sean_jax.congestion(scenario.replace(behavior=behavior), frames_of(*wandering(scenario, 0)), cells=(2, 2))
    assert found.flow.shape == (1, 0, 0) and float(found.density.sum()) > 0


def test_bands_lie_right_of_the_way_and_narrow_with_less_flow():
    flow = np.zeros((3, 3))
    flow[0, 1] = 6.0  # from (-3, 0) to (3, 0): its right is below
    figure = drawing.congestion_map(drawn.environment(), np.zeros((10, 12)), graph=drawn.Graph, flow=flow)
    assert drawn.shade_at(figure, 0.0, -0.15) != colors.FLOOR
    assert drawn.shade_at(figure, 0.0, 0.15) == colors.FLOOR
    flow[1, 0] = 60.0
    figure = drawing.congestion_map(drawn.environment(), np.zeros((10, 12)), graph=drawn.Graph, flow=flow)
    assert drawn.shade_at(figure, 0.0, 0.15) != colors.FLOOR
    assert drawn.shade_at(figure, 0.0, -0.15) == colors.FLOOR
    assert "60 people a minute" in [text.get_text() for text in figure.axes[0].texts]
    alone = drawing.congestion_map(drawn.environment(), np.ones((10, 12)))
    assert "people per m²" in [text.get_text() for text in alone.axes[0].texts]
