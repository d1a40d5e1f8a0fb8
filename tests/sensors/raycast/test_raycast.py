"""Rays against MuJoCo's own, the gradients of distances, and what tiles leave out."""

import os
import re
import sys
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax.core import gpu_kernels
from sean_jax.sensors import raycast
from sean_jax.sensors.raycast import intersect, kernel
from sean_jax.sensors.raycast.view import HEAD, SHOULDER
from sean_jax.world import environment
from support.commands import cpu_devices, python
from support.programs import lowered_for_gpu
from support.quick import quick
from support.rays import RADIUS, cluttered, mujoco_distances, yard


@pytest.mark.parametrize("name", quick(["warehouse", "lab", "outdoor"], "warehouse"))
def test_equal_to_mujoco(name):
    """12,288 random rays in each environment, from where there are no people nearer than a step."""
    random = np.random.default_rng(1)
    scene = environment.load(name)
    number = 12 if name == "lab" else 62
    people = environment.free_points(scene, 0.3, number, seed=3)
    mount = np.array([0.05, 0.02, 0.0])
    across = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 64), np.linspace(0.9, -0.9, 48)), -1).reshape(-1, 2)
    heights = (0.3, 0.9, 1.5, 2.5)

    def measured(rays, place, position, heading):
        present = jnp.ones(number, bool)
        seen = jnp.asarray(people, jnp.float32)
        view = raycast.make_view(scene.scenery.solids, seen, present, jnp.float32(RADIUS), position, heading, place)
        return raycast.by_rows(rays, raycast.distance(view, rays)).reshape(-1)

    # A wide picture in tiles, tilted down and jittered, so that it is not the picture of any camera.
    jitter = across + random.uniform(-0.02, 0.02, across.shape)
    ways = np.stack([np.ones(len(jitter)), jitter[:, 0], jitter[:, 1] - 0.1], -1)
    bundles = {low: raycast.bundle(ways.reshape(48, 64, 3), (16, 8), 1e3, low=low) for low in (True, False)}
    unit_ways = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    measure, checked = jax.jit(measured, static_argnums=0), 0
    for turn, height in enumerate(heights):
        places = environment.free_points(scene, 0.4, 200, seed=turn)
        apart = np.linalg.norm(places[:, None] - people[None], axis=-1).min(1)
        place = places[np.argmax(apart > 0.45)]
        angle = random.uniform(0, 2 * np.pi)
        heading = np.array([np.cos(angle), np.sin(angle)], np.float32)
        on_robot = mount + [0, 0, height]
        where = jnp.asarray(on_robot, jnp.float32), jnp.asarray(place), jnp.asarray(heading)
        ours = np.asarray(measure(bundles[height < SHOULDER], *where))
        turned = np.array([[heading[0], -heading[1], 0], [heading[1], heading[0], 0], [0, 0, 1]], float)
        origin = np.array([*place, 0.0]) + turned @ on_robot
        theirs = mujoco_distances(name, people, origin, unit_ways @ turned.T)
        near = theirs < 200.0
        assert (np.abs(ours - theirs)[near] <= 1e-4).all()
        assert (ours[~near] >= 199.0).all()
        checked += len(ways)
    assert checked >= 10_000


def fan(*ways, tile=(1, 1), low=True):
    return raycast.bundle(np.array([ways], float), tile, 100.0, low=low)


def seen_from(rays, solids, people=((900.0, 0.0),), position=(0.0, 0.0), heading=(1.0, 0.0), height=0.5):
    crowd = jnp.asarray(people, jnp.float32)
    place, way = jnp.asarray(position, jnp.float32), jnp.asarray(heading, jnp.float32)
    sensor = jnp.asarray([0.0, 0.0, height], jnp.float32)
    return raycast.make_view(solids, crowd, jnp.ones(len(people), bool), jnp.float32(RADIUS), place, way, sensor)


def test_closed_forms():
    """Straight at a box, a lying and a standing cylinder, a ball, a person's legs and head, the floor and the sky."""
    solids = yard(
        boxes=[[5, 0, 0.5, 1, 1, 0.5, 1, 0], [-5, 0.01, 0.5, 1, 1, 0.5, np.sqrt(0.5), np.sqrt(0.5)]],
        cylinders=[[0, 5, 0.3, 1, 0, 0, 0.3, 2], [0, -5, 1, 0, 0, 1, 0.5, 1]],
        spheres=[[0, 0, 9, 1]],
    )
    rays = fan([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [1, 1, 0], [0, 0, -1], [1, 3, 9])
    found = jax.jit(lambda: raycast.distance(seen_from(rays, solids, [(2.0, 2.0)], height=0.3), rays))()[:, 0]
    walked = np.sqrt(8) - RADIUS
    assert np.allclose(found[:7], [4, 5.01 - np.sqrt(2), 4.7, 4.5, 7.7, walked, 0.3], atol=1e-5)
    assert found[7] == raycast.MISS
    high = fan([1, 1, 0], low=False)
    view = seen_from(high, yard(), [(2.0, 2.0)], height=HEAD)
    assert np.allclose(raycast.distance(view, high), np.sqrt(8) - 0.13, atol=1e-5)


def test_bodies_at_the_lens():
    """Boxes, cylinders, balls and people from a centimetre to a metre away, against points on the rays."""
    random = np.random.default_rng(8)
    ways = np.array([[np.cos(a), np.sin(a), r] for a in np.linspace(-3.1, 3.1, 40) for r in (-0.3, 0.0, 0.4)])
    unit_ways = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    rays = fan(*ways, tile=(1, 8), low=True)
    at, seen = np.linspace(0.0, 2.0, 20_001)[:, None], 0
    look = jax.jit(lambda solids, people: raycast.by_rows(
        rays, raycast.distance(seen_from(rays, solids, people, height=0.5), rays)))  # fmt: skip
    for gap in (0.01, 0.05, 0.2, 0.45, 0.9):
        angles = random.uniform(-np.pi, np.pi) + np.pi / 2 * np.arange(4)  # none before another
        turn = random.uniform(-np.pi, np.pi)
        reach = np.array([np.hypot(0.2, 0.1), 0.15, 0.12, RADIUS]) + gap
        (bx, by), (cx, cy), (sx, sy), person = (
            r * np.array([np.cos(a), np.sin(a)]) for r, a in zip(reach, angles, strict=True)
        )
        solids = yard([[bx, by, 0.5, 0.2, 0.1, 0.3, np.cos(turn), np.sin(turn)]],
                      [[cx, cy, 0.5, 0, 0, 1, 0.15, 0.4]], [[sx, sy, 0.5, 0.12]])  # fmt: skip
        found = np.asarray(look(solids, [person])).reshape(-1)
        met = np.full(len(ways), np.inf)
        for k, way in enumerate(unit_ways):
            x, y, z = (at * way).T + np.array([[0.0], [0.0], [0.5]])
            u, v = np.cos(turn) * (x - bx) + np.sin(turn) * (y - by), np.cos(turn) * (y - by) - np.sin(turn) * (x - bx)
            inside = (np.abs(u) < 0.2) & (np.abs(v) < 0.1) & (np.abs(z - 0.5) < 0.3)
            inside |= (np.hypot(x - cx, y - cy) < 0.15) & (np.abs(z - 0.5) < 0.4)
            inside |= (x - sx) ** 2 + (y - sy) ** 2 + (z - 0.5) ** 2 < 0.12**2
            inside |= (np.hypot(x - person[0], y - person[1]) < RADIUS) & (z < SHOULDER)
            inside |= z < 0.0
            met[k] = at[inside.argmax(), 0] if inside.any() else np.inf
        near = met < 1.5
        off = np.abs(found - met)[near]
        assert np.quantile(off, 0.96) < 3e-4, gap  # edges, which points miss, are left
        seen += near.sum()
    assert seen > 100


def test_who_is_absent_is_not_seen():
    rays, sensor = fan([1, 0, 0]), jnp.asarray([0.0, 0.0, 0.5], jnp.float32)
    crowd = jnp.asarray([[2.0, 0.0], [1.0, 0.0]], jnp.float32)
    zero, ahead = jnp.zeros(2, jnp.float32), jnp.asarray([1.0, 0.0], jnp.float32)
    view = raycast.make_view(yard(), crowd, jnp.asarray([True, False]), jnp.float32(RADIUS), zero, ahead, sensor)
    assert np.allclose(raycast.distance(view, rays), 1.8, atol=1e-6)


def test_tiles_leave_out_nothing_that_is_seen():
    """The same rays in one tile, which asks about everybody, and in many; with many more people than a loop's turn."""
    random = np.random.default_rng(5)
    people = random.uniform(-8, 8, (150, 2))
    people = people[np.linalg.norm(people, axis=1) > 0.5]
    solids = yard(boxes=[[*random.uniform(-8, 8, 2), 0.6, 0.4, 0.2, 0.6, np.cos(a), np.sin(a)] for a in range(9)])
    angle, rise = np.meshgrid(np.linspace(-np.pi, np.pi, 120, endpoint=False), np.linspace(0.9, -0.9, 24))
    ways = np.stack([np.cos(angle), np.sin(angle), rise], -1)
    images = []
    for tile in ((24, 120), (6, 7), (5, 12)):
        rays = raycast.bundle(ways, tile, 50.0, low=True)
        images.append(
            jax.jit(
                lambda rays=rays: raycast.by_rows(
                    rays, raycast.distance(seen_from(rays, solids, people, height=0.4), rays)
                )
            )()
        )
    for image in images[1:]:
        near = np.asarray(images[0]) < 40.0
        assert np.allclose(np.asarray(image)[near], np.asarray(images[0])[near], rtol=2e-6, atol=0)


def test_gradients_equal_central_differences():
    """Of distances by the robot's pose, a person's position and the sensor's place, away from edges."""
    random = np.random.default_rng(2)
    solids = yard(
        boxes=[[4, 1, 0.5, 0.8, 0.6, 0.5, np.cos(0.4), np.sin(0.4)]],
        cylinders=[[4, -3, 1, 0, 0, 1, 0.5, 1]],
        spheres=[[3, -1, 0.5, 0.4]],
    )
    ways = np.stack([np.ones(240), random.uniform(-1.5, 1.5, 240), random.uniform(-0.3, 0.5, 240)], -1)
    rays = raycast.bundle(ways[None], (1, 20), 50.0, low=True)

    def along(pose, person, sensor):
        way = jnp.stack([jnp.cos(pose[2]), jnp.sin(pose[2])])
        people = jnp.stack([person, jnp.asarray([900.0, 0.0], person.dtype)])
        present = jnp.ones(2, bool)
        view = raycast.make_view(solids, people, present, jnp.float32(RADIUS), pose[:2], way, sensor)
        return raycast.by_rows(rays, raycast.distance(view, rays))[0]

    pose, person = jnp.asarray([0.05, -0.1, 0.02], jnp.float32), jnp.asarray([2.5, 2.0], jnp.float32)
    inputs = pose, person, jnp.asarray([0.1, 0.0, 0.4], jnp.float32)
    both = jax.jit(lambda *at: [jacobian(along, (0, 1, 2))(*at) for jacobian in (jax.jacfwd, jax.jacrev)])
    slopes, backward = (np.concatenate(parts, -1) for parts in both(*inputs))
    assert np.isfinite(slopes).all()
    assert np.allclose(slopes, backward, atol=1e-4)
    step, measured = 1e-3, []
    run = jax.jit(along)
    for axis in range(8):
        shifts = np.split(np.eye(8, dtype=np.float32)[axis] * step, [3, 5])
        moved = ([each + sign * shift for each, shift in zip(inputs, shifts, strict=True)] for sign in (1, -1))
        ahead, behind = (run(*each) for each in moved)
        measured.append((np.asarray(ahead, float) - np.asarray(behind, float)) / (2 * step))
    measured = np.stack(measured, -1)
    seen = np.asarray(run(*inputs)) < 40.0
    smooth = seen & (np.abs(measured).max(-1) < 20.0)  # a ray that crosses an edge in the step jumps
    assert smooth.sum() >= 100
    close = np.abs(slopes - measured)[smooth] <= 0.02 + 0.02 * np.abs(measured)[smooth]
    assert close.all(1).mean() >= 0.97  # the rest graze a round body, where the step is too long


def test_gradients_are_finite_on_edges():
    """Rays that graze, meet corners, run along axes, or start in a body."""
    solids = yard(
        boxes=[[2, 0, 0.5, 1, 1, 0.5, 1, 0], [0, 0, 3, 1, 1, 0.5, 1, 0]],
        cylinders=[[0, 3, 0.5, 0, 0, 1, 1, 0.5]],
        spheres=[[0, -3, 0.5, 1]],
    )
    ways = [[1, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 3, 0], [-1, -3, 0], [-1, 0, 0]]
    rays, sensor = fan(*ways), jnp.asarray([0.0, 0.0, 0.5], jnp.float32)

    def total(position):
        crowd = jnp.asarray([[-2.0, RADIUS], [0.0, 0.0]], jnp.float32)
        heading = jnp.asarray([1.0, 0.0], jnp.float32)
        view = raycast.make_view(solids, crowd, jnp.ones(2, bool), jnp.float32(RADIUS), position, heading, sensor)
        found = raycast.distance(view, rays)
        return jnp.where(found < 90.0, found, 0.0).sum()

    places = jnp.asarray([[0.0, 0.0], [1.0, 1.0], [0.0, 2.0], [-2.0, 0.0]], jnp.float32)
    assert np.isfinite(jax.jit(jax.vmap(jax.grad(total)))(places)).all()


def test_who_else_is_in_the_batch_changes_nothing():
    """Robots with nobody, few and many people in sight: alone, in a batch, and in a batch of batches."""
    random = np.random.default_rng(7)
    solids = yard(boxes=[[*random.uniform(-6, 6, 2), 0.6, 0.3, 0.3, 0.6, 1.0, 0.0] for _ in range(9)])
    ways = np.stack(np.broadcast_arrays(1.0, np.linspace(-0.6, 0.6, 40)[None], np.linspace(0.4, -0.4, 6)[:, None]), -1)
    rays = raycast.bundle(ways, (6, 4), 50.0, low=True)
    away = np.array([60.0, 4.0, 1.0, 0.3])[:, None, None]
    people = jnp.asarray(away * random.uniform([1.0, -0.5], [2.0, 0.5], (4, 30, 2)), jnp.float32)

    def image(people):
        return raycast.distance(seen_from(rays, solids, people), rays)

    alone = np.stack([jax.jit(image)(each) for each in people])
    assert len({float(np.minimum(picture, 40.0).sum()) for picture in alone}) == 4
    batch = jax.jit(jax.vmap(image))(people)
    nested = jax.jit(jax.vmap(jax.vmap(image)))(people.reshape(2, 2, 30, 2)).reshape(batch.shape)
    assert np.allclose(batch, alone, rtol=2e-6, atol=0)
    assert np.array_equal(nested, batch)


@pytest.fixture
def interpreted(monkeypatch):
    """The kernel for GPUs, run step by step on a CPU."""
    monkeypatch.setattr(kernel, "_call", partial(kernel._call, interpret=True))


@pytest.mark.night
@pytest.mark.parametrize("parallel", [False, True])
def test_a_gpu_finds_what_a_cpu_finds(interpreted, parallel):
    """Distances to rounding and the same bodies: alone, and in a batch of batches of which each has one crowd."""
    random = np.random.default_rng(11)
    solids = cluttered(random)
    across, down = np.linspace(-0.8, 0.8, 10)[None], np.linspace(0.4, -0.4, 18)[:, None]
    ways = np.stack(np.broadcast_arrays(1.0, across, down), -1)
    starts = np.stack(np.broadcast_arrays(0.0, 3 * across, 3 * down), -1)
    # In parallel all rays are one tile of 180, two programs of 96; else there are four tiles of 50, one of 64 each.
    rays, height = raycast.bundle(ways, (10, 5), 50.0, low=True), 0.4
    if parallel:
        ways, height = np.broadcast_to([1.0, 0.0, -0.01], ways.shape), 1.4
        rays = raycast.bundle(ways, (18, 10), 50.0, starts)
    crowds = jnp.asarray(random.uniform([0.6, -6.0], [9.0, 6.0], (2, 34, 2)), jnp.float32)
    angle = random.uniform(0, 2 * np.pi, 3)
    ahead = jnp.asarray(np.stack([np.cos(angle), np.sin(angle)], -1), jnp.float32)

    def by(form, people, heading):
        return form(rays, seen_from(rays, solids, people, heading=heading, height=height))

    # Numbers come with the distances of the loops, which are those that equal MuJoCo's.
    loops = partial(by, partial(intersect._first_of_all, behind=True))
    expected = jax.jit(jax.vmap(jax.vmap(loops, (None, 0)), (0, None)))(crowds, ahead)
    assert 0.2 < (np.asarray(expected[0]) < 40.0).mean()
    assert (np.asarray(expected[0]) < np.asarray(expected[2])).any()
    for results in (4,) if parallel else (1, 2, 4):
        launch = partial(by, lambda _, view, results=results: intersect._in_a_kernel(rays, results, view))
        nested = jax.jit(jax.vmap(jax.vmap(launch, (None, 0)), (0, None)))(crowds, ahead)
        found: list[tuple[Any, Any]] = [(nested, slice(None))]
        if results == 4 and not parallel:
            found.append((jax.jit(launch)(crowds[1], ahead[2]), (1, 2)))
        for image, of in found:
            assert len(image) == results
            for part in range(0, results, 2):
                assert np.allclose(image[part], np.asarray(expected[part])[of], rtol=2e-6, atol=0)
            for part in range(1, results, 2):
                assert np.array_equal(image[part], np.asarray(expected[part])[of])


@pytest.mark.slow
def test_no_loop_is_left_to_the_host_of_a_gpu():
    """Distances, numbers and gradients are launches of the kernel; the rays are there once for the whole batch."""
    solids = cluttered(np.random.default_rng(3))
    ways = np.stack(np.broadcast_arrays(1.0, np.linspace(-0.5, 0.5, 8)[None], np.linspace(0.4, -0.4, 8)[:, None]), -1)
    rays = raycast.bundle(ways, (8, 4), 50.0, low=True)

    def view(people):
        return seen_from(rays, solids, people)

    def total(people):
        return jnp.minimum(raycast.distance(view(people), rays), 50.0).sum()

    people = jax.ShapeDtypeStruct((7, 5, 2), jnp.float32)
    programs = (
        jax.vmap(lambda people: raycast.distance(view(people), rays)),
        jax.vmap(lambda people: raycast.search(view(people), rays)),
        jax.vmap(lambda people: raycast.search_behind(view(people), rays)),
        jax.vmap(jax.grad(jax.jit(jax.checkpoint(total)))),
    )
    for program in programs:
        text = lowered_for_gpu(program, people)
        assert "stablehlo.while" not in text
        launches = re.findall(r"custom_call @mosaic_gpu.* : \((.*)\) ->", text)
        assert len(launches) == 1
        sizes = re.findall(r"tensor<(\d+)x(\d+)x", launches[0])
        assert sizes[0] == ("1", str(2 * 5 * gpu_kernels.WIDTH)) and ("7", str(5 * 2)) in sizes
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):
        double = jax.ShapeDtypeStruct((7, 5, 2), jnp.float64)
        exact = lowered_for_gpu(jax.vmap(lambda people: intersect.nearest(in_double(view(people)), rays)), double)
    assert "stablehlo.while" in exact and "mosaic_gpu" not in exact


def in_double(view):
    return jax.tree.map(lambda leaf: leaf.astype(jnp.float64), view)


SPLIT = """
import re
from functools import partial
import jax, jax.numpy as jnp, numpy as np
from support.rays import RADIUS, cluttered
from sean_jax.core import devices; from sean_jax.sensors import raycast
from sean_jax.sensors.raycast import intersect, kernel
kernel._call = partial(kernel._call, interpret=True)
random = np.random.default_rng(4)
ways = np.stack(np.broadcast_arrays(1.0, np.linspace(-0.5, 0.5, 8)[None], np.linspace(0.4, -0.4, 8)[:, None]), -1)
rays = raycast.bundle(ways, (8, 4), 50.0, low=True)
def view_of(solids, people):
    place, way = jnp.zeros(2, jnp.float32), jnp.asarray([1.0, 0.0], jnp.float32)
    present = jnp.ones(5, bool)
    sensor = jnp.asarray([0.0, 0.0, 0.5], jnp.float32)
    return raycast.make_view(solids, people, present, jnp.float32(RADIUS), place, way, sensor)
def image(solids, people):
    return intersect._in_a_kernel(rays, 4, view_of(solids, people))
over, solids = devices.mesh(), cluttered(random)
people = jnp.asarray(random.uniform(1.0, 5.0, (4, 5, 2)), jnp.float32)
compiled = devices.shard_jit(over, image).lower(devices.replicate(over, solids), (people,)).compile()
assert not re.search("all-gather|all-reduce|all-to-all|collective-permute", compiled.as_text())
halves = jax.device_put(people, jax.sharding.NamedSharding(over, jax.sharding.PartitionSpec(devices.AXIS)))
found = compiled(devices.replicate(over, solids), (halves,))
assert [part.data.shape[0] for part in found[0].addressable_shards] == [2, 2]
alone = jax.jit(jax.vmap(image, (None, 0)))(solids, people)
loops = lambda people: intersect._first_of_all(rays, view_of(solids, people), True)
loops = jax.jit(jax.vmap(loops))(people)
for k in range(4):
    assert np.allclose(found[k], alone[k], rtol=2e-6, atol=0) and np.allclose(found[k], loops[k], rtol=1e-5, atol=0), k
assert np.any(found[1] != found[3])
"""


@pytest.mark.slow
def test_devices_share_the_scenarios_of_the_kernel():
    """Each of two devices makes its own half of the images, and they exchange nothing."""
    python("-c", SPLIT, env={**cpu_devices(2), "PYTHONPATH": os.pathsep.join(sys.path)})
