"""Physical environments: what is read is what the files say, and what cannot be used is refused in one sentence."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from sean_jax.core.data_types import PATTERNS
from sean_jax.core.errors import FileError
from sean_jax.world import environment
from support import mjcf, programs
from support.scenes import room

YARD = -5, -5, 5, 5


def test_every_environment_of_the_package():
    assert "warehouse" in environment.available() and "robots" not in environment.available()
    for name in environment.available():
        place = environment.load(name)
        assert place.name == name
        assert environment.default_people(environment.find(name)) >= 0
        model = mujoco.MjModel.from_xml_path(str(environment.find(name) / "scene.xml"))
        assert model.ncam > 0 and model.nlight > 0
        assert all(model.geom(index).name for index in range(model.ngeom))


def test_warehouse():
    place = environment.load("warehouse")
    assert environment.default_people(environment.find("warehouse")) == 62
    assert place.obstacles.height.shape == (27,)
    assert np.allclose(place.floor, [-20, -20, 20, 20])
    heights = dict(zip(*np.unique(np.asarray(place.obstacles.height), return_counts=True), strict=True))
    assert {round(float(height), 2): int(number) for height, number in heights.items()} == {
        4.0: 7, 0.9: 9, 0.8: 6, 0.2: 4, 2.0: 1
    }  # fmt: skip
    # Middles of the aisles between racks 4.8 m apart, then: inside a rack, beyond the wall, on the wall's surface.
    points = jnp.array([[-14.9, 4.0], [-4.9, 4.0], [-10.0, 4.0], [0.0, 21.0], [-19.8, -15.0]], jnp.float32)
    found = programs.clearance(place, points)
    np.testing.assert_allclose(found, [2.4, 2.4, -2.5, -1.0, 0.0], atol=1e-5)


def test_turned_box_and_boxes_in_bodies(tmp_path):
    geoms = mjcf.PLANE, mjcf.box((1, 2), (1, 0.25), height=1.0, turn=30), mjcf.BOX_IN_A_BODY, mjcf.DECORATION
    boxes = environment.load(room(tmp_path, YARD, geoms)).obstacles
    boxes = jax.tree.map(lambda part: part[boxes.height > 0], boxes)  # without the edges of the floor
    np.testing.assert_allclose(boxes.center, [[1, 2], [-2, 1]], atol=1e-6)
    np.testing.assert_allclose(boxes.half_extent, [[1, 0.25], [0.5, 0.2]], atol=1e-6)
    np.testing.assert_allclose(boxes.yaw, [np.pi / 6, np.pi / 2], atol=1e-6)
    np.testing.assert_allclose(boxes.height, [1, 2], atol=1e-6)


@pytest.mark.parametrize(("geoms", "message"), mjcf.REFUSED_GEOMS)
def test_unusable_scenes(tmp_path, geoms, message):
    with pytest.raises(FileError) as caught:
        environment.load(room(tmp_path, YARD, [mjcf.PLANE, geoms]))
    text = str(caught.value)
    assert text.startswith(f"{tmp_path.name}/scene.xml: ") and message in text and "\n" not in text


def test_unusable_settings_and_names(tmp_path):
    with pytest.raises(ValueError, match="environment 'warehose' is not one of .*; did you mean 'warehouse'"):
        environment.find("warehose")
    with pytest.raises(ValueError, match="give one of them or a folder with environment.yaml"):
        environment.find("nowhere at all")
    with pytest.raises(ValueError, match="holds no environment.yaml"):
        environment.find(tmp_path)
    room(tmp_path, (5, -5, -5, 5), people=-3)
    with pytest.raises(FileError, match=r"environment.yaml:3:9: people: -3 is less than 0, the least allowed\.$"):
        environment.load(tmp_path)
    room(tmp_path, (5, -5, -5, 5), people=3)
    with pytest.raises(FileError, match=r"environment.yaml:2:8: floor: .* is empty"):
        environment.load(tmp_path)
    room(tmp_path, YARD, name="yard")
    assert environment.load(tmp_path).name == "yard"
    (tmp_path / "scene.xml").unlink()
    with pytest.raises(FileError, match="there is no such file"):
        environment.load(str(tmp_path))


def test_clearance_is_differentiable_and_batched():
    place = environment.load("warehouse")
    points = jnp.array([[-14.9, 4.0], [-7.3, 4.0], [-9.9, 4.4], [20.0, 20.0]], jnp.float32)
    gradient = jax.jit(jax.grad(lambda at: jnp.sum(environment.clearance(place, at))))(points)
    assert np.all(np.isfinite(gradient))
    each = jax.vmap(lambda at: environment.clearance(place, at[None])[0])(points)
    np.testing.assert_allclose(each, programs.clearance(place, points), atol=1e-6)


def test_free_points_are_free_uniform_and_repeatable():
    place = environment.load("warehouse")
    found = environment.free_points(place, 0.3, 1500, seed=1)
    assert found.shape == (1500, 2) and found.dtype == np.float32
    boxes = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), place.obstacles)
    away = np.abs(found[:, None, :] - boxes.center) - boxes.half_extent  # all boxes of the warehouse have yaw 0
    assert np.linalg.norm(np.maximum(away, 0), axis=-1).min() > 0.3 - 1e-4
    assert np.abs(found).max() <= 19.7 + 1e-4
    # The south-east quarter holds as large a share of the points as of the free area on a grid.
    axis = np.arange(-19.95, 20, 0.1)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 1, 2)
    free = np.linalg.norm(np.maximum(np.abs(grid - boxes.center) - boxes.half_extent, 0), axis=-1).min(1) > 0.3
    free &= np.abs(grid[:, 0]).max(-1) < 19.7
    quarter = (grid[:, 0, 0] > 0) & (grid[:, 0, 1] < 0)
    share = (free & quarter).sum() / free.sum()
    assert abs(np.mean((found[:, 0] > 0) & (found[:, 1] < 0)) - share) < 4 * np.sqrt(share * (1 - share) / 1500)
    assert np.array_equal(found, environment.free_points(place, 0.3, 1500, seed=1))
    assert not np.array_equal(found, environment.free_points(place, 0.3, 1500, seed=2))
    assert environment.free_points(place, 0.3, 0).shape == (0, 2)
    with pytest.raises(ValueError, match="use a smaller radius"):
        environment.free_points(place, 6.0, 10)


def looks_of(folder, floor: str):
    """The scenery of a room of one wall, one shelf and a floor with one of ``mjcf.FLOORS``."""
    assets, plane = mjcf.FLOORS[floor]
    geoms = plane, mjcf.box((1, 2), (1, 0.2), height=1.0, name="wall_1"), mjcf.BLUE_TABLE
    room(folder, (-5, -4, 5, 4), geoms, more="ceiling: 2.5\n", assets=mjcf.BLUE + assets)
    return jax.tree.map(np.asarray, environment.load(folder).scenery)


def test_floor_patterns_and_ceiling_come_from_the_files(tmp_path):
    """Squares of half of the texture, joints of its mark, a plain color without a texture; names give patterns."""
    looks = looks_of(tmp_path, "tiles with joints")
    np.testing.assert_allclose(looks.floor, [[0.2] * 3, [0.4] * 3, [1, 0, 0]], atol=0.01)
    assert looks.square == pytest.approx(10 / 4 / 2) and looks.joint == pytest.approx(2 * 2.5 / 50)
    assert looks.ceiling == 2.5
    assert [PATTERNS[int(number)] for number in looks.solids.color[:, 3]] == ["wall", "shelf"]
    looks = looks_of(tmp_path, "tiles by the metre")
    assert looks.square == pytest.approx(1 / 4 / 2) and looks.joint == 0
    looks = looks_of(tmp_path, "one color")
    np.testing.assert_allclose(looks.floor, [[0.1, 0.2, 0.3]] * 3, atol=1e-6)
    looks = looks_of(tmp_path, "no color")
    np.testing.assert_allclose(looks.floor[:2], environment.FLOOR, atol=1e-6)


@pytest.mark.parametrize("height", ["0.5", "low", "1000"])
def test_a_ceiling_nobody_stands_below_is_refused(tmp_path, height):
    looks_of(tmp_path, "no color")
    file = tmp_path / "environment.yaml"
    file.write_text(file.read_text(encoding="utf-8").replace("2.5", height), encoding="utf-8")
    with pytest.raises(FileError) as error:
        environment.load(tmp_path)
    assert "environment.yaml:4" in str(error.value) and "ceiling" in str(error.value) and height in str(error.value)
