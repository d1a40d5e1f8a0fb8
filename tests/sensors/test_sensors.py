"""Cameras and lidars: the same on every robot, true to MuJoCo's rays and to closed forms, differentiable."""

import dataclasses
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import robots, sensors
from sean_jax.core.data_types import PATTERNS, Obstacles, Sensor
from sean_jax.core.errors import InputError
from sean_jax.sensors import cameras, lidars, person_figure, pictures
from sean_jax.sensors.raycast.vectors import Vector
from sean_jax.world import environment
from sean_jax.world.environment import ENVS, plain_scenery
from support import programs
from support.quick import quick
from support.rays import mujoco_distances, mujoco_hits

LEVEL = (0.0, 0.0, -1.0, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0)  # axes of a camera that looks straight ahead
SKY, FLOOR, OBSTACLE, PERSON, ROBOT = range(5)
PLACE, AHEAD = np.array([3.0, -2.0], np.float32), np.array([0.6, 0.8], np.float32)  # of the robot


@pytest.fixture(scope="module")
def state(scenario):
    return programs.reset(scenario, jax.random.key(3))


def over_ground(ahead, left):
    """(2,) m where that lies which is so far ahead and to the left of the robot at PLACE."""
    return PLACE + AHEAD * ahead + np.array([-AHEAD[1], AHEAD[0]]) * left


def put(scenario, state, boxes, people, absent=()):
    """Scenario and state with the robot at PLACE; boxes (ahead, left, half x, half y, height), people (ahead, left).

    The other people are there as well, but nowhere near, and so are boxes up to four.
    """
    rows = np.array([*boxes, *[(5000.0, 0.0, 0.1, 0.1, 0.1)] * (4 - len(boxes))], np.float32)
    obstacles = Obstacles(
        center=jnp.asarray([over_ground(*row[:2]) for row in rows], jnp.float32),
        half_extent=jnp.asarray(rows[:, 2:4]),
        yaw=jnp.full(len(rows), np.arctan2(AHEAD[1], AHEAD[0]), jnp.float32),
        height=jnp.asarray(rows[:, 4]),
    )
    number = scenario.people
    places = np.full((number, 2), 5000.0, np.float32)
    for index, person in enumerate((*people, *absent)):
        places[index] = over_ground(*person)
    present = np.ones(number, bool)
    present[len(people) : len(people) + len(absent)] = False
    crowd = dataclasses.replace(state.pedestrians, position=jnp.asarray(places), present=jnp.asarray(present))
    robot = dataclasses.replace(state.robot, position=jnp.asarray(PLACE), heading=jnp.asarray(AHEAD))
    scene = dataclasses.replace(scenario.environment, scenery=plain_scenery(obstacles))
    return dataclasses.replace(scenario, environment=scene), dataclasses.replace(state, pedestrians=crowd, robot=robot)


def level(scenario, **changes) -> sensors.Camera:
    return dataclasses.replace(sensors.camera(scenario, "depth", width=16, height=12), axes=LEVEL, **changes)


@pytest.fixture(scope="module")
def look(scenario):
    """A function: yard, state -> the picture of a level camera; one program serves all yards."""
    camera = level(scenario, width=48, height=36)
    return programs.jit_once(lambda yard, here: sensors.render(yard, here, camera))


@pytest.fixture(scope="module")
def depth(scenario):
    """A function: state -> the depth image (12, 16); one program serves all states."""
    camera = sensors.camera(scenario, "depth", width=16, height=12)
    return programs.jit_once(lambda state: sensors.depth(scenario, state, camera))


@pytest.mark.parametrize("name", quick(robots.ROBOTS, "kuri"))
def test_every_robot_has_the_same_sensors(name, scenario, state):
    robot = robots.load(name, "twin")
    theirs = dataclasses.replace(scenario, robot=robot)
    for kind in sensors.CAMERAS:
        camera = sensors.camera(robot, kind)
        assert (camera.width, camera.height, camera.near) == (640, 480, 0.1)
        assert camera.far == (20.0 if kind == "depth" else 200.0)
        assert kind == "overhead" or camera.fovy == 60.0
        small = sensors.camera(theirs, kind, width=16, height=12)
        picture = jax.eval_shape(lambda state, camera=small: sensors.render(theirs, state, camera), state)
        shapes = [(part.shape, part.dtype) for part in dataclasses.astuple(picture)]
        flat = (12, 16)
        assert shapes == [((12, 16, 3), jnp.float32), (flat, jnp.float32), (flat, jnp.int32), (flat, jnp.int32)]
    lidar = sensors.lidar(theirs)
    assert (lidar.count, lidar.near, lidar.far) == (360, 0.12, 3.5)
    assert jax.eval_shape(lambda state: sensors.scan(theirs, state, lidar), state).shape == (360,)


def test_numbers_are_those_of_sean(scenario):
    depth, overhead = sensors.camera(scenario), sensors.camera(scenario, "overhead")
    assert depth.name == "depth" and sensors.focal_length(depth) == pytest.approx(415.69, abs=0.005)
    bundle = cameras.rays(dataclasses.replace(overhead, width=64, height=48))[0]
    assert bundle.offset is not None
    assert np.ptp(bundle.offset[0]) == pytest.approx(6.0 * 47 / 48) and np.ptp(bundle.offset[1]) == pytest.approx(
        8.0 * 63 / 64
    )
    # The middles of the first and the last ray of a lidar are a degree apart, the first straight ahead.
    (fan,) = lidars.lidar_rays(sensors.lidar(scenario))
    angle = np.rad2deg(np.arctan2(fan.direction[1], fan.direction[0])).reshape(-1)
    assert np.allclose(np.mod(angle + 0.5, 360.0) - 0.5, np.arange(360), atol=1e-3)


def test_modules_are_not_named_as_what_the_package_exports():
    for path in Path(sensors.__file__).parent.glob("[a-z]*.py"):
        assert isinstance(getattr(sensors, path.stem), ModuleType)


def mujoco_pixels(state, width, height):
    """Kuri's depth camera as MuJoCo reads it from the robot's file: origin (3,), unit vectors (pixels, 3), cosines."""
    mujoco: Any = import_module("mujoco")
    model = mujoco.MjModel.from_xml_path(str(ENVS / "robots" / "kuri.xml"))
    number = model.camera("depth").id
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.cam_quat[number])
    focal = height / 2 / np.tan(np.deg2rad(model.cam_fovy[number]) / 2)
    u, v = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    ways = np.stack([u / focal, -v / focal, -np.ones_like(u)], -1).reshape(-1, 3)
    size = np.linalg.norm(ways, axis=1, keepdims=True)
    heading, position = np.asarray(state.robot.heading, float), np.asarray(state.robot.position, float)
    spun = np.array([[heading[0], -heading[1], 0.0], [heading[1], heading[0], 0.0], [0.0, 0.0, 1.0]])
    origin = np.array([*position, 0.0]) + spun @ model.cam_pos[number]
    return origin, (ways / size) @ turn.reshape(3, 3).T @ spun.T, 1 / size[:, 0]


def test_depth_is_range_times_cosine_as_mujoco_measures_it(scenario, state):
    """The camera as MuJoCo reads it from the robot's file, the pose and people of a state, ranges by C `mj_ray`."""
    origin, ways, cosine = mujoco_pixels(state, 32, 24)
    assert bool(state.pedestrians.present.all())
    people = np.asarray(state.pedestrians.position, float)
    wanted = (mujoco_distances("warehouse", people, origin, ways) * cosine).reshape(24, 32)
    camera = sensors.camera(scenario, "depth", width=32, height=24)
    image = np.asarray(jax.jit(lambda state: sensors.depth(scenario, state, camera))(state))
    assert np.abs(image - wanted)[wanted < 20].max() <= 1e-3 and (image[wanted > 20.001] == 20.0).all()
    assert (wanted < 20).sum() > 300


def test_people_are_in_the_pixels_in_which_mujoco_finds_them(scenario, state):
    """Robots anywhere in the warehouse, some people around each, the others behind walls or far away."""
    camera, random = sensors.camera(scenario, "depth", width=64, height=48), np.random.default_rng(4)
    look = jax.jit(lambda state: sensors.pixels_of_people(scenario, state, camera))
    places, radius = np.asarray(scenario.navigation.places, float), float(scenario.forces.walking.radius)
    seen = 0
    for _ in range(12):
        angle, here = random.uniform(0, 2 * np.pi), random.choice(places)
        away = np.linalg.norm(places - here, axis=1)
        spots = np.concatenate([random.choice(places[(away > 0.6) & (away < 6.0)], 8), random.choice(places, 8)])
        spots = spots + random.uniform(-0.1, 0.1, spots.shape)
        heading = jnp.asarray([np.cos(angle), np.sin(angle)], jnp.float32)
        robot = state.robot.replace(position=jnp.asarray(here, jnp.float32), heading=heading)
        people = state.pedestrians.replace(position=jnp.asarray(spots, jnp.float32))
        there = state.replace(robot=robot, pedestrians=people)
        origin, ways, cosine = mujoco_pixels(there, 64, 48)
        spots = np.asarray(people.position, float)
        distance, who = mujoco_hits("warehouse", spots, origin, ways, radius)
        in_range = (distance * cosine >= 0.1) & (distance * cosine <= 20.0)
        wanted = np.bincount(who[in_range & (who >= 0)], minlength=16)
        pixels = np.asarray(look(there))
        assert np.abs(pixels - wanted).max() <= 2, (pixels, wanted)  # on outlines, by rounding
        clear = np.abs(wanted - 2) > 1  # of who is not hidden to a sliver
        np.testing.assert_array_equal((pixels > 0)[clear], (wanted > 0)[clear])
        absent = people.replace(present=jnp.asarray(wanted == 0))
        assert not np.asarray(look(there.replace(pedestrians=absent)))[wanted > 0].any()
        seen += (wanted > 0).sum()
    assert 20 < seen < 100  # of 192


def test_the_depth_of_a_wall_straight_ahead_is_flat(scenario, state, look):
    image = np.asarray(look(*put(scenario, state, [(4.0, 0.0, 1.0, 30.0, 9.0)], [])).depth)
    ahead, _, height = np.asarray(next(each for each in scenario.robot.mounts if each.name == "depth").origin)
    focal = 18 / np.tan(np.pi / 6)
    down = np.arange(36) + 0.5 - 18
    floor = height * focal / np.where(down > 0, down, 1e-9)  # the depth of a row that meets the floor
    wall = 3.0 - ahead
    assert np.allclose(image, np.minimum(wall, floor)[:, None], atol=1e-4)
    assert np.ptp(image[:18]) <= 1e-4 and (image[:18] > 2.9).all()


def test_one_trace_for_all_states_and_a_batch_equals_a_loop(scenario, state, depth):
    camera = sensors.camera(scenario, "depth", width=16, height=12)
    moved = state.robot.position[None] + jnp.asarray([[0.0, 0.0], [0.3, 0.1], [-0.2, 0.5]], jnp.float32)
    states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), state)
    states = dataclasses.replace(states, robot=dataclasses.replace(states.robot, position=moved))
    images = np.stack([depth(jax.tree.map(lambda leaf, i=i: leaf[i], states)) for i in range(3)])
    batch = jax.jit(jax.vmap(lambda state: sensors.depth(scenario, state, camera)))(states)
    np.testing.assert_allclose(batch, images, atol=1e-5)
    assert len({image.tobytes() for image in images}) == 3


def test_gradients_of_depth(scenario, state):
    """Where no edge is in the picture: equal to central differences. Anywhere: finite."""
    camera = level(scenario, fovy=12.0)
    yard, here = put(scenario, state, [(6.0, 0.0, 0.5, 30.0, 9.0)], [(0.7, 0.02)])

    def mean(position, person, camera=camera, yard=yard, here=here):
        robot = dataclasses.replace(here.robot, position=position)
        crowd = dataclasses.replace(here.pedestrians, position=here.pedestrians.position.at[0].set(person))
        return sensors.depth(yard, dataclasses.replace(here, robot=robot, pedestrians=crowd), camera).mean()

    both = jax.jit(jax.value_and_grad(mean, (0, 1)))
    at = here.robot.position, here.pedestrians.position[0]
    slopes = np.concatenate(both(*at)[1])
    step, measured = 1e-2, []
    for axis in range(4):
        shift = np.eye(4, dtype=np.float32)[axis] * step
        ends = [float(both(at[0] + sign * shift[:2], at[1] + sign * shift[2:])[0]) for sign in (1, -1)]
        measured.append((ends[0] - ends[1]) / (2 * step))
    assert np.allclose(slopes, measured, atol=5e-3)
    assert np.allclose(slopes[:2], -slopes[2:], atol=1e-4) and np.abs(slopes @ [*AHEAD, 0, 0] + 1) < 0.1
    wide = sensors.camera(scenario, "depth", width=16, height=12)
    everywhere = jax.jit(lambda at: jax.grad(lambda at: mean(at[0], at[1], wide, scenario, state))(at))
    found = everywhere((state.robot.position, state.pedestrians.position[0]))
    assert all(np.isfinite(part).all() for part in found) and np.abs(found[0]).max() > 0


@pytest.fixture(scope="module")
def shots(scenario, state):
    """Pictures of a yard: somebody ahead, somebody absent nearer, a box ahead to the left, a person to the right."""
    boxes = [(9.0, 9.0, 0.1, 0.1, 0.1), (3.0, 1.3, 0.4, 0.5, 0.9)]
    yard, here = put(scenario, state, boxes, [(2.0, 0.0), (1.0, -1.0)], absent=[(1.0, 0.0)])
    sizes = {"first_person": (24, 18), "third_person": (24, 18), "overhead": (64, 48)}
    views = {name: sensors.camera(yard, name, width=w, height=h) for name, (w, h) in sizes.items()}

    def look(state):
        found = {name: sensors.render(yard, state, view) for name, view in views.items()}
        return found, sensors.depth(yard, state, views["first_person"])

    return jax.tree.map(np.asarray, jax.jit(look)(here))


def test_pictures_show_what_is_there(shots, scenario):
    number = scenario.people
    for picture in shots[0].values():
        assert np.isfinite(picture.rgb).all() and picture.rgb.min() >= 0 and picture.rgb.max() <= 1
        assert picture.rgb.std() > 0.05
        whose = (picture.semantic == PERSON, picture.semantic == OBSTACLE, picture.semantic == ROBOT)
        assert ((picture.instance >= 0) == (whose[0] | whose[1] | whose[2])).all()
        assert (picture.instance[whose[0]] < number).all() and (picture.instance[whose[2]] == number + 4).all()
        assert (picture.instance[whose[1]] >= number).all() and (picture.instance[whose[1]] < number + 4).all()
        assert 2 not in picture.instance  # who is absent
    ahead = shots[0]["first_person"]
    assert ahead.semantic[9, 12] == PERSON and ahead.instance[9, 12] == 0
    assert (ahead.semantic[-1] == FLOOR).all() and (ahead.semantic[0] != FLOOR).all()
    assert ahead.semantic[0, 6] == SKY and ahead.instance[0, 6] == -1 and ahead.depth[0, 6] == 200.0
    # The box lies 3 m ahead and 1.3 m to the left, so that its middle, and not that of its mirror image, is seen.
    focal = 9 / np.tan(np.pi / 6)
    column = int(12 - focal * 1.3 / 2.6)
    assert ahead.semantic[9, column] == OBSTACLE and ahead.instance[9, column] == number + 1
    assert ahead.semantic[9, 24 - column] != OBSTACLE
    assert np.allclose(ahead.depth[9, 12], 2 - 0.2 - 0.05, atol=0.03)
    assert np.allclose(ahead.depth, shots[1], atol=1e-4)


def test_the_robot_is_seen_from_behind_and_above(shots):
    counts = {name: int((picture.semantic == ROBOT).sum()) for name, picture in shots[0].items()}
    assert counts["first_person"] == 0 and counts["third_person"] > 5
    # Kuri is a disc of 0.15 m seen from above, 1/8 m to a pixel.
    assert counts["overhead"] == pytest.approx(np.pi * (0.15 * 8) ** 2, abs=2)
    rows, columns = np.nonzero(shots[0]["third_person"].semantic == ROBOT)
    assert np.abs(columns + 0.5 - 12).mean() < 2 and rows.min() > 8


def test_people_are_where_they_belong_seen_from_above(shots):
    """8 pixels to the metre, the robot in the middle, ahead is up."""
    above = shots[0]["overhead"]
    head = 3.5 - (1.6 + np.sqrt(0.13**2 - 2 * 0.0625**2))  # m, where the four rays beside its top meet it
    for who, (ahead, left) in enumerate([(2.0, 0.0), (1.0, -1.0)]):
        rows, columns = np.nonzero(above.instance == who)
        assert np.mean(rows + 0.5) == pytest.approx(24 - 8 * ahead, abs=0.3)
        assert np.mean(columns + 0.5) == pytest.approx(32 - 8 * left, abs=0.3)
        assert len(rows) == pytest.approx(np.pi * (0.2 * 8) ** 2, abs=5)  # pixels
        assert above.depth[rows, columns].min() == pytest.approx(head, abs=2e-3)
    robot = np.argwhere(above.semantic == ROBOT) + 0.5
    assert np.allclose(robot.mean(0), [24, 32], atol=0.5)


def test_each_person_has_a_color_and_a_face(shots, scenario):
    shirts = np.array(jax.jit(lambda: jnp.stack(person_figure.shirts(scenario.people)))())
    assert (
        np.linalg.norm(shirts[:, :, None] - shirts[:, None], axis=0)[~np.eye(scenario.people, dtype=bool)].min() > 0.02
    )
    behind = shots[0]["third_person"]
    assert {0, 1} <= set(np.unique(behind.instance))
    darker = shots[0]["overhead"].rgb[shots[0]["overhead"].semantic == FLOOR].mean(1)
    assert darker.min() < 0.8 * np.median(darker)  # the floor beside who stands on it


def test_lidar_in_a_room(scenario, state):
    """A room of 4 x 3 m with the robot off its middle and a person in it, against closed forms."""
    thick, north, south, west, east = 0.5, 1.0, 2.0, 2.5, 1.5  # distances of the walls ahead, behind, left and right
    walls = [
        (north + thick, (west - east) / 2, thick, 9.0, 2.0),
        (-south - thick, (west - east) / 2, thick, 9.0, 2.0),
        ((north - south) / 2, west + thick, 9.0, thick, 2.0),
        ((north - south) / 2, -east - thick, 9.0, thick, 2.0),
    ]
    room, here = put(scenario, state, walls, [(-0.9, 0.4)], absent=[(0.5, 0.0)])
    lidar = dataclasses.replace(sensors.lidar(scenario), origin=(0.0, 0.0, 0.3))
    found = np.asarray(jax.jit(lambda state: sensors.scan(room, state, lidar))(here))
    angle = np.deg2rad(np.arange(360.0))
    c, s = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = np.minimum(
            np.where(c > 0, north / c, -south / c), np.where(s > 0, west / s, np.where(s < 0, -east / s, np.inf))
        )
    along, aside = -0.9 * c + 0.4 * s, -0.9 * s - 0.4 * c
    hits = (np.abs(aside) < 0.2) & (along > 0)
    person = along - np.sqrt(np.where(hits, 0.04 - aside**2, 0.0))
    wanted = np.where(hits, np.minimum(person, wanted), wanted)
    grazes = np.abs(np.abs(aside) - 0.2) < 1e-3
    assert np.abs(found - wanted)[~grazes].max() <= 1e-4
    assert hits.sum() > 10 and wanted.max() < 3.5


def test_a_lidar_looks_where_its_site_is_turned(scenario, state):
    """Yaw shifts the angles of rays; pitch has those ahead meet the floor, and those behind nothing."""
    yaw, pitch = 1.1, 0.4
    c, s = np.cos(yaw), np.sin(yaw)
    plain_one = sensors.lidar(scenario, count=30, first=0.3, far=9.0)
    turned = dataclasses.replace(plain_one, axes=(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0))
    shifted = dataclasses.replace(plain_one, first=0.3 + yaw)
    (there,), (same,), (plain_rays,) = (lidars.lidar_rays(each) for each in (turned, shifted, plain_one))
    np.testing.assert_allclose(there.direction, same.direction, atol=1e-6)
    assert there.low == plain_rays.low
    c, s = np.cos(pitch), np.sin(pitch)
    axes = c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c
    down = dataclasses.replace(plain_one, first=0.0, origin=(0.1, 0.0, 0.5), axes=axes)
    room, here = put(scenario, state, [], [])
    found = np.asarray(jax.jit(lambda state: sensors.scan(room, state, down))(here))
    fall = s * np.cos(2 * np.pi * np.arange(30) / 30)
    with np.errstate(divide="ignore"):
        wanted = np.where(fall > 1e-6, 0.5 / fall, np.inf)
    np.testing.assert_allclose(found, np.minimum(wanted, 9.0), rtol=1e-5)


def rings_of(scenario, count=120, **changes) -> sensors.Lidar:
    """A VLP-16 with fewer rays in each ring."""
    return sensors.lidar(scenario, **{**sensors.VLP16, "count": count, **changes})


def ring_directions(lidar):
    """(rings, rays, 3) by the angles of the manual: ring by ring from -15 to 15 degrees, to the left from ahead."""
    rise, turn = np.meshgrid(np.deg2rad(np.arange(-15, 16, 2)), 2 * np.pi * np.arange(lidar.count) / lidar.count,
                             indexing="ij")  # fmt: skip
    return np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], -1)


def test_rings_are_the_distances_of_mujoco(scenario, state):
    """Robots anywhere in the warehouse with people around them; a lidar below and one above people's shoulders."""
    random, places = np.random.default_rng(6), np.asarray(scenario.navigation.places, float)
    radius, on_people, on_floor = float(scenario.forces.walking.radius), 0, 0
    low = rings_of(scenario)
    (place,) = [np.asarray(mount.origin, float) for mount in scenario.robot.mounts if mount.name == "lidar"]
    high = dataclasses.replace(low, origin=(0.05, -0.02, 1.4))
    look = jax.jit(lambda state: [sensors.scan(scenario, state, lidar) for lidar in (low, high)])
    for _ in range(3):
        angle, here = random.uniform(0, 2 * np.pi), random.choice(places)
        away = np.linalg.norm(places - here, axis=1)
        near = random.choice(places[(away > 0.8) & (away < 6.0)], scenario.people)
        spots = np.asarray(near + random.uniform(-0.1, 0.1, near.shape), np.float32)
        heading = np.array([np.cos(angle), np.sin(angle)], np.float32)
        robot = state.robot.replace(position=jnp.asarray(here, jnp.float32), heading=jnp.asarray(heading))
        there = state.replace(robot=robot, pedestrians=state.pedestrians.replace(position=jnp.asarray(spots)))
        turned = np.array([[heading[0], -heading[1], 0], [heading[1], heading[0], 0], [0, 0, 1]], float)
        for lidar, mount, scan in zip((low, high), (place, np.array(high.origin)), look(there), strict=True):
            ways = (ring_directions(lidar) @ turned.T).reshape(-1, 3)
            origin = np.array([*np.float32(here), 0.0]) + turned @ mount
            distance, who = mujoco_hits("warehouse", spots.astype(float), origin, ways, radius)
            in_range = (distance >= 0.4) & (distance <= 100.0)
            wanted = np.where(in_range, distance, 100.0).reshape(16, 120)
            assert scan.shape == (16, 120)
            gap = np.abs(np.asarray(scan) - wanted)
            # A ray that grazes an outline may meet it by rounding.
            assert (gap <= 1e-4 + 2e-5 * wanted).mean() >= 0.999 and (gap[wanted < 5.0] <= 1e-4).mean() >= 0.999
            on_people += (who[in_range] >= 0).sum()
            # The cloud is in the frame of the lidar: on the floor its points are as far below it as it is high.
            xyz, ring = sensors.point_cloud(lidar, np.asarray(scan))
            hits = np.asarray(scan) < 100.0
            np.testing.assert_allclose(xyz, (ring_directions(lidar) * np.asarray(scan)[..., None])[hits], atol=1e-4)
            np.testing.assert_array_equal(ring, np.nonzero(hits)[0])
            np.testing.assert_allclose(sensors.points(lidar, scan)[hits], xyz, atol=1e-5)
            floor = (ring == 0) & (np.abs(xyz[:, 2] + mount[2]) < 1e-3)
            assert xyz[:, 2].min() >= -mount[2] - 1e-3
            on_floor += floor.sum()
    assert on_people > 300 and on_floor > 50


@pytest.mark.night
def test_rings_are_differentiable_and_traced_once(scenario, state):
    lidar = rings_of(scenario, 24)

    def look(position, people):
        robot = dataclasses.replace(state.robot, position=position)
        crowd = dataclasses.replace(state.pedestrians, position=people)
        return sensors.scan(scenario, dataclasses.replace(state, robot=robot, pedestrians=crowd), lidar)

    one, people = programs.jit_once(look), state.pedestrians.position
    moved = state.robot.position[None] + jnp.asarray([[0.0, 0.0], [0.3, 0.1], [-0.2, 0.5]], jnp.float32)
    each = np.stack([one(position, people) for position in moved])
    np.testing.assert_allclose(jax.jit(jax.vmap(look, (0, None)))(moved, people), each, atol=1e-4, rtol=1e-5)
    slopes = np.asarray(jax.jit(jax.jacfwd(look))(state.robot.position, people))
    assert np.isfinite(slopes).all() and np.abs(slopes).max() > 0.5
    backward = jax.jit(jax.grad(lambda *places: look(*places).mean(), (0, 1)))(state.robot.position, people)
    np.testing.assert_allclose(backward[0], slopes.mean((0, 1)), atol=1e-4)
    assert np.isfinite(backward[1]).all()


def test_rings_without_tilt_are_the_planar_lidar(scenario, state):
    planar = sensors.lidar(scenario, count=90, far=20.0)
    rings = sensors.lidar(scenario, count=90, far=20.0, elevations=[-0.2, 0.0, 0.2])
    scans = jax.jit(lambda state: [sensors.scan(scenario, state, each) for each in (planar, rings)])(state)
    np.testing.assert_allclose(scans[1][1], scans[0], rtol=1e-6)
    assert not np.allclose(scans[1][0], scans[0])
    assert sensors.points(planar, scans[0]).shape == (90, 3)
    xyz, ring = sensors.point_cloud(planar, np.asarray(scans[0]))
    assert len(xyz) == (np.asarray(scans[0]) < 20.0).sum() and not ring.any() and not xyz[:, 2].any()


def test_the_named_vlp16_has_the_noise_of_its_manual(scenario, state):
    robot = sensors.as_sensor("vlp16", scenario.robot)
    small = dataclasses.replace(robot, read=dataclasses.replace(robot.read, device=rings_of(scenario, 180)))
    exact = dataclasses.replace(small, params=sensors.distance_errors(0.0, 0.0))
    lost = dataclasses.replace(small, params=sensors.distance_errors(0.03, 0.0, 0.25))
    sense = jax.jit(lambda suite, state: sensors.sense(scenario.replace(sensors=(suite,)), state)["vlp16"])
    true, noisy, holed = (np.asarray(sense(each, state), float) for each in (exact, small, lost))
    hits = (true > 0.6) & (true < 99.0)
    assert (noisy - true)[hits].std() == pytest.approx(0.03, rel=0.08)
    assert (holed[hits] == 100.0).mean() == pytest.approx(0.25, abs=0.04)
    assert (
        robot.read.device.count * len(robot.read.device.elevations) == 28_800
    )  # ten times a second: the manual's 0.3 M


def test_noise_and_drop_outs():
    """Deviations of a depth camera at 1 and at 3 m, as printed by their source; what is not seen stays unseen."""
    distance = jnp.broadcast_to(jnp.asarray([1.0, 3.0, 20.0], jnp.float32), (20_000, 3))
    noisy = np.asarray(sensors.noise(jax.random.key(0), distance, far=20.0), float)
    wanted = 0.0012 + 0.0019 * np.square(np.array([1.0, 3.0]) - 0.4)
    assert np.allclose(noisy[:, :2].std(0), wanted, rtol=0.03) and (noisy[:, 2] == 20.0).all()
    assert np.allclose(noisy[:, :2].mean(0), [1.0, 3.0], atol=4 * wanted / np.sqrt(20_000))
    lidar = np.asarray(sensors.noise(jax.random.key(1), distance, far=3.5, min_deviation=0.01, growth=0.0), float)
    assert np.allclose(lidar[:, :2].std(0), 0.01, rtol=0.03)
    gone = np.asarray(sensors.drop_outs(jax.random.key(2), distance, 0.1, 20.0))[:, 0] == 20.0
    assert gone.mean() == pytest.approx(0.1, abs=0.01)


def test_an_image_comes_through_the_delay_line_after_its_steps():
    images = np.arange(6, dtype=np.float32)[:, None] * np.ones(2, np.float32)
    line, seen = sensors.delay(jnp.asarray(images[0]), 2), []
    push = jax.jit(sensors.push)
    for image in images:
        line, late = push(line, jnp.asarray(image))
        seen.append(float(late[0]))
    assert seen == [0, 0, 0, 1, 2, 3]
    assert float(sensors.push(sensors.delay(jnp.zeros(1), 0), jnp.ones(1))[1][0]) == 1.0


@pytest.mark.parametrize(
    ("rate", "ticks"),
    [(15.0, range(12)), (10.0, range(12)), (5.0, range(0, 12, 2)), (1.0, (0, 10)), (4.0, (0, 3, 5, 8, 10))],
)
def test_a_sensor_is_due_at_its_rate(rate, ticks):
    """Control is at 10 Hz: faster sensors are due at each tick. 4 Hz is due at 0, 2.5, 5, 7.5, ... ticks."""
    due = np.asarray(
        jax.jit(lambda: jax.vmap(lambda tick: sensors.due(tick, 0.1, rate))(jnp.arange(1200, dtype=jnp.int32)))()
    )
    assert np.flatnonzero(due[:12]).tolist() == list(ticks)
    assert due.sum() == min(round(rate * 120), 1200)


@pytest.mark.parametrize("rate", [0.0101, 0.015, 0.37])
def test_a_slow_sensor_is_due_at_its_rate(rate):
    due = [bool(sensors.due(np.int32(tick), 0.1, rate)) for tick in range(5000)]
    assert sum(due) == 1 + int(4999 * 0.1 * rate)


@pytest.mark.parametrize("rate", [0.006, 0.0, -1.0, float("nan")])
def test_a_rate_that_ticks_cannot_count_is_refused(rate):
    with pytest.raises(ValueError, match="^rate: .* a second is less than once in 1000 steps of 0.1 s; give"):
        sensors.due(np.int32(0), 0.1, rate)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"name": "dept"}, "robot 'kuri' has no 'dept'; did you mean 'depth'?"),
        ({"name": "rear"}, "robot 'kuri' has no 'rear'; it has depth, first_person, third_person, overhead."),
        ({"fovy": 0.0}, "fovy: 0 degrees must lie between 0 and 180."),
        ({"near": 2.0, "far": 1.0}, "near, far: 2 and 1 m must be a lesser and a greater distance."),
        ({"width": 0}, "a picture of 0 x 480 pixels shows nothing; give 1 or more of each."),
        ({"orthographic": -1.0}, "orthographic: -1 m"),
    ],
)
def test_a_camera_that_shows_nothing_is_refused(arguments, said, scenario):
    with pytest.raises(ValueError) as error:
        sensors.camera(scenario, **arguments)
    assert said in str(error.value) and len(str(error.value).splitlines()) == 1


def test_a_lidar_that_measures_nothing_is_refused(scenario, tmp_path):
    with pytest.raises(ValueError, match="0 rays"):
        sensors.lidar(scenario, count=0)
    with pytest.raises(ValueError, match="4 and 3.5 m"):
        sensors.lidar(scenario, near=4.0)
    with pytest.raises(ValueError, match="elevations: 0, -10 degrees must ascend, each more than -90"):
        sensors.lidar(scenario, elevations=np.deg2rad([0.0, -10.0]))
    with pytest.raises(ValueError, match="elevations: nan degrees must ascend"):
        sensors.lidar(scenario, elevations=[np.nan])
    text = (ENVS / "robots" / "kuri.xml").read_text(encoding="utf-8")
    file = tmp_path / "blind.xml"
    file.write_text("\n".join(line for line in text.splitlines() if "<site" not in line and "<camera" not in line))
    robot = robots.load(file, "twin")
    with pytest.raises(ValueError, match="robot 'blind' has no <site name=\"lidar\">; add one to its base"):
        sensors.lidar(robot)
    with pytest.raises(ValueError, match="robot 'blind' has no 'depth'; it has none"):
        sensors.camera(robot)
    with pytest.raises(ValueError, match="future"):
        sensors.delay(jnp.zeros(1), -1)


# --- sensors as values ---


def small_suite(scenario, **errors) -> tuple:
    camera = sensors.camera(scenario, "depth", width=16, height=12)
    lidar = sensors.lidar(scenario, count=24)
    noisy = sensors.distance_errors(**errors) if errors else None
    color = sensors.color_sensor(sensors.camera(scenario, "first_person", width=8, height=6))
    return sensors.depth_sensor(camera, noisy), sensors.lidar_sensor(lidar, noisy), color


def test_sense_reads_every_sensor_by_its_name(scenario, state, depth):
    equipped = scenario.replace(sensors=small_suite(scenario))
    readings = jax.jit(sensors.sense)(equipped, state)
    assert {name: reading.shape for name, reading in readings.items()} == {
        "depth": (12, 16), "lidar": (24,), "first_person": (6, 8, 3)
    }  # fmt: skip
    np.testing.assert_array_equal(readings["depth"], depth(state))
    assert sensors.sense(scenario, state) == {}


def test_noise_depends_on_episode_tick_and_name_alone(scenario, state):
    """A further sensor changes nothing; the next tick and another name change the noise; equal states agree."""
    _, lidar, _ = small_suite(scenario, min_deviation=0.1, growth=0.0)
    second = dataclasses.replace(lidar, name="second")
    sense = jax.jit(lambda suite, state: sensors.sense(scenario.replace(sensors=suite), state))
    alone, both = sense((lidar,), state)["lidar"], sense((second, lidar), state)
    np.testing.assert_array_equal(alone, both["lidar"])
    later = sense((lidar,), dataclasses.replace(state, tick=state.tick + 1))["lidar"]
    assert not np.array_equal(alone, later) and not np.array_equal(alone, both["second"])
    episode = dataclasses.replace(state.streams, sensors=jax.random.key(99))
    assert not np.array_equal(alone, sense((lidar,), dataclasses.replace(state, streams=episode))["lidar"])


def test_errors_of_a_sensor_are_leaves(scenario, state):
    """Sweeping deviation and drop-outs needs one program, and a derivative of a reading by the deviation exists."""

    _, lidar, _ = small_suite(scenario, growth=0.0)

    def reading(deviation, drop_out):
        params = dataclasses.replace(lidar.params, min_deviation=deviation, drop_out=drop_out)
        noisy = dataclasses.replace(lidar, params=params)
        return sensors.sense(scenario.replace(sensors=(noisy,)), state)["lidar"]

    def with_slope(deviation, drop_out):
        return jax.jvp(lambda deviation: reading(deviation, drop_out), (deviation,), (jnp.ones(()),))

    errors = jnp.asarray([[0.0, 0.0], [0.2, 0.0], [0.01, 0.0], [0.0, 1.0]], jnp.float32)
    (exact, noisy, _, gone), slopes = jax.jit(jax.vmap(with_slope))(*errors.T)
    assert np.abs(noisy - exact).max() > 0.05 and (np.asarray(gone) == 3.5).all()
    assert np.isfinite(slopes).all() and np.abs(slopes[2]).max() > 0.1


def test_equal_sensors_are_equal_values(scenario):
    """So that a scenario made again finds its compiled programs."""
    one, again = (jax.tree.structure(small_suite(scenario)) for _ in range(2))
    assert one == again and hash(one) == hash(again)


@pytest.mark.parametrize("name", sensors.SENSORS)
def test_every_robot_has_the_named_sensors(name, scenario):
    assert sensors.as_sensor(name, scenario.robot).name == name


def test_a_function_of_ones_own_is_a_sensor(scenario, state):
    gps = Sensor(jnp.float32(2.0), "gps", lambda scenario, params, state, key: state.robot.position + params)
    suite = sensors.as_sensors([gps, "lidar"], scenario.robot)
    assert suite[0] is gps and [sensor.name for sensor in suite] == ["gps", "lidar"]
    reading = sensors.sense(scenario.replace(sensors=suite[:1]), state)["gps"]
    np.testing.assert_allclose(reading, np.asarray(state.robot.position) + 2.0, rtol=1e-6)


def test_sensors_from_files(scenario, tmp_path):
    file = tmp_path / "eye.yaml"
    file.write_text("kind: depth\nname: eye\nwidth: 32\nheight: 24\nfar: 8\nerrors: {drop_out: 0.1}\n")
    eye = sensors.as_sensor(file, scenario.robot)
    camera = sensors.camera(scenario, "depth", width=32, height=24, far=8.0)
    same = sensors.depth_sensor(camera, sensors.distance_errors(drop_out=0.1), "eye")
    assert jax.tree.structure(eye) == jax.tree.structure(same)
    assert float(eye.params.drop_out) == pytest.approx(0.1)
    file.write_text("kind: lidar\ncount: 90\nspan: 180\nfirst: -90\n")
    fan = sensors.as_sensor(str(file), scenario.robot)
    device = sensors.lidar(scenario, count=90, span=np.pi, first=-np.pi / 2)
    assert jax.tree.structure(fan) == jax.tree.structure(sensors.lidar_sensor(device))
    file.write_text("kind: lidar\ncount: 90\nelevations: [-10, 0, 10]\n")
    rings = sensors.as_sensor(str(file), scenario.robot)
    device = sensors.lidar(scenario, count=90, elevations=np.deg2rad([-10.0, 0.0, 10.0]))
    assert jax.tree.structure(rings) == jax.tree.structure(sensors.lidar_sensor(device))
    file.write_text("kind: color\nmount: overhead\nwidth: 8\nheight: 8\n")
    assert sensors.as_sensor(file, scenario.robot).name == "overhead"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind: dept\n", "'dept' is not one of depth, color, lidar"),
        ("kind: lidar\nwidth: 8\n", "width: is no key of the kind 'lidar'; remove it"),
        ("kind: depth\nelevations: [1]\n", "elevations: is no key of the kind 'depth'; remove it"),
        ("kind: lidar\nelevations: [1, 1]\n", "elevations: do not ascend; begin with the lowest ring"),
        ("kind: lidar\nelevations: [0, 90]\n", "elevations[1]: 90 is not less than 90"),
        ("kind: lidar\ncount: 60000\nelevations: [0, 1]\n", "elevations: and count give more than 100,000 rays"),
        ("kind: depth\ncount: 8\n", "count: is no key of the kind 'depth'; remove it"),
        ("kind: color\nerrors: {}\n", "errors of distances, which the kind 'color' does not measure"),
        ("kind: depth\nerrors: {drop_out: 2}\n", "errors.drop_out: 2"),
    ],
)
def test_a_wrong_sensor_file_is_refused(text, message, scenario, tmp_path):
    file = tmp_path / "wrong.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        sensors.as_sensor(file, scenario.robot)
    assert message in str(error.value)


def test_wrong_names_of_sensors_are_refused(scenario):
    with pytest.raises(InputError, match="sensors: 'lidr' is no sensor; did you mean 'lidar'?"):
        sensors.as_sensor("lidr", scenario.robot)
    with pytest.raises(InputError, match="sensors: 2 have the name 'lidar'; give each a name of its own"):
        sensors.as_sensors(["lidar", "lidar"], scenario.robot)
    with pytest.raises(InputError, match="nowhere.yaml"):
        sensors.as_sensor("nowhere.yaml", scenario.robot)


def reach(point, start, end, radius):
    """(...) m from points (..., 3) to a capsule, in double precision."""
    axis = end - start
    share = np.clip(((point - start) * axis).sum(-1) / (axis * axis).sum(-1), 0.0, 1.0)
    return np.linalg.norm(point - start - share[..., None] * axis, axis=-1) - radius


def figure_of(ahead, height):
    """Part, start, end, radius and flatness of capsules; the ``height`` [m] of a ray decides on arms or legs."""
    look = person_figure
    yield look.BODY, (0, 0, look.TRUNK_ENDS[0]), (0, 0, look.TRUNK_ENDS[1]), look.TRUNK, look.FLAT
    yield look.HEAD, (0, 0, look.CRANIUM_ENDS[0]), (0, 0, look.CRANIUM_ENDS[1]), look.CRANIUM, 1.0
    for side in (1, -1):
        ankle, hand = (side * ahead, side * look.APART, look.ANKLE), (-look.SWING * side * ahead, side * look.HAND[0])
        if height > look.GROIN:
            yield look.LIMB, (0, side * look.SHOULDERS, look.ARMPIT), (*hand, look.HAND[1]), look.ARM, 1.0
        else:
            yield look.LOWER, (0, side * look.APART, look.HIP), ankle, look.LEG, 1.0


def test_figures_are_where_a_march_meets_them():
    """Distances, parts and normals against steps of 1 mm along random rays in double precision."""
    chance = np.random.default_rng(4)
    turn, height = chance.uniform(0, 2 * np.pi, 300), chance.uniform(0.0, 1.75, 300)
    here = np.stack([0.45 * np.cos(turn), 0.45 * np.sin(turn), height], -1)
    aim = np.stack([*chance.uniform(-0.2, 0.2, (2, 300)), np.clip(height + chance.normal(0, 0.3, 300), 0, 1.7)], -1)
    way = (aim - here) / np.linalg.norm(aim - here, axis=1, keepdims=True)
    ahead = chance.uniform(-person_figure.SPREAD, person_figure.SPREAD, 300)
    steps = np.arange(0.0, 1.2, 1e-3)
    at = here[:, None] + steps[:, None] * way[:, None]
    distance, part, least = np.full(300, np.inf), np.full(300, -1), np.full(300, np.inf)
    for ray in range(300):
        for kind, start, end, radius, flat in figure_of(ahead[ray], here[ray, 2] + person_figure.MIDDLE * way[ray, 2]):
            squeezed = at[ray] * [flat, 1, 1]
            gap = reach(squeezed, np.array(start, float), np.array(end, float), radius)
            inside = np.flatnonzero(gap < 0)
            if gap.min() > -0.004:
                least[ray] = min(least[ray], abs(gap.min()))
            if len(inside) and steps[inside[0]] < distance[ray]:
                distance[ray], part[ray] = steps[inside[0]], kind
    given = [Vector(*jnp.asarray(vector.T, jnp.float32)) for vector in (here, way)]
    found, normal, kind = jax.jit(person_figure._limbs)(*given, jnp.asarray(ahead, jnp.float32))
    clear = least > 0.004  # no limb is grazed
    met = np.isfinite(distance)
    np.testing.assert_array_equal((np.asarray(found) < 1e8)[clear], met[clear])
    both = clear & met
    assert both.sum() > 60 and (clear & ~met).sum() > 30 and set(part[both]) == set(range(4))
    assert np.abs(np.asarray(found) - distance)[both].max() < 2e-3
    assert (np.asarray(kind).astype(int) == part)[both].mean() > 0.97  # else two limbs begin within a step
    normal = np.stack(normal, -1)[both]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-4)
    assert ((normal * way[both]).sum(1) < 0.05).all()


def test_beside_limbs_is_what_stands_behind(scenario, state, look):
    """Pixels of a person are those of the figure, or equal those of the picture without the person."""
    wall = [(6.0, 0.0, 0.5, 30.0, 9.0)]
    with_one = look(*put(scenario, state, wall, [(2.0, 0.1)]))
    without = look(*put(scenario, state, wall, []))
    person = np.asarray((with_one.semantic == PERSON) & (without.semantic == OBSTACLE))
    same = np.abs(np.asarray(with_one.rgb) - np.asarray(without.rgb)).max(-1) < 1e-5
    assert 0.1 < same[person].mean() < 0.6
    rows, columns = np.nonzero(person)
    middle = np.abs(columns - columns.mean()) < 2
    trunk = middle & (rows < rows.min() + 0.3 * np.ptp(rows))
    assert not same[rows[trunk], columns[trunk]].any()


def test_a_ceiling_is_where_rays_meet_its_height(scenario, state, look):
    """Against points and tiles of the plane in double precision; without a ceiling there is sky; depth sees neither."""
    height = 2.6
    yard, here = put(scenario, state, [], [])
    looks = dataclasses.replace(yard.environment.scenery, ceiling=jnp.float32(height))
    room = yard.replace(environment=dataclasses.replace(yard.environment, scenery=looks))
    indoors, outdoors = look(room, here), look(yard, here)
    for part in ("depth", "semantic", "instance"):
        np.testing.assert_array_equal(getattr(indoors, part), getattr(outdoors, part))
    mount = np.asarray(next(each for each in scenario.robot.mounts if each.name == "depth").origin, float)
    focal = 18 / np.tan(np.pi / 6)
    columns, rows = np.meshgrid(np.arange(48) + 0.5 - 24, np.arange(18) + 0.5 - 18)
    forward = -(height - mount[2]) * focal / rows
    left = -forward * columns / focal
    place, ahead = PLACE.astype(float), AHEAD.astype(float)
    side = np.array([-ahead[1], ahead[0]])
    at = place + (forward + mount[0])[..., None] * ahead + (left + mount[1])[..., None] * side
    u, v = np.moveaxis(at / (pictures.TILE * height), -1, 0)
    to_edge = np.minimum(np.abs(u - np.round(u)), np.abs(v - np.round(v)))
    lamp = (np.mod(u, pictures.LAMP[0]) < 2) & (np.mod(v, pictures.LAMP[1]) < 1) & (to_edge > 0.02)
    rgb = np.asarray(indoors.rgb)[:18]
    clear = (np.abs(to_edge - 0.02) > 0.01) & (forward < 12)
    assert (lamp & clear).sum() > 10 and (~lamp & clear).sum() > 100
    is_lamp = np.abs(rgb - pictures.LAMPS).max(-1) < 1e-4
    np.testing.assert_array_equal(is_lamp[clear], lamp[clear])
    assert np.abs(rgb - np.asarray(outdoors.rgb)[:18]).max(-1).min() > 0.01
    np.testing.assert_array_equal(np.asarray(indoors.rgb)[19:], np.asarray(outdoors.rgb)[19:])


def test_a_ceiling_below_the_camera_hides_nothing(scenario, state, look):
    yard, here = put(scenario, state, [(5.0, 0.0, 0.5, 3.0, 6.0)], [])
    looks = dataclasses.replace(yard.environment.scenery, ceiling=jnp.float32(0.1))
    low = yard.replace(environment=dataclasses.replace(yard.environment, scenery=looks))
    np.testing.assert_array_equal(look(low, here).rgb, look(yard, here).rgb)


@pytest.mark.parametrize("name", quick(["warehouse", "lab", "outdoor"], "warehouse"))
def test_floors_have_the_squares_and_joints_of_their_texture(name):
    """Near by, against a loop over places; squares repeat after two, and lose contrast far away."""
    looks = environment.load(name).scenery
    colors, square, joint = (np.asarray(part, float) for part in (looks.floor, looks.square, looks.joint))
    places = np.random.default_rng(2).uniform(-20, 20, (400, 2))
    paint = jax.jit(lambda x, y, away: jnp.stack(pictures._floor(looks, x, y, away), -1))

    def painted(at, away):
        x, y = jnp.asarray(at, jnp.float32).T
        return np.asarray(paint(x, y, jnp.full(len(at), away, jnp.float32)))

    found, checked = painted(places, 0.0), 0
    for at, color in zip(places, found, strict=True):
        cell, to_edge = at / square, np.abs(at - 2 * square * np.round(at / (2 * square))).min()
        if np.abs(cell - np.round(cell)).min() < 1e-3 or abs(to_edge - joint / 2) < 1e-3:
            continue
        odd = int(np.floor(cell).sum()) % 2
        np.testing.assert_allclose(color, colors[2] if to_edge < joint / 2 else colors[odd], atol=1e-5)
        checked += 1
    assert checked > 300
    clear = (np.abs(places / square - np.round(places / square)) > 2e-2).all(1)
    np.testing.assert_allclose(painted(places + 2 * square, 0.0)[clear], found[clear], atol=1e-5)
    assert np.ptp(painted(places, 60.0), axis=0).max() < 0.1 * np.ptp(colors[:2], axis=0).max() + 1e-6 + joint


def test_shelves_repeat_and_only_sides_with_a_pattern_have_one():
    """Uprights and beams after a bay and a level; a plain body has its own color everywhere."""
    chance = np.random.default_rng(3)
    across, up = (jnp.asarray(chance.uniform(*ends, 500), jnp.float32) for ends in ((-9, 9), (0.0, 4.0)))
    own = tuple(jnp.full(500, part, jnp.float32) for part in (0.2, 0.4, 0.6))

    def paint(pattern, across, up):
        number = jnp.full(500, PATTERNS.index(pattern), jnp.float32)
        return np.stack(jax.jit(pictures._pattern)(own, number, across, up), -1)

    np.testing.assert_array_equal(paint("plain", across, up), np.stack(own, -1))
    shelf = paint("shelf", across, up)
    bay, level = np.asarray(across, float) / pictures.BAY, np.asarray(up, float) / pictures.LEVEL
    upright = np.abs(bay - np.round(bay)) * pictures.BAY < pictures.UPRIGHT / 2
    beam = ~upright & (np.mod(level, 1.0) * pictures.LEVEL < pictures.BEAM)
    assert upright.sum() > 5 and beam.sum() > 10
    np.testing.assert_allclose(shelf[upright], np.stack(own, -1)[upright], atol=1e-6)
    np.testing.assert_allclose(shelf[beam], np.broadcast_to(pictures.BEAM_COLOR, (beam.sum(), 3)), atol=1e-6)
    assert (np.abs(shelf - np.stack(own, -1)).max(1) > 0.05)[~upright].all()
    later = paint("shelf", across + pictures.BAY, up + pictures.LEVEL)
    np.testing.assert_allclose(later[upright | beam], shelf[upright | beam], atol=1e-6)
    wall = paint("wall", across, up)
    assert (wall[np.asarray(up) > pictures.DADO[0]] == np.stack(own, -1)[0]).all()
    assert (wall[np.asarray(up) < pictures.BOARD[0]] < np.stack(own, -1)[0]).all()


def test_feet_swing_by_the_way_that_is_walked(scenario):
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
    people, foot = state.pedestrians, jax.jit(person_figure.left_foot)

    def after(way, speed):
        walked = people.replace(position=people.position + way * people.heading, velocity=speed * people.heading)
        return np.asarray(foot(state.replace(pedestrians=walked)))

    assert np.abs(after(0.3, 0.0)).max() < 1e-5
    first = after(0.0, 1.0)
    np.testing.assert_allclose(after(person_figure.STRIDE / 2, 1.0), -first, atol=2e-3)  # the other foot is ahead
    np.testing.assert_allclose(after(person_figure.STRIDE, 1.0), first, atol=2e-3)
    np.testing.assert_allclose(after(0.0, 0.5), 0.5 * first, atol=1e-3)
    assert np.abs(first).max() <= person_figure.SPREAD + 1e-6 and np.abs(first).max() > 0.1
