"""The main job as its users run it: what the default run must show (slow)."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax.policies import go_to_goal
from sean_jax.world.environment import clearance
from support.commands import python

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of `sean run` with its defaults, but for the place of the results."""
    out = tmp_path_factory.mktemp("runs") / "default"
    python("-m", "sean_jax", "run", "--seed", 1, "--out", out)
    return out


@pytest.mark.night
def test_all_five_situations_occur(run):
    shares = json.loads((run / "summary.json").read_text())["situations"]
    assert set(shares) == {"cross_path", "down_path", "join_group", "leave_group", "empty"}
    for name, share in shares.items():
        assert share["mean"] >= 0.01, name


def test_nobody_is_inside_an_obstacle_and_groups_fill(run):
    checks = json.loads((run / "summary.json").read_text())["checks"]
    assert checks["largest_penetration_mm"] <= 1.0
    assert checks["largest_groups"] == [5, 3, 3]


def test_results_are_complete(run):
    names = {"config.yaml", "environment", "episodes.csv", "summary.json", "report.html", "episode.gif"}
    assert {path.name for path in run.iterdir()} == names
    rows = (run / "episodes.csv").read_text().splitlines()
    assert len(rows) == 65 and "nan" not in "".join(rows) and "inf" not in "".join(rows)


@pytest.mark.night
def test_episodes_in_mjx_are_those_of_its_twin():
    """Whole episodes with restarts among people: the same ends, and the same ways to rounding."""

    def evaluate(dynamics):
        scenario = sean_jax.make("lab", people=4, time_limit=30.0, dynamics=dynamics)
        return sean_jax.evaluate(scenario, "go_to_goal", episodes=4, batch=2, seed=1)

    twin, mjx = evaluate("twin"), evaluate("mjx")
    assert twin.completed.any()
    np.testing.assert_array_equal(twin.seconds, mjx.seconds)
    np.testing.assert_allclose(twin.metrics["path_length"], mjx.metrics["path_length"], atol=1e-3)


def test_a_minute_of_the_full_warehouse():
    """62 people for 60 s: nobody stuck, in an obstacle, or in somebody; groups fill again and again."""
    scenario = sean_jax.make()
    rollout = jax.jit(jax.vmap(lambda key: sean_jax.rollout(scenario, go_to_goal, key, 600)))
    _, frames = rollout(jax.random.split(jax.random.key(7), 8))
    people, group = np.asarray(frames.people), np.asarray(frames.group)
    everywhere = jnp.asarray(people.reshape(-1, 2))
    assert float(jax.jit(lambda p: clearance(scenario.environment, p))(everywhere).min()) >= 0.2 - 1e-3
    later = group[:, 200:]
    for index, capacity in enumerate((5, 3, 3)):
        members = (later == index).sum(-1)
        assert members.max() == capacity and members.mean() >= 0.3 * capacity
    apart = np.linalg.norm(people[:, ::10, :, None] - people[:, ::10, None], axis=-1) + 9 * np.eye(62)
    walking = group[:, ::10] < 0
    assert (apart.min(-1) < 0.3)[walking].mean() <= 1e-3
    moved = np.linalg.norm(people[:, 200:] - people[:, :-200], axis=-1)
    always_walking = (group[:, 200:] < 0) & (group[:, :-200] < 0)
    assert (moved < 0.05)[always_walking].mean() <= 1e-2
