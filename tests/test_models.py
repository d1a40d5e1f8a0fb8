"""Pedestrian models: ORCA against its definition and linear programmes of scipy, constant velocity, both in a step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick import quick
from scipy.optimize import linprog, minimize

import sean_jax
from sean_jax.environment import clearance
from sean_jax.pedestrian_models import MODELS
from sean_jax.pedestrian_models.orca import best_velocity, half_plane
from sean_jax.policies import go_to_goal

LIMIT = 1.7
DIRECTIONS = np.stack([np.cos(np.arange(720) * np.pi / 360), np.sin(np.arange(720) * np.pi / 360)], -1)


def configurations(number, planes, seed, spread):
    """Random half-planes, of which the last two are walls that hold the zero velocity, and preferred velocities."""
    random = np.random.default_rng(seed)
    angle = random.uniform(0, 2 * np.pi, (number, planes))
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    c = random.normal(size=(number, planes)) * spread - 0.3
    c[:, -2:] = -np.abs(c[:, -2:])
    return normal, c, random.normal(size=(number, 2)) * 1.2


def solve(normal, c, wanted):
    hard = np.arange(c.shape[1]) >= c.shape[1] - 2
    run = jax.jit(jax.vmap(best_velocity, in_axes=(0, 0, 0, None, 0, 0, None)))
    given = (jnp.asarray(part, jnp.float32) for part in (normal[..., 0], normal[..., 1], c))
    wanted = jnp.asarray(wanted, jnp.float32)
    return np.stack(run(*given, jnp.asarray(hard), wanted[:, 0], wanted[:, 1], jnp.float32(LIMIT)), -1)


def least_violation(normal, c):
    """By linear programming over the velocity and the violation, the disc of speeds being a polygon around it."""
    soft = (np.arange(len(c)) < len(c) - 2).astype(float)
    rows = np.concatenate([np.c_[-normal, -soft], np.c_[DIRECTIONS, np.zeros(len(DIRECTIONS))]])
    most = np.concatenate([-c, np.full(len(DIRECTIONS), LIMIT)])
    found = linprog([0, 0, 1], rows, most, bounds=[(None, None), (None, None), (0, None)])
    assert found.status == 0
    return found.fun


def test_best_velocities_equal_those_of_a_general_solver():
    normal, c, wanted = configurations(120, 9, 0, 0.9)
    mine = solve(normal, c, wanted)
    feasible = 0
    for n, bound, want, v in zip(normal, c, wanted, mine, strict=True):
        assert np.linalg.norm(v) <= LIMIT + 1e-4
        violation = least_violation(n, bound)
        mine_violates = np.maximum(bound - n @ v, 0)
        assert mine_violates[-2:].max() < 1e-3  # walls are never violated
        assert mine_violates.max() < violation + 3e-3
        if violation > 1e-6:
            continue
        feasible += 1
        constraints = [
            {"type": "ineq", "fun": lambda v, n=n, bound=bound: n @ v - bound},
            {"type": "ineq", "fun": lambda v: LIMIT**2 - v @ v},
        ]
        begin = linprog([0, 0], -n, -bound, bounds=[(None, None)] * 2).x
        exact = minimize(lambda v, w=want: (v - w) @ (v - w), begin, constraints=constraints, method="SLSQP")
        if exact.success:
            assert np.linalg.norm(v - want) == pytest.approx(np.linalg.norm(exact.x - want), abs=2e-3)
    assert 20 < feasible < 100


def test_between_two_who_come_from_opposite_sides_people_go_on_as_they_would_along_the_gap():
    """Both half-planes are violated by as much, wherever along the gap; the third leaves all of it or not."""
    normals = jnp.asarray([[1.0, 0.0], [-1.0, 0.0], [0.0, -1.0]], jnp.float32)
    hard = jnp.zeros(3, bool)
    for third, wanted in ((-2.0, 0.8), (0.0, 0.5)):  # eased by 0.5 like the others
        bounds = jnp.asarray([0.4, 0.6, third], jnp.float32)
        x, y = best_velocity(*normals.T, bounds, hard, jnp.float32(0.2), jnp.float32(0.8), jnp.float32(1.5))
        np.testing.assert_allclose([x, y], [-0.1, wanted], atol=1e-3)


def touches(d, v, reach, horizon):
    """Whether a disc moved by v s [m] comes nearer than ``reach`` to the one at d, for any 0 <= s <= horizon."""
    moment = np.clip((v @ d) / np.maximum((v * v).sum(-1), 1e-12), 0, horizon)
    return np.linalg.norm(d - moment[..., None] * v, axis=-1) < reach


def test_half_planes_lead_the_shortest_way_out_of_the_velocity_obstacle():
    random = np.random.default_rng(1)
    reach, horizon, count = 0.5, 3.0, 60
    d = random.uniform(-4, 4, (count, 2))
    v = random.normal(size=(count, 2)) * 1.2
    apart = np.linalg.norm(d, axis=-1) > reach + 0.02
    d, v = d[apart], v[apart]
    run = jax.jit(jax.vmap(half_plane, in_axes=(0, 0, 0, 0, None, None, None, None)))
    columns = (jnp.asarray(part, jnp.float32) for part in (d[:, 0], d[:, 1], v[:, 0], v[:, 1]))
    nx, ny, out = (np.asarray(part, float) for part in run(*columns, jnp.float32(reach), horizon, 0.1, jnp.bool_(True)))
    assert (np.sign(out) == np.where(touches_each(d, v, reach, horizon), 1, -1)).all()
    normal = np.stack([nx, ny], -1)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, atol=1e-5)
    for one, way, n, u in zip(d, v, normal, out, strict=True):
        inside = u > 0
        # just across the border it is the other way round, and no shorter way in any direction is
        assert touches(one, way + (u + 2e-3) * n, reach, horizon) == (
            False if inside else touches(one, way, reach, 3.0)
        )
        assert touches(one, way + (u - 2e-3) * n, reach, horizon)
        around = way + 0.98 * abs(u) * DIRECTIONS
        assert (touches(one, around, reach, horizon) == inside).all()


def touches_each(d, v, reach, horizon):
    return np.array([touches(one, way, reach, horizon) for one, way in zip(d, v, strict=True)])


def test_discs_that_overlap_or_coincide_part():
    one = jnp.ones((), jnp.float32)
    for d, first, sign in (((0.2, 0.0), True, -1), ((0.0, 0.0), True, -1), ((0.0, 0.0), False, 1)):
        nx, ny, out = half_plane(d[0] * one, d[1] * one, 0 * one, 0 * one, 0.5 * one, 3.0, 0.1, jnp.bool_(first))
        assert (float(nx), float(ny)) == (sign, 0.0)
        assert float(out) == pytest.approx((0.5 - d[0]) / 0.1, rel=1e-4)


@pytest.fixture(scope="module", params=quick(["orca", "constant_velocity"]))
def walked(request):
    scenario = sean_jax.make(behavior="random", task="random_ab_nav", people=10, model=request.param, dynamics="twin")
    run = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, 300))
    return scenario, *run(jax.random.key(0))


def test_people_keep_out_of_obstacles_and_walk_on(walked):
    scenario, last, frames = walked
    people = np.asarray(frames.people)
    assert np.isfinite(people).all()
    assert np.asarray(clearance(scenario.environment, jnp.asarray(people.reshape(-1, 2)))).min() >= 0.2 - 1e-3
    speed = np.linalg.norm(np.asarray(frames.people_velocity), axis=-1)
    assert (speed.mean(0) > 0.7 * np.asarray(last.pedestrians.preferred_speed)).all()
    assert (speed <= 1.3 * np.asarray(last.pedestrians.preferred_speed) + 1e-3).all()


def test_two_who_meet_pass_each_other_by_orca_and_walk_through_by_constant_velocity(walked):
    scenario, last, _ = walked
    state = last.replace(robot=last.robot.replace(position=jnp.asarray([-18.0, -18.0], jnp.float32)))
    open_place = np.array([12.0, 0.0])
    spots = np.array([[x, y] for x in (-19.0, 19.0) for y in np.linspace(-19, 19, 5)])
    spots[:2] = open_place + [[-3.0, 0.0], [3.0, 0.0]]
    desired = np.zeros((10, 2))
    desired[:2] = [[1.2, 0.0], [-1.2, 0.0]]
    people = state.pedestrians.replace(
        position=jnp.asarray(spots, jnp.float32),
        velocity=jnp.asarray(desired, jnp.float32),
        desired_velocity=jnp.asarray(desired, jnp.float32),
        preferred_speed=jnp.full(10, 1.2, jnp.float32),
    )

    def one(people, _):
        after = scenario.move(scenario, state.replace(pedestrians=people))
        return after, after.position[:2]

    places = np.asarray(jax.jit(lambda people: jax.lax.scan(one, people, length=50))(people)[1])
    gap = np.linalg.norm(places[:, 0] - places[:, 1], axis=-1).min()
    assert places[-1, 0, 0] > open_place[0] + 2 and places[-1, 1, 0] < open_place[0] - 2
    if scenario.move is MODELS["orca"]:
        assert 0.49 < gap < 0.8
        middle = places[len(places) // 2]
        np.testing.assert_allclose(middle[0] - open_place, -(middle[1] - open_place), atol=0.05)  # they share it
    else:
        assert gap < 0.13


def test_gradients_are_finite_even_for_people_at_one_place(walked):
    scenario, last, _ = walked
    spot = last.pedestrians.position.at[1].set(last.pedestrians.position[0])

    def value(position):
        after = scenario.move(scenario, last.replace(pedestrians=last.pedestrians.replace(position=position)))
        return (after.position**2).sum()

    gradient = np.asarray(jax.jit(jax.grad(value))(spot))
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0


def test_a_model_that_is_not_there_or_not_used_is_refused():
    with pytest.raises(ValueError, match="did you mean 'orca'"):
        sean_jax.make(model="orka", dynamics="twin")
