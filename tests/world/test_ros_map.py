"""ROS maps: read by map_server's rules, described by few boxes, and written as environments that load."""

from importlib import import_module
from typing import Any

import numpy as np
import pytest
from PIL import Image

from sean_jax.cli import command_line
from sean_jax.core.errors import FileError
from sean_jax.world import environment, ros_map
from sean_jax.world import environment as environments
from support.mjcf import CHECKER

mujoco: Any = import_module("mujoco")  # which has no type stubs
OCCUPIED, FREE, UNKNOWN = 0, 254, 205  # as map_saver writes them
SETTINGS = {"image": "plan.pgm", "resolution": 0.1, "origin": [-3.0, -2.0, 0.0], "negate": 0}
SETTINGS |= {"occupied_thresh": 0.65, "free_thresh": 0.196}


def write(folder, shades, **settings):
    """A map file with its image, whose row 0 is at the top."""
    settings = SETTINGS | settings
    Image.fromarray(np.asarray(shades, np.uint8)).save(folder / settings["image"])
    text = "".join(f"{key}: {value}\n" for key, value in settings.items())
    (folder / "plan.yaml").write_text(text, encoding="utf-8")
    return folder / "plan.yaml"


def plan(rows=40, columns=60, boxes=9, seed=0) -> np.ndarray:
    """(rows, columns) shades: walls all around, and boxes at random."""
    shades = np.full((rows, columns), FREE)
    shades[[0, -1]] = shades[:, [0, -1]] = OCCUPIED
    random = np.random.default_rng(seed)
    for row, column in random.integers((4, 4), (rows - 8, columns - 8), (boxes, 2)):
        height, width = random.integers(1, 8, 2)
        shades[row : row + height, column : column + width] = OCCUPIED
    return shades


def covered(boxes, shape) -> np.ndarray:
    """(rows, columns) int: how many boxes cover each cell, painted one by one."""
    count = np.zeros(shape, int)
    for left, low, right, high in boxes:
        count[low:high, left:right] += 1
    return count


@pytest.mark.parametrize("seed", range(8))
def test_rectangles_cover_exactly_what_is_occupied_and_are_few(seed):
    occupied = plan(boxes=4, seed=seed) == OCCUPIED
    boxes = ros_map.rectangles(occupied)
    assert ((covered(boxes, occupied.shape) > 0) == occupied).all()
    assert len(boxes) <= 2 * (4 + 4)  # four walls and four boxes, of which some overlap


def test_any_raster_is_covered():
    random = np.random.default_rng(1)
    for share in (0.02, 0.5, 0.98):
        occupied = random.uniform(size=(23, 17)) < share
        boxes = ros_map.rectangles(occupied)
        assert ((covered(boxes, occupied.shape) > 0) == occupied).all()
        assert len(boxes) <= occupied.sum()
    assert ros_map.rectangles(np.zeros((5, 4), bool)).shape == (0, 4)
    assert ros_map.rectangles(np.ones((5, 4), bool)).tolist() == [[0, 0, 4, 5]]


def test_a_cross_takes_two_overlapping_boxes():
    occupied = np.zeros((9, 9), bool)
    occupied[4], occupied[:, 4] = True, True
    assert sorted(ros_map.rectangles(occupied).tolist()) == [[0, 4, 9, 5], [4, 0, 5, 9]]


def test_slivers_are_left_out_and_lone_cells_are_kept():
    occupied = np.zeros((30, 30), bool)
    occupied[5:15, 5:25] = True
    occupied[15, 7], occupied[15, 12:14] = True, True  # the rough edge of a wall
    occupied[25, 20] = True  # a thin post
    boxes = ros_map.rectangles(occupied, spare=4)
    assert sorted(boxes.tolist()) == [[5, 5, 25, 15], [20, 25, 21, 26]]
    assert len(ros_map.rectangles(occupied, spare=2)) == 3 and len(ros_map.rectangles(occupied)) == 4


@pytest.mark.parametrize(
    ("settings", "shade", "means"),
    [
        ({}, 0, "occupied"),
        ({}, 254, "free"),
        ({}, 205, "unknown"),  # (255 - 205) / 255 = 0.1961 is more than 0.196
        ({"free_thresh": 0.25}, 205, "free"),
        ({"negate": 1}, 254, "occupied"),
        ({"negate": "true"}, 0, "free"),
        ({"mode": "scale"}, 100, "occupied"),  # 99 (0.608 - 0.196) / (0.65 - 0.196) = 90
        ({"mode": "scale"}, 180, "free"),  # 99 (0.294 - 0.196) / 0.454 = 21
        ({"mode": "raw"}, 100, "occupied"),
        ({"mode": "raw"}, 64, "free"),
        ({"mode": "raw"}, 255, "unknown"),
        ({"occupied_thresh": 0.5, "free_thresh": 0.5}, 128, "free"),
        ({"occupied_thresh": 0.5, "free_thresh": 0.5}, 127, "occupied"),
    ],
)
def test_shades_mean_what_map_server_says(tmp_path, settings, shade, means):
    raster = ros_map.read_map(write(tmp_path, np.full((2, 3), shade), **settings))
    assert raster.occupied.shape == (2, 3) and raster.resolution == 0.1
    assert raster.occupied.all() == raster.occupied.any() == (means == "occupied")
    assert raster.unknown.all() == raster.unknown.any() == (means == "unknown")


def test_colors_are_averaged_and_transparent_pixels_are_unknown(tmp_path):
    shades = np.zeros((1, 3, 4), np.uint8)
    shades[0, 0] = (0, 0, 255, 255)  # mean 85: p = 0.67
    shades[0, 1] = (255, 255, 120, 255)  # mean 210: p = 0.18
    raster = ros_map.read_map(write(tmp_path, shades, image="plan.png"))
    assert raster.occupied.tolist() == [[True, False, False]] and raster.unknown.tolist() == [[False, False, True]]


def test_first_row_of_the_image_is_the_highest(tmp_path):
    shades = np.full((40, 60), FREE)
    shades[0:5, 0:10] = OCCUPIED  # the upper left corner
    found = ros_map.import_map(write(tmp_path, shades), tmp_path / "place")
    boxes = environments.load(found.folder).obstacles
    np.testing.assert_allclose(boxes.center[:1], [[-2.5, 1.75]], atol=1e-6)  # after it come the edges of the floor
    np.testing.assert_allclose(boxes.half_extent[:1], [[0.5, 0.25]], atol=1e-6)
    np.testing.assert_allclose(environments.load(found.folder).floor, [-3, -2, 3, 2], atol=1e-6)


@pytest.mark.parametrize("unknown", ["obstacle", "free"])
def test_an_imported_map_is_the_map_again(tmp_path, unknown):
    shades = plan(100, 120, 30)
    shades[60:70, 20:30] = UNKNOWN
    found = ros_map.import_map(write(tmp_path, shades), tmp_path / "new" / "place", unknown=unknown, height=1.5)
    place = environments.load(found.folder)
    solid = (shades == OCCUPIED) | ((shades == UNKNOWN) & (unknown == "obstacle"))
    # Independently of the import: the signed distance at the middle of each cell.
    x, y = np.meshgrid(-3 + 0.1 * (np.arange(120) + 0.5), -2 + 0.1 * (np.arange(100)[::-1] + 0.5))
    points = np.stack([x, y], -1).reshape(-1, 2).astype(np.float32)
    away = np.abs(points[:, None] - np.asarray(place.obstacles.center)) - np.asarray(place.obstacles.half_extent)
    agreement = np.mean((away.max(-1).min(1) < 0) == solid.reshape(-1))
    assert agreement == found.agreement >= 0.995 and found.cells == 12000
    assert found.boxes == len(place.obstacles.yaw) <= 2 * 34 and np.allclose(place.obstacles.height, 1.5)
    assert found.people == environments.default_people(found.folder) == round(0.01 * (~solid).sum() / 25)
    assert place.name == "place" and sorted(item.name for item in found.folder.parent.iterdir()) == ["place"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"image": "plan.pgm", "resolution": 0},
            "plan.yaml:2:13: resolution: 0 is less than 0.001, the least allowed.",
        ),
        (
            {"image": "plan.pgm", "resolution": 5},
            "plan.yaml:2:13: resolution: a pixel of 5 m is larger than a door is wide; give metres a pixel, such as "
            "0.05, and 0.5 at most.",
        ),
        ({"origin": [0, 0, 0.5]}, "origin[2]: the map is turned by 0.5 rad; turn its image and give 0."),
        ({"free_thresh": 0.7}, "free_thresh: 0.7 is more than occupied_thresh; exchange them."),
        ({"mode": "trinry"}, "mode: 'trinry' is not one of trinary, scale, raw; did you mean 'trinary'?"),
        ({"negate": 1}, "plan.yaml: no cell is an obstacle; look at negate and the thresholds."),
    ],
)
def test_maps_that_cannot_be_used(tmp_path, settings, message):
    path = write(tmp_path, np.zeros((4, 4)), **settings)
    with pytest.raises(ValueError) as caught:
        ros_map.import_map(path, tmp_path / "place")
    assert message in str(caught.value) and len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "place").exists()


def test_images_that_cannot_be_read(tmp_path):
    path = write(tmp_path, plan())
    (tmp_path / "plan.pgm").write_bytes(b"P5 4 4 255\n")
    with pytest.raises(FileError, match="plan.pgm: is damaged; save it again as a PGM or PNG file"):
        ros_map.read_map(path)
    (tmp_path / "plan.pgm").unlink()
    with pytest.raises(FileError, match="plan.yaml: image: there is no file .*plan.pgm"):
        ros_map.read_map(path)


@pytest.mark.parametrize("suffix", ["png", "pgm", "bmp", "gif", "jpg", "tif"])
def test_an_image_in_place_of_its_yaml_file(tmp_path, suffix):
    path = tmp_path / f"plan.{suffix}"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8)).save(path)
    with pytest.raises(FileError, match=f"plan.{suffix}: is an image; give the map's YAML file, which names it"):
        ros_map.read_map(path)


def test_command(tmp_path, capsys):
    path = write(tmp_path, plan())
    arguments = ["import-map", str(path), "--out", str(tmp_path / "place"), "--people", "3"]
    assert command_line.main(arguments) == 0
    said = capsys.readouterr().out
    assert "boxes describe 100.00 % of the map's 2400 cells" in said or "boxes describe 99." in said
    assert environments.default_people(tmp_path / "place") == 3
    assert command_line.main(arguments) == 2
    error = capsys.readouterr().err
    assert "is not empty; give the name of a new folder" in error and len(error.splitlines()) == 1
    assert command_line.main(["import-map", str(tmp_path / "plam.yaml"), "--out", str(tmp_path / "b")]) == 2
    assert "did you mean 'plan.yaml'?" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_a_link_as_the_folder_of_a_map(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert command_line.main(["import-map", str(write(tmp_path, plan())), "--out", str(tmp_path / "link")]) == 0
    assert (tmp_path / "link").is_symlink() and environments.load(tmp_path / "real").obstacles.yaw.shape[0] > 0


@pytest.mark.parametrize("people", [2.5, "3", True, -1])
def test_people_of_a_map_are_a_whole_number(tmp_path, people):
    with pytest.raises(ValueError, match="^people: .* must be "):
        ros_map.import_map(write(tmp_path, plan()), tmp_path / "place", people=people)
    assert not (tmp_path / "place").exists()


def test_a_floor_has_its_darkest_and_lightest_color():
    """By all three channels together, whatever their order: green is lighter than red when there is more of it."""
    model = mujoco.MjModel.from_xml_string(CHECKER)
    found = environment._texture(model, "2d")
    assert found is not None
    np.testing.assert_allclose(found, [[0.4, 0, 0], [0.2, 1, 1]], atol=0.01)
