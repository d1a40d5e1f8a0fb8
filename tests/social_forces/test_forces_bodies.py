"""Bodies: shoulders against exact ellipses, contact among strangers and within groups."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import social_forces
from sean_jax.social_forces import Contact, model
from sean_jax.social_forces.forces import look_direction
from support.forces import STEP, around, crowd, felt, pair_pushes, walk

CALIBRATED = social_forces.preset("calibrated")
RADIUS = 0.2  # m


def walking(depth):
    return social_forces.build(CALIBRATED.tree_replace({"walking.depth": depth, "walking.radius": RADIUS})).walking


def ellipse(angle, depth):
    """(..., 256, 2) m: the outline of bodies that look along angles [rad]."""
    turn = np.linspace(0, 2 * np.pi, 256, endpoint=False)
    along, across = depth * np.cos(turn), RADIUS * np.sin(turn)
    cosine, sine = np.cos(angle)[..., None], np.sin(angle)[..., None]
    return np.stack([cosine * along - sine * across, sine * along + cosine * across], -1)


def support(angle, way, depth):
    """(...) m, how far bodies that look along angles [rad] reach in the directions ``way`` [rad]."""
    normal = np.stack([np.cos(way), np.sin(way)], -1)
    return (ellipse(angle, depth) * normal[..., None, :]).sum(-1).max(-1)


def touching(own, other, way, depth):
    """(...) m, the distance at which two ellipses touch, the other in the direction ``way`` [rad]."""
    normals = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    both = support(own[:, None], normals, depth) + support(other[:, None], normals + np.pi, depth)
    facing = np.cos(way[:, None] - normals)
    return np.where(facing > 1e-3, both / np.maximum(facing, 1e-3), np.inf).min(1)


def radii(own, other, way, distance, depth):
    """(...) m, as ``model.pair_forces`` calls it."""
    dx, dy = -distance * np.cos(way), -distance * np.sin(way)
    return np.asarray(reach(walking(depth), *(np.asarray(each, np.float32) for each in (dx, dy, own, other))), float)


@jax.jit
def reach(walking, dx, dy, own, other):
    shapes = (walking.shape(jnp.cos(look), jnp.sin(look)) for look in (own, other))
    return walking.radii(dx, dy, tuple(map(jnp.add, *shapes)))


@pytest.mark.parametrize("depth", [0.16, 0.14])
def test_shoulders_reach_as_far_as_ellipses(depth):
    random = np.random.default_rng(0)
    own, other, way = random.uniform(0, 2 * np.pi, (3, 60))
    distance = random.uniform(0.1, 2.0, 60)
    exact = support(own, way, depth) + support(other, way + np.pi, depth)
    ours = radii(own, other, way, distance, depth)
    np.testing.assert_allclose(ours, exact, rtol=0.03)
    np.testing.assert_allclose(ours, touching(own, other, way, depth), rtol=0.06)
    assert ours.max() <= 2 * RADIUS * (1 + 1e-6) and ours.min() >= 2 * depth * (1 - 1e-4)
    np.testing.assert_allclose(radii(other, own, way + np.pi, distance, depth), ours, rtol=1e-5)
    np.testing.assert_allclose(radii(own, other, way, 3 * distance, depth), ours, rtol=1e-4)


def test_shoulders_of_people_behind_and_beside_one_another_are_exact():
    """Looks along one line: twice the depth behind one another, twice the radius side by side, the sum if crossed."""
    look = np.array([0.3, 0.3, 0.3, 0.3])
    other = look + [0.0, np.pi, 0.0, np.pi / 2]
    way = look + [0.0, 0.0, np.pi / 2, 0.0]
    exact = 2 * 0.16, 2 * 0.16, 2 * RADIUS, 0.16 + RADIUS
    np.testing.assert_allclose(radii(look, other, way, np.full(4, 0.5), 0.16), exact, rtol=1e-5)
    np.testing.assert_allclose(support(look, way, 0.16) + support(other, way, 0.16), exact, rtol=1e-4)


def throng(seed, people=12):
    random = np.random.default_rng(seed)
    return crowd(random.uniform(-1, 1, (people, 2)), random.normal(size=(people, 2)), random.normal(size=(people, 2)))


def test_a_depth_equal_to_the_radius_makes_discs():
    discs, ovals = (CALIBRATED.tree_replace({"walking.depth": depth}) for depth in (None, RADIUS))
    np.testing.assert_array_equal(radii(*np.ones((4, 3)), RADIUS), np.float32(2 * RADIUS))
    for seed in range(3):
        one, other = (walk(social_forces.build(forces), throng(seed), steps=10) for forces in (discs, ovals))
        np.testing.assert_allclose(one.position, other.position, atol=1e-5)
    narrow = walk(CALIBRATED.tree_replace({"walking.depth": 0.1}), throng(0), steps=10)
    assert np.abs(narrow.position - walk(discs, throng(0), steps=10).position).max() > 1e-3


@jax.jit
def pushed(forces, people, companions=None):
    """(N, 2) m/s2, pushes and acts of people who look along their headings."""
    pushes, acts = model.pair_forces(around(forces, people, companions=companions))
    return jnp.stack(pushes, -1), jnp.zeros((len(people.present), 2)) if acts is None else jnp.stack(acts, -1)


def side_by_side(gap):
    """Two at x = 0 and ``gap`` m who look along y, and walk."""
    return crowd([(0.0, 0.0), (gap, 0.0)], [(0.0, 1.0), (0.0, 1.0)])


def test_people_touch_with_their_shoulders_before_they_touch_with_their_chests():
    forces = social_forces.build([CALIBRATED.tree_replace({"walking.depth": 0.16}).walking, Contact(200.0)])
    beside = pair_pushes(forces, side_by_side(0.38))
    np.testing.assert_allclose(beside, [[-200 * 0.02, 0], [200 * 0.02, 0]], atol=1e-3)
    behind = crowd([(0.0, 0.0), (0.38, 0.0)], [(1.0, 0.0), (1.0, 0.0)])
    np.testing.assert_array_equal(pair_pushes(forces, behind), 0.0)
    nearer = replace(behind, position=jnp.array([[0.0, 0.0], [0.30, 0.0]]))
    np.testing.assert_allclose(pair_pushes(forces, nearer)[1], [200 * 0.02, 0.0], atol=1e-3)


@pytest.mark.parametrize("margin", [None, 0.0, 0.03, 0.08])
def test_bodies_begin_to_push_at_the_margin(margin):
    forces = social_forces.build([CALIBRATED.walking.replace(depth=None), Contact(150.0, margin=margin)])
    gaps = np.random.default_rng(0).uniform(-0.1, 0.2, 40)
    ours = [pair_pushes(forces, side_by_side(2 * RADIUS + gap))[1, 0] for gap in gaps]
    np.testing.assert_allclose(ours, 150.0 * np.maximum((margin or 0.0) - gaps, 0.0), atol=1e-3)
    assert float(forces.contact.cutoff(forces.walking)) == pytest.approx(2 * RADIUS + (margin or 0.0))


@pytest.mark.parametrize("speed", [0.0, 0.3, 0.6, 1.3])
def test_members_of_a_group_step_aside_while_they_walk_to_their_place(speed):
    """As if they were in no group; those who stand do not, and look along their heading."""
    velocity = [(speed, 0.0), (-1.3, 0.0)]
    heading = np.array([[0.6, 0.8], [-1.0, 0.0]], np.float32)
    people = crowd([(0.0, 0.0), (2.0, 0.1)], velocity, velocity, heading=heading, group=np.array([0, -1], np.int32))
    look = np.stack(look_direction(people), -1)
    strangers = replace(people, group=jnp.full(2, -1, jnp.int32))
    sideways = [float(walk(CALIBRATED, each).velocity[0, 0, 1]) / STEP for each in (people, strangers)]
    if speed < 0.5:
        np.testing.assert_allclose(look[0], heading[0], atol=1e-6)
        assert abs(sideways[0]) < 0.2
    else:
        np.testing.assert_allclose(look[0], [1.0, 0.0], atol=1e-6)
        assert sideways[0] == pytest.approx(sideways[1]) and sideways[0] < -0.3


TOGETHER = np.array([[1, -1], [0, -1]], np.int32)


@pytest.mark.parametrize("kind", ["standing", "walking"])
def test_within_a_group_there_is_contact_alone(kind):
    """Members who overlap push each other apart by their contact, and by nothing else; without overlap not at all."""
    label = dict(group=np.zeros(2, np.int32)) if kind == "standing" else dict(walking_group=np.zeros(2, np.int32))
    companions = None if kind == "standing" else jnp.asarray(TOGETHER)
    stiffness, reach = float(CALIBRATED.contact.stiffness), 0.4 + float(CALIBRATED.contact.margin)
    for gap in (0.3, 0.39, 0.41, 0.6):
        members = replace(side_by_side(gap), **{name: jnp.asarray(value) for name, value in label.items()})
        pushes, acts = pushed(CALIBRATED, members, companions)
        overlap = max(reach - gap, 0.0)
        np.testing.assert_allclose(pushes, stiffness * overlap * np.array([[-1, 0], [1, 0]]), atol=2e-2)
        assert overlap > 0.0 or not pushes.any()
        np.testing.assert_array_equal(acts, 0.0)
    strangers = pushed(CALIBRATED, side_by_side(0.6), companions)[0]
    assert strangers[1, 0] > 0.0
    if kind == "walking":  # without the term that keeps companions together they are as strangers
        loose = social_forces.build([term for term in CALIBRATED if term is not CALIBRATED.cohesion])
        members = replace(side_by_side(0.6), walking_group=jnp.zeros(2, jnp.int32))
        np.testing.assert_allclose(pushed(loose, members, companions)[0], strangers, rtol=1e-5)


def test_companions_ahead_are_no_reason_to_brake_or_to_step_aside():
    people = crowd([(0.0, 0.0), (0.9, 0.1)], [(1.4, 0.0), (0.7, 0.0)])
    members = replace(people, walking_group=jnp.zeros(2, jnp.int32))
    companions = jnp.asarray(TOGETHER)
    _, alone = pushed(CALIBRATED, people, companions)
    assert np.abs(alone[0]).max() > 0.1
    pushes, acts = pushed(CALIBRATED, members, companions)
    np.testing.assert_array_equal(acts, 0.0)
    np.testing.assert_array_equal(pushes, 0.0)


def test_who_overlap_within_a_standing_group_part():
    people = crowd([(0.0, 0.0), (0.25, 0.0)], np.zeros((2, 2)), preferred=[1.3, 1.3], group=np.zeros(2, np.int32))
    people = replace(people, heading=jnp.array([[0.0, 1.0], [0.0, 1.0]]))
    position = np.asarray(walk(CALIBRATED, people, steps=40).position)
    distance = np.linalg.norm(position[:, 1] - position[:, 0], axis=-1)
    assert (distance[-10:] > 0.38).all()
    np.testing.assert_allclose(position[-1].mean(0), [0.125, 0.0], atol=1e-4)


def test_pushes_of_bodies_are_not_bounded():
    """A crush presses harder than people accelerate on purpose."""
    people = side_by_side(0.2)
    after = walk(CALIBRATED, people)
    size = np.linalg.norm((after.velocity[0] - people.velocity) / STEP, axis=-1)
    assert size.min() > 3.0 * float(CALIBRATED.walking.acceleration)


def test_repulsion_of_the_surface_starts_at_the_bodies_and_stays_finite_in_large_ones():
    forces = social_forces.build([CALIBRATED.walking.replace(depth=None), CALIBRATED.repulsion])
    strength, reach = float(CALIBRATED.repulsion.strength), float(CALIBRATED.repulsion.range)
    for gap in (0.41, 0.5, 0.8):
        push = pair_pushes(forces, side_by_side(gap))
        size = strength * np.exp((float(CALIBRATED.repulsion.reach) + 0.4 - gap) / reach)
        np.testing.assert_allclose(push, size * np.array([[-1, 0], [1, 0]]), rtol=1e-3, atol=1e-5)
    large = social_forces.build(forces.tree_replace({"walking.radius": 10.0}))
    slope = jax.jit(jax.grad(lambda x: sum(felt(large, replace(side_by_side(0.5), position=x))[0] ** 2)))
    assert np.isfinite(slope(side_by_side(0.5).position)).all()
