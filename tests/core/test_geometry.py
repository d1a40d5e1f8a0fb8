"""Plane geometry and the grid of obstacles, against brute force in double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.core import geometry
from sean_jax.core.data_types import FAR, Obstacles
from sean_jax.core.devices import by_platform
from sean_jax.core.geometry import REACH, build_obstacle_grid, nearby_obstacles


def draw_boxes(random, number, widest=2.0):
    """(center, half extent, yaw) in float64, each exactly a float32."""
    parts = random.uniform(-4, 4, (number, 2)), random.uniform(0.05, widest, (number, 2)), random.uniform(-9, 9, number)
    return tuple(part.astype(np.float32).astype(np.float64) for part in parts)


def as_boxes(center, half, yaw):
    parts = (jnp.asarray(part, jnp.float32) for part in (center, half, yaw, np.ones(len(yaw))))
    return Obstacles(*parts)


def outline(half, yaw, center, each=4000):
    """Points of one box's boundary, and the outer normal at each, both (4 * each, 2)."""
    t = np.linspace(-1, 1, each)
    u = np.concatenate([t * half[0], t * half[0], np.full(each, half[0]), np.full(each, -half[0])])
    v = np.concatenate([np.full(each, half[1]), np.full(each, -half[1]), t * half[1], t * half[1]])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.stack([u, v], -1) @ turn.T + center


def inside(points, half, yaw, center):
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return (np.abs((points - center) @ turn) < half).all(-1)


def test_from_box_equals_the_nearest_of_many_boundary_points():
    random = np.random.default_rng(0)
    boxes = draw_boxes(random, 40)
    points = (boxes[0] + random.uniform(-1.5, 1.5, (40, 2))).astype(np.float32).astype(np.float64)
    far, nx, ny = jax.jit(geometry.from_box)(*jnp.asarray(points.T, jnp.float32), as_boxes(*boxes))
    within = 0
    for k, point in enumerate(points):
        center, half, yaw = (part[k] for part in boxes)
        edge = outline(half, yaw, center)
        gaps = np.linalg.norm(edge - point, axis=1)
        inner = inside(point, half, yaw, center)
        within += int(inner)
        assert far[k] == pytest.approx(-gaps.min() if inner else gaps.min(), abs=2e-3)
        foot = point - float(far[k]) * np.array([nx[k], ny[k]])  # where the normal leads is on the boundary
        assert np.linalg.norm(edge - foot, axis=1).min() < 2e-3
        assert np.hypot(nx[k], ny[k]) == pytest.approx(1.0, abs=1e-5)
        assert inside(foot - 0.004 * np.array([nx[k], ny[k]]), half, yaw, center)  # and it points out
    assert 8 < within < 32


def test_from_rectangle_by_its_sides_and_corners():
    """In double precision: the nearest of four sides inside, a side or a corner outside. The normal is a gradient."""
    random = np.random.default_rng(1)
    center, half, yaw = draw_boxes(random, 400)
    local = random.uniform(-2.0, 2.0, (400, 2)) * half
    local[:100] = random.uniform(-1.0, 1.0, (100, 2)) * half[:100]  # inside
    ahead, left = np.stack([np.cos(yaw), np.sin(yaw)]), np.stack([-np.sin(yaw), np.cos(yaw)])

    def exact(local):
        beyond = np.abs(local) - half
        return np.where((beyond < 0).all(1), beyond.max(1), np.hypot(*np.maximum(beyond, 0.0).T))

    x, y = center.T + ahead * local[:, 0] + left * local[:, 1]
    parts = (jnp.asarray(part, jnp.float32) for part in (x, y, *center.T, *half.T, *ahead))
    far, nx, ny = (np.asarray(part, float) for part in jax.jit(geometry.from_rectangle)(*parts))
    np.testing.assert_allclose(far, exact(local), atol=2e-5)
    step = 1e-6
    along_u, along_v = ((exact(local + d) - exact(local - d)) / (2 * step) for d in step * np.eye(2))
    clear = np.abs(np.hypot(along_u, along_v) - 1.0) < 1e-3  # not where two sides are as near
    assert clear.mean() > 0.95 and (far < 0).sum() > 80
    np.testing.assert_allclose(nx[clear], (ahead[0] * along_u + left[0] * along_v)[clear], atol=2e-3)
    np.testing.assert_allclose(ny[clear], (ahead[1] * along_u + left[1] * along_v)[clear], atol=2e-3)


def test_distance_by_hand():
    box = as_boxes(np.array([[1.0, 2.0]]), np.array([[2.0, 1.0]]), np.array([0.0]))
    places = {(1, 2): -1.0, (2.5, 2): -0.5, (3, 2.5): 0.0, (3, 3): 0.0, (4, 2): 1.0, (6, 7): 5.0, (1, -2): 3.0}
    for (x, y), expected in places.items():
        assert float(geometry.from_box(jnp.float32(x), jnp.float32(y), box)[0][0]) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("radius", [0.0, 0.16, 0.6])
def test_crosses_box_equals_dense_samples_along_the_way(radius):
    """Cases that touch by less than a millimetre or miss by as little are left out: samples cannot tell."""
    random = np.random.default_rng(2)
    number = 1500
    center, half, yaw = draw_boxes(random, number, 1.5)
    p, q = ((center + random.uniform(-4, 4, (number, 2))).astype(np.float32).astype(np.float64) for _ in range(2))
    q[:100] = p[:100]  # no motion
    yaw[100:350], q[100:350, 0] = 0.0, p[100:350, 0]  # parallel to a side
    hit = np.asarray(jax.jit(geometry.crosses_box)(*jnp.asarray(np.concatenate([p, q], 1).T, jnp.float32),
                                                    as_boxes(center, half, yaw), radius))  # fmt: skip
    along = np.linspace(0, 1, 4001)[:, None]
    clear = 0
    for k in range(number):
        way = p[k] + along * (q[k] - p[k]) - center[k]
        local = way @ np.array([[np.cos(yaw[k]), -np.sin(yaw[k])], [np.sin(yaw[k]), np.cos(yaw[k])]])
        over = np.abs(local) - half[k]
        far = np.where((over < 0).all(1), over.max(1), np.linalg.norm(np.maximum(over, 0), axis=1)).min()
        if abs(far - radius) > 2e-3:
            assert hit[k] == (far < radius), (k, far, p[k], q[k], center[k], half[k], yaw[k])
            clear += 1
    assert clear > 0.95 * number and 0.1 < hit.mean() < 0.9


def test_sum_vectors_is_a_sum():
    x, y = np.random.default_rng(3).normal(size=(2, 5, 7)).astype(np.float32)
    for axis in (0, 1):
        sums = geometry.sum_vectors(jnp.asarray(x), jnp.asarray(y), axis)
        np.testing.assert_allclose(sums[0], x.sum(axis), rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(sums[1], y.sum(axis), rtol=1e-5, atol=1e-6)
    assert sums[0].dtype == jnp.float32


def test_angle_between_and_rotate():
    angles = np.linspace(-np.pi, np.pi, 73)
    first = np.random.default_rng(4).uniform(-np.pi, np.pi, 73)
    a = jnp.asarray(np.stack([np.cos(first), np.sin(first)], -1), jnp.float32)
    b = jnp.asarray(2.5 * np.stack([np.cos(first + angles), np.sin(first + angles)], -1), jnp.float32)
    found = np.asarray(geometry.angle_between(a, b))
    assert np.abs(np.angle(np.exp(1j * (found - angles)))).max() < 1e-5
    x, y = geometry.rotate(a[:, 0], a[:, 1], jnp.cos(jnp.asarray(angles, jnp.float32)),
                           jnp.sin(jnp.asarray(angles, jnp.float32)))  # fmt: skip
    np.testing.assert_allclose(2.5 * np.stack([x, y], -1), b, atol=1e-5)
    right, left = jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0])
    assert float(geometry.angle_between(right, left)) == pytest.approx(np.pi / 2)
    assert float(geometry.angle_between(right, -right)) == pytest.approx(np.pi)
    assert float(geometry.angle_between(right, jnp.zeros(2))) == 0.0


def test_unit_vectors():
    vectors = jnp.array([[3.0, 4.0], [0.0, 0.0], [0.0, -1e-3], [-2e4, 0.0], [1e-20, 0.0]])
    otherwise = jnp.broadcast_to(jnp.array([0.6, 0.8]), (5, 2))
    expected = [[0.6, 0.8], [0.6, 0.8], [0, -1], [-1, 0], [0.6, 0.8]]
    np.testing.assert_allclose(geometry.unit_vectors(vectors, otherwise), expected, atol=1e-6)


TINY = (0.0, 1e-30, 1e-22, 1e-16, 1e-13, 1e-10, 1e-3)  # squares of them underflow, and cubes of their inverses overflow


@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2])
def test_gradients_of_lengths_and_angles_are_finite_at_and_near_zero(angle):
    x, y = jnp.asarray(np.outer([np.cos(angle), np.sin(angle)], TINY), jnp.float32)

    def functions(x, y):
        one, some = jnp.array([0.8, 0.6]), jnp.stack([x, y])
        kept = geometry.unit_vectors(some, one)
        yield geometry.length(x, y)
        yield from geometry.unit(x, y)
        yield from (kept[0], kept[1], geometry.angle_between(one, some), geometry.angle_between(some, one))

    def total(x, y, weights):
        return sum(weight * value for weight, value in zip(weights, functions(x, y), strict=True))

    both = jax.jit(jax.vmap(jax.value_and_grad(total, (0, 1)), in_axes=(0, 0, None)))
    for weights in (*np.eye(7, dtype=np.float32), np.zeros(7, np.float32)):
        value, slope = both(x, y, jnp.asarray(weights))
        assert np.isfinite(value).all() and np.isfinite(slope).all(), weights
        if not weights.any():
            np.testing.assert_array_equal(np.asarray(slope), 0.0)
    assert float(jax.grad(geometry.length)(0.0, 0.0)) == 0.0


def test_gradients_of_the_distance_from_a_box():
    """Finite on the surface, at a corner and in the middle, for a thin wall too; elsewhere it is the normal."""
    half = jnp.array([[1.0, 0.5], [0.5, 0.5], [0.0, 2.0]])
    box = Obstacles(center=jnp.zeros((3, 2)), half_extent=half, yaw=jnp.zeros(3), height=jnp.ones(3))
    spots = [(0, 0), (1, 0), (0, 0.5), (1, 0.5), (-1, -0.5), (0.5, 0.5), (0, 2), (1e-14, 0.3), (1e-20, 0.3), (0, 2.1)]

    def distance_and_normal(x, y, part):
        return jnp.concatenate(geometry.from_box(x, y, jax.tree.map(lambda leaf: leaf[None], part)))

    @jax.jit
    @jax.vmap
    def slopes(x, y, part):
        """(2, 3): by x and y."""
        return jnp.stack(jax.jacrev(distance_and_normal, (0, 1))(x, y, part)), distance_and_normal(x, y, part)[1:]

    random = draw_boxes(np.random.default_rng(5), 30)
    free = random[0] + np.random.default_rng(6).uniform(-2, 2, (30, 2))
    rows = np.concatenate([np.repeat(spots, 3, 0), free]).astype(np.float32)
    boxes = jax.tree.map(lambda few, more: np.concatenate([*[few] * len(spots), more]), box, as_boxes(*random))
    slope, normal = map(np.asarray, slopes(*rows.T, boxes))
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(slope[-30:, :, 0], normal[-30:], atol=1e-4)


def test_around_holds_every_obstacle_within_reach():
    random = np.random.default_rng(7)
    center, half, yaw = draw_boxes(random, 30, 1.0)
    center = center * 3
    floor = jnp.array([-10.0, -8.0, 11.5, 9.25])
    table = build_obstacle_grid(as_boxes(center, half, yaw), floor)
    low, high = np.asarray(floor[:2]), np.asarray(floor[2:])
    points = random.uniform(low, high, (400, 2)).astype(np.float32)
    points[:4] = [low, high, [low[0], high[1]], (low + high) / 2]
    rows = np.asarray(jax.jit(nearby_obstacles)(table, jnp.asarray(points[:, 0]), jnp.asarray(points[:, 1])))
    assert rows.shape[1] < 30  # or the table would be no use
    felt = 0
    for point, found in zip(points, rows, strict=True):
        here = {tuple(np.round(row[:2], 4)) for row in found}
        for k in range(30):
            turn = np.array([[np.cos(yaw[k]), -np.sin(yaw[k])], [np.sin(yaw[k]), np.cos(yaw[k])]])
            gap = np.linalg.norm(np.maximum(np.abs((point - center[k]) @ turn) - half[k], 0))
            if gap < REACH:
                felt += 1
                assert tuple(np.round(center[k].astype(np.float32), 4)) in here
                assert (
                    np.abs(found - np.float32([*center[k], *half[k], np.cos(yaw[k]), np.sin(yaw[k])])).max(1).min()
                    < 1e-6
                )
    assert felt > 400
    away = np.unique(rows[..., 0][rows[..., 0] >= FAR])
    np.testing.assert_array_equal(away, [FAR])


def test_around_off_the_grid_and_without_obstacles():
    boxes = as_boxes(np.array([[-9.0, -9.0], [9.0, 9.0]]), np.ones((2, 2)), np.zeros(2))
    table = build_obstacle_grid(boxes, jnp.array([-10.0, -10.0, 10.0, 10.0]))
    rows = nearby_obstacles(table, jnp.array([-50.0, 50.0]), jnp.array([-50.0, 12.0]))
    np.testing.assert_allclose(rows[:, 0, 0], [-9, 9])
    none = build_obstacle_grid(
        as_boxes(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)), jnp.array([0.0, 0.0, 2.0, 2.0])
    )
    rows = nearby_obstacles(none, jnp.array([1.0]), jnp.array([1.0]))
    assert rows.shape == (1, 1, 6) and float(rows[0, 0, 0]) == FAR


def test_a_function_in_two_forms_differentiates_as_the_first():
    function = by_platform(lambda x, k: (k * x * x).sum(), lambda x, k: k * jnp.dot(x, x))
    x = jnp.arange(3, dtype=jnp.float32)
    k = jnp.float32(2.0)
    assert jax.jit(function)(x, k) == 10.0 == jax.vmap(function, (0, None))(x[None], k)[0]
    np.testing.assert_array_equal(jax.grad(function)(x, k), 4.0 * x)
    np.testing.assert_array_equal(jax.jacfwd(function)(x, k), 4.0 * x)
