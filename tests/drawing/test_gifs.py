"""Videos of what a camera sees: pictures of the right moments, in the right colors."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image

from sean_jax import drawing, sensors
from sean_jax.core.data_types import Array
from sean_jax.drawing import gifs
from sean_jax.simulation.scenario import frame
from sean_jax.world.environment import plain_scenery
from support import programs


@pytest.fixture(scope="module")
def frames(scenario):
    """21 frames in which person 0 walks from 1 m ahead of the robot to 1 m to its left; all others are absent."""
    state = programs.reset(scenario, jax.random.key(3))
    action: Array = jax.device_put(np.zeros(2, np.float32))
    still = jax.tree.map(np.asarray, frame(state, state, action))
    many: Any = jax.tree.map(lambda leaf: np.stack([leaf] * 21), still)
    ahead = still.heading
    left = np.array([-ahead[1], ahead[0]])
    share = np.linspace(0, 1, 21, dtype=np.float32)[:, None]
    people = many.people.copy()
    people[:, 0] = still.position + (1 - share) * ahead + share * left
    present = np.zeros_like(many.present)
    present[:, 0] = True
    return dataclasses.replace(many, people=people, present=present, active=np.ones(21, bool))


@pytest.mark.night
def test_pictures_are_those_of_the_frames(scenario, frames, tmp_path):
    """At 4 times the pace and 5 pictures a second every 8th frame of 0.1 s is shown, and the last."""
    scene = dataclasses.replace(scenario.environment, scenery=plain_scenery(scenario.environment.obstacles))
    grey = dataclasses.replace(scenario, environment=scene)
    eye = sensors.camera(scenario, "overhead", width=256, height=192)  # 32 pixels to the metre, ahead is up
    drawing.video(frames, grey, tmp_path / "camera.gif", view=eye)
    spots = []
    with Image.open(tmp_path / "camera.gif") as gif:
        assert gif.size == (256, 192) and gif.n_frames == 4  # pyright: ignore[reportAttributeAccessIssue]
        for index in range(4):
            gif.seek(index)
            assert gif.info["duration"] == (2000 if index == 3 else 200)
            image = np.asarray(gif.convert("RGB"), int)
            spots.append(image.max(-1) - image.min(-1))  # all is grey but for shirt and skin
    for spot, share in zip(spots, (0.0, 0.4, 0.8, 1.0), strict=True):
        rows, columns = np.nonzero(spot > 40)
        assert np.mean(rows + 0.5) == pytest.approx(96 - 32 * (1 - share), abs=2.8)
        assert np.mean(columns + 0.5) == pytest.approx(128 - 32 * share, abs=2.8)


def test_depth_is_shown_in_colors():
    shown = gifs.depth_colors(np.array([[0.2, 10.0, 20.0]], np.float32), 20.0)[0].astype(int)
    assert shown[0, 2] > shown[0, 0] and shown[1, 0] > shown[1, 2] and (shown[2] == 51).all()


def test_an_unknown_camera_is_refused(scenario, frames, tmp_path):
    with pytest.raises(ValueError, match=r"has no 'thrid_person'; did you mean 'third_person'\?"):
        drawing.video(frames, scenario, tmp_path / "camera.gif", view="thrid_person")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("seed", range(5))
def test_a_gif_keeps_rare_colors_beside_many_shades(seed, tmp_path):
    """40 colors of 24 pixels each, drawn at random, among the shades of a sky and a floor that fill 12 pictures."""
    random = np.random.default_rng(seed)
    rise = np.linspace(0, 1, 120)[:, None, None]
    sky = 255 * (rise * [0.95, 0.97, 1.0] + (1 - rise) * [0.35, 0.55, 0.85])
    light = random.normal(0, 6, (12, 120, 160, 1))
    pictures = np.clip(np.broadcast_to(sky, (12, 120, 160, 3)) + light, 0, 255).astype(np.uint8)
    rare = random.integers(0, 256, (40, 3), dtype=np.uint8)
    for k, color in enumerate(rare):
        pictures[k % 12, 2 * k : 2 * k + 2, 30:42] = color
    gifs.save_gif(tmp_path / "rare.gif", 12, lambda index: Image.fromarray(pictures[index]), 0.2)
    read = read_back(tmp_path / "rare.gif")
    off = [np.abs(read[k % 12, 2 * k, 36] - color).max() for k, color in enumerate(rare.astype(int))]
    assert max(off) <= 20, off
    assert np.abs(read - pictures.astype(int)).mean() <= 4


def read_back(path: Path) -> np.ndarray:
    """(T, H, W, 3) int: the pictures of a GIF."""
    with Image.open(path) as gif:
        pictures = []
        for index in range(gif.n_frames):  # pyright: ignore[reportAttributeAccessIssue]
            gif.seek(index)
            pictures.append(np.asarray(gif.convert("RGB"), int))
    return np.stack(pictures)


def test_people_keep_the_colors_of_their_clothes(scenario, frames, tmp_path):
    """16 people around the robot, each in a color of their own, as rendered and as in the GIF."""
    turn, away = np.arange(16) * np.pi / 8, np.where(np.arange(16) % 2, 1.2, 2.2)
    place = frames.position[0] + np.stack([away * np.cos(turn), away * np.sin(turn)], 1)
    people = np.broadcast_to(place, frames.people.shape).astype(np.float32)
    crowd = dataclasses.replace(frames, people=people, present=np.ones_like(frames.present))
    eye = sensors.camera(scenario, "overhead", width=96, height=72)
    shown = jax.tree.map(lambda leaf: leaf[[0, 8, 16, 20]], crowd)
    rendered = np.stack(list(gifs.render_frames(shown, scenario, eye))).astype(int)
    drawing.video(crowd, scenario, tmp_path / "camera.gif", view=eye)
    off = np.abs(read_back(tmp_path / "camera.gif") - rendered).max(-1)
    least, most = rendered.min(-1), rendered.max(-1)
    hue = np.round(6 * (2 * rendered - least[..., None] - most[..., None]) / np.maximum(most - least, 1)[..., None])
    worn = most - least > 60
    kinds = np.unique(hue[worn], axis=0, return_inverse=True)[1]
    assert len(np.unique(kinds)) >= 6, "people are seen"
    for kind in np.unique(kinds):
        assert off[worn][kinds == kind].mean() <= 12
    assert np.quantile(off[worn], 0.99) <= 24 and off.mean() <= 2
