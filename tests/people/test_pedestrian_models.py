"""Pedestrian models: ORCA against its definition, scipy and RVO2, constant velocity, both in a step."""

import functools
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog, minimize

import sean_jax
from sean_jax.people.orca import smallest
from sean_jax.people.orca_solver import TOGETHER, VelocityProgram, best_velocity, half_plane
from sean_jax.people.pedestrian_models import MODELS
from sean_jax.studies.inverse_graph.measuring import begin_alone
from support import crowds, programs
from support.checkout import DATA
from support.quick import quick

LIMIT = 1.7
BATCH, PLANES = 250, 9
DIRECTIONS = np.stack([np.cos(np.arange(720) * np.pi / 360), np.sin(np.arange(720) * np.pi / 360)], -1)


def configurations(number, planes, seed, spread):
    """Random half-planes, of which the last two are walls that hold the zero velocity, and preferred velocities."""
    random = np.random.default_rng(seed)
    angle = random.uniform(0, 2 * np.pi, (number, planes))
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    c = random.normal(size=(number, planes)) * spread - 0.3
    c[:, -2:] = -np.abs(c[:, -2:])
    return normal, c, random.normal(size=(number, 2)) * 1.2


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, 0, 0, 0, 0, 0, None))
def best_velocities(*parts):
    return best_velocity(VelocityProgram(*parts))


def solve(normal, c, wanted, hard=None, limit=LIMIT):
    """Best velocities (K, 2), in batches of one size with half-planes that hold all velocities: one program for all."""
    number, planes = c.shape
    hard = np.broadcast_to(np.arange(planes) >= planes - 2 if hard is None else hard, c.shape)
    more = [(0, 0), (0, max(0, PLANES - planes))]
    columns = np.pad(normal[..., 0], more, constant_values=1.0), np.pad(normal[..., 1], more)
    columns = *columns, np.pad(c, more, constant_values=-1e6), np.pad(hard, more), *np.transpose(wanted)
    rows = [part if part.dtype == bool else part.astype(np.float32) for part in columns]
    begins = range(0, number, BATCH)
    batches = [[np.resize(part[k : k + BATCH], (BATCH, *part.shape[1:])) for part in rows] for k in begins]
    velocity = [np.stack(best_velocities(*batch, np.float32(limit)), -1) for batch in batches]
    return np.concatenate(velocity)[:number]


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
        assert mine_violates[-2:].max() < 2e-5  # walls are never violated
        assert mine_violates.max() < violation + 5e-5
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
    normals = np.tile([[1.0, 0.0], [-1.0, 0.0], [0.0, -1.0]], (2, 1, 1))
    bounds = np.array([[0.4, 0.6, -2.0], [0.4, 0.6, 0.0]])  # the last is eased by 0.5 like the others
    velocity = solve(normals, bounds, np.tile([0.2, 0.8], (2, 1)), hard=False, limit=1.5)
    np.testing.assert_allclose(velocity, [[-0.1, 0.8], [-0.1, 0.5]], atol=1e-3)


def least_violating(normal, c, hard, limit):
    """By trying all corners in float64: three borders that are eased by as much, or two and the top speed."""
    eased = np.where(hard, 0.0, 1.0)
    triples = np.array([k for k in combinations(range(len(c)), 3) if any(~hard[list(k)])])
    rows = np.c_[normal, eased][triples]
    meet = np.abs(np.linalg.det(rows)) > 1e-12
    corners = np.linalg.solve(rows[meet], c[triples][meet][..., None])[:, :2, 0]
    i, j = np.array([k for k in combinations(range(len(c)), 2) if any(~hard[list(k)])]).T
    way = eased[i][:, None] * normal[j] - eased[j][:, None] * normal[i]
    square = (way**2).sum(1)
    foot = way * ((eased[i] * c[j] - eased[j] * c[i]) / square)[:, None]
    half = np.sqrt(np.maximum(limit**2 - (foot**2).sum(1), 0) / square)[:, None] * np.stack([-way[:, 1], way[:, 0]], 1)
    fastest = limit * normal / np.linalg.norm(normal, axis=1)[:, None]
    corners = np.concatenate([corners, foot + half, foot - half, fastest])
    violation = c - corners @ normal.T
    allowed = (np.linalg.norm(corners, axis=1) < limit + 1e-6) & (np.where(hard, violation, -1).max(1) < 1e-9)
    most = np.where(allowed, np.where(hard, -np.inf, violation).max(1), np.inf)
    return corners[most.argmin()], most.min()


@pytest.mark.parametrize(("planes", "spread"), [(4, 1.0), (9, 3.0), (9, 12.0)])
def test_where_nothing_is_left_the_least_violating_velocity_is_that_of_all_corners(planes, spread):
    """Bounds of 12 m/s are those of discs that overlap."""
    normal, c, wanted = configurations(250, planes, 3, spread)
    normal, c = normal.astype(np.float32).astype(float), c.astype(np.float32).astype(float)
    hard, off = np.arange(planes) >= planes - 2, []
    for n, bound, v in zip(normal, c, solve(normal, c, wanted), strict=True):
        exact, violation = least_violating(n, bound, hard, float(np.float32(LIMIT)))
        if violation > 1e-4:
            assert np.where(hard, 0, bound - n @ v).max() < violation + 2e-5
            off.append(np.linalg.norm(v - exact))
    assert len(off) > 40
    assert np.quantile(off, 0.99) < 1e-3  # some are as good within float32, wherever along a border


@pytest.mark.parametrize("spread", [0.0, 0.7, 3.0])
def test_agents_in_one_program_have_the_velocities_of_agents_alone(spread):
    """With and without velocities in all half-planes: nobody, some and more than are searched at once, in batches."""
    normal, c, wanted = configurations(4 * 8 * TOGETHER[0], 9, 5, spread)
    alone = jax.jit(best_velocity)
    hard, limit = jnp.arange(9) >= 7, jnp.float32(LIMIT)
    columns = normal[..., 0], normal[..., 1], c, *wanted.T
    nx, ny, c, px, py = (jnp.asarray(part, jnp.float32) for part in columns)
    some = range(0, len(c), 16)
    each = [alone(VelocityProgram(nx[k], ny[k], c[k], hard, px[k], py[k], limit)) for k in some]
    nx, ny, c, px, py = (jnp.moveaxis(part.reshape(4, -1, *part.shape[1:]), 1, -1) for part in (nx, ny, c, px, py))

    def crowd(nx, ny, c, px, py):
        return best_velocity(VelocityProgram(nx, ny, c, hard, px, py, jnp.full_like(px, LIMIT)))

    together = np.stack(jax.jit(jax.vmap(crowd))(nx, ny, c, px, py), -1).reshape(-1, 2)
    np.testing.assert_allclose(together[::16], each, atol=2e-4)


def test_smallest_values_are_those_of_a_sort():
    """Among more and fewer values than asked for, with equal and infinite ones, in a batch."""
    random = np.random.default_rng(6)
    for number in (3, 8, 9, 62, 200):
        values = random.choice(np.linspace(0.0, 40.0, 3 * number), (2, number, 5)).astype(np.float32)
        values[random.uniform(size=values.shape) < 0.2] = np.inf
        found = np.asarray(jax.jit(jax.vmap(lambda values: smallest(values, 8)))(values))
        expected = np.argsort(values, 1, kind="stable")[:, :8]
        np.testing.assert_array_equal(
            np.sort(found, 1) if number <= 8 else found, np.sort(expected, 1) if number <= 8 else expected
        )


def test_faster_than_the_top_speed_is_out_of_reach_so_people_go_straight_away():
    """One disc that overlaps, or more on that side: limit n, whatever is preferred."""
    random = np.random.default_rng(4)
    angle = random.uniform(0, 2 * np.pi, 200)
    away = np.stack([np.cos(angle), np.sin(angle)], -1)
    for more in (0, 3):
        turned = angle[:, None] + np.c_[np.zeros(200), random.uniform(-1.5, 1.5, (200, more))]
        normal = np.stack([np.cos(turned), np.sin(turned)], -1)
        c = np.c_[random.uniform(LIMIT + 0.01, 12, 200), np.full((200, more), -3.0)]
        mine = solve(normal, c, random.normal(size=(200, 2)) * 1.2, hard=False)
        np.testing.assert_allclose(mine, LIMIT * away, atol=1e-3)  # 3e-7 m/s of violation
    alone = solve(np.array([[[1.0, 0.0]]]), np.array([[4.0]]), np.array([[0.0, 1.3]]), hard=False, limit=1.69)
    np.testing.assert_allclose(alone, [[1.69, 0]], atol=1e-6)


def same_as_rvo2(normal, c, hard, wanted, recorded):
    """Where velocities differ, those of RVO2, whose line of least violation is of float32, violate more."""
    mine = solve(normal, c, wanted, hard, 1.69)
    worst = [np.where(hard, 0, c - (normal * v[:, None]).sum(-1)).max(1) for v in (mine, recorded)]
    dense = worst[1] > 1e-4
    assert 0.3 < dense.mean() < 0.8
    assert (worst[0] < worst[1] + 2e-5).all()
    off = np.linalg.norm(mine - recorded, axis=-1)
    assert off[~dense].max() < 2e-4
    assert (off[dense] < 1e-4).mean() > 0.96
    assert off.max() < 0.05


def test_velocities_are_those_of_rvo2():
    recorded = np.loadtxt(DATA / "rvo2_states.csv", delimiter=",", skiprows=3)[:, 1:].reshape(-1, 9, 8)
    position, velocity, wanted, new = (recorded[..., k : k + 2].astype(np.float32) for k in (0, 2, 4, 6))
    others = np.array([[j for j in range(9) if j != i] for i in range(9)])
    gap, motion = position[:, others] - position[:, :, None], velocity[:, :, None] - velocity[:, others]
    run = jax.jit(half_plane, static_argnums=(4, 5, 6, 7))
    nx, ny, out = run(*(jnp.asarray(part[..., k]) for part in (gap, motion) for k in (0, 1)), 0.7, 3.0, 0.1, True)
    normal = np.stack([nx, ny], -1)
    c = (normal * velocity[:, :, None]).sum(-1) + 0.5 * np.asarray(out)
    flat = (part.reshape(-1, *part.shape[2:]) for part in (normal, c, np.zeros(c.shape, bool), wanted, new))
    same_as_rvo2(*flat)


def test_velocities_among_obstacles_are_those_of_rvo2():
    rows = np.loadtxt(DATA / "rvo2_programs.csv", delimiter=",", skiprows=3)
    programs = np.split(rows, np.flatnonzero(np.diff(rows[:, 0])) + 1)
    holds_all = np.tile([0, 0, 1, 0, -1e6, 0, 0, 0, 0.0], (max(map(len, programs)), 1))
    filled = np.stack([np.concatenate([rows, holds_all[len(rows) :]]) for rows in programs])
    assert filled[..., 1].any(1).all()
    same_as_rvo2(filled[..., 2:4], filled[..., 4], filled[..., 1] > 0, filled[:, 0, 5:7], filled[:, 0, 7:])


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
    start = jax.jit(begin_alone)(scenario, jax.random.key(0))
    people, _ = jax.jit(lambda start: crowds.walk(scenario, start, 300))(start)
    return scenario, start, jax.tree.map(np.asarray, people)


def test_people_keep_out_of_obstacles_and_walk_on(walked):
    scenario, _, people = walked
    assert np.isfinite(people.position).all()
    places = jnp.asarray(people.position.reshape(-1, 2))
    assert np.asarray(programs.clearance(scenario.environment, places)).min() >= 0.2 - 1e-3
    speed = np.linalg.norm(people.velocity, axis=-1)
    assert (speed.mean(0) > 0.7 * people.preferred_speed[0]).all()
    assert (speed <= 1.3 * people.preferred_speed + 1e-3).all()


def test_two_who_meet_pass_each_other_by_orca_and_walk_through_by_constant_velocity(walked):
    scenario, state, _ = walked
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
    scenario, start, _ = walked
    spot = start.pedestrians.position.at[1].set(start.pedestrians.position[0])

    def value(position):
        after = scenario.move(scenario, start.replace(pedestrians=start.pedestrians.replace(position=position)))
        return (after.position**2).sum()

    gradient = np.asarray(jax.jit(jax.grad(value))(spot))
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0


def test_a_model_that_is_not_there_or_not_used_is_refused():
    with pytest.raises(ValueError, match="did you mean 'orca'"):
        sean_jax.make(model="orka", dynamics="twin")
