"""Pictures show what happened: every mark stands where the frame says, in the color of its situation."""

import sys
from typing import Any

import jax
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image

from sean_jax import drawing
from sean_jax.core.errors import InputError
from sean_jax.drawing import colors, layers
from support.drawn import STEPS, Graph, environment, frames, shade_at


def test_step_colors_take_the_first_situation_that_holds():
    shades = layers.step_colors(frames(), tuple(colors.SITUATION_COLORS))
    assert shades[0] == colors.SITUATION_COLORS["empty"]
    assert shades[27] == colors.SITUATION_COLORS["cross_path"]
    assert shades[35] == colors.NO_SITUATION


def test_situation_colors_differ_for_the_users_own_situations():
    names = (*colors.SITUATION_COLORS, "queue", "doorway")
    assert len(set(drawing.situation_colors(names))) == len(names)


@pytest.mark.parametrize("choose", [drawing.situation_colors, drawing.policy_colors])
def test_any_number_of_the_users_names_has_colors_of_its_own(choose):
    names = [*colors.SITUATION_COLORS, *colors.POLICY_COLORS, *(f"mine_{index}" for index in range(40))]
    shades = choose(names)
    assert len(set(shades)) == len(names)
    assert all(to_hex(shade) == shade for shade in shades)
    assert choose(["mine", "mine"])[0] == choose(["mine", "mine"])[1]


def test_frames_of_the_users_situations_are_drawn_with_their_names(tmp_path):
    """Seven situations, of which the paper has none; and a scenario that has none at all."""
    names = tuple(f"mine {index}" for index in range(7))
    flags = np.zeros((STEPS, 7), bool)
    flags[10:20, 6] = True
    mine = frames().replace(situations=flags)
    figure = drawing.top_down(environment(), frames=mine, situations=names)
    legend: Any = figure.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()][5:] == ["mine 6", "none"]
    assert shade_at(figure, *mine.position[15]) == drawing.situation_colors(names)[6]
    drawing.animate(environment(), mine, tmp_path / "mine.gif", situations=names, every=20, size=100)
    unnamed = drawing.top_down(environment(), frames=mine).axes[0].get_legend()
    assert unnamed is not None and "situation 7" in [text.get_text() for text in unnamed.get_texts()]
    for number in (5, 8):
        with pytest.raises(InputError, match=rf"situations: {number} names for frames with 7 situations; give one"):
            drawing.top_down(environment(), frames=mine, situations=["x"] * number)
    none = frames().replace(situations=np.zeros((STEPS, 0), bool))
    assert layers.step_colors(none, ()) == [colors.NO_SITUATION] * STEPS
    drawing.animate(environment(), none, tmp_path / "none.gif", every=20, size=100)


def test_episode_is_cut_after_its_last_active_step():
    assert len(layers.one_episode(frames()).active) == 36


def test_top_down_puts_the_marks_where_the_frames_say():
    figure = drawing.top_down(environment(), frames=frames())
    last = frames().position[35]
    assert shade_at(figure, last[0] - 0.05, last[1] - 0.05) == colors.ROBOT
    halo = shade_at(figure, last[0] - 0.4, last[1] - 0.4)
    assert halo not in (colors.ROBOT, colors.FLOOR), "the robot is as large as it is, with a halo around it"
    for who, shade in ((1, colors.MEMBER), (0, colors.PERSON)):
        ahead = frames().people_heading[35, who]
        assert shade_at(figure, *(frames().people[35, who] - 0.05 * ahead)) == shade
        aside = 0.2 * np.array([-ahead[1], ahead[0]])
        assert shade_at(figure, *(frames().people[35, who] + aside)) == shade, "shoulders are wide"
        assert shade_at(figure, *(frames().people[35, who] - 0.2 * ahead)) != shade, "and not deep"
    assert shade_at(figure, -3.0, 0.0) == colors.SITUATION_COLORS["empty"]
    assert shade_at(figure, *frames().position[22]) == colors.SITUATION_COLORS["cross_path"]
    assert shade_at(figure, -3.0, -4.5) == colors.FLOOR


def test_obstacles_are_turned_and_darker_where_higher():
    figure = drawing.top_down(environment())
    high, low, floor = (int(shade_at(figure, *p)[1:3], 16) for p in ((0.0, 3.0), (-4.0, -2.0), (4.0, -4.0)))
    assert high < low < floor
    along = np.array([-np.sin(np.pi / 4), np.cos(np.pi / 4)])  # the long side of the turned box
    assert shade_at(figure, *(np.array([-4.0, -2.0]) + 0.9 * along)) != colors.FLOOR
    assert shade_at(figure, -4.0, -2.0 + 0.95) == colors.FLOOR  # inside only if it were not turned


def test_graph_draws_an_arrow_for_the_one_way_edge_alone_and_names_the_nodes():
    axes = drawing.top_down(environment(), graph=Graph).axes[0]
    arrows = [text for text in axes.texts if getattr(text, "arrow_patch", None) is not None]
    assert len(arrows) == 1
    tip: Any = arrows[0].xy  # pyright: ignore[reportAttributeAccessIssue]
    assert tip[0] > 0.0  # from west to east, past the middle
    assert {"west", "east", "talk"} <= {text.get_text() for text in axes.texts}


def test_maps_have_row_zero_lowest():
    density = np.zeros((10, 12))
    density[0, 11] = 5.0
    figure = drawing.congestion_map(environment(), density)
    assert shade_at(figure, 5.5, -4.5) == colors.HEAT[-1]
    assert shade_at(figure, 5.5, 4.5) == colors.FLOOR


def test_animation_shows_every_nth_frame_and_the_last(tmp_path):
    path = tmp_path / "episode.gif"
    drawing.animate(environment(), frames(), path, graph=Graph, every=5, size=600)
    with Image.open(path) as gif:
        count = gif.n_frames  # pyright: ignore[reportAttributeAccessIssue]
        first = gif.convert("RGB")
        gif.seek(count - 1)
        last = gif.convert("RGB")
    assert count == 8  # frames 0, 5, ..., 30 and 35
    x, scale = frames().position[35][0] - 0.08, 600 / (12.0 * (1 + 2 * layers.MARGIN))  # pixels a metre
    there = (round((x + 6.0 + 12.0 * layers.MARGIN) * scale), round((5.0 + 12.0 * layers.MARGIN) * scale))
    orange = np.array([0xF5, 0x8A, 0x07])
    assert np.abs(np.array(last.getpixel(there)) - orange).max() < 40
    assert np.abs(np.array(first.getpixel(there)) - orange).max() > 100


def test_a_batch_of_frames_is_refused():
    from jax import tree

    batch = tree.map(lambda leaf: np.stack([leaf, leaf]), frames())
    with pytest.raises(ValueError, match="one leading axis, these have 2"):
        drawing.top_down(environment(), frames=batch)


def test_pyplot_is_left_alone():
    before = "matplotlib.pyplot" in sys.modules
    drawing.top_down(environment(), frames=frames())
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_a_trajectory_is_drawn_without_its_scenario_too():
    bare = drawing.view(frames())
    assert isinstance(bare, Figure) and len(bare.axes) >= 1


def test_who_leaves_and_comes_in_elsewhere_has_two_trails():
    """Even if the person is away for a single one of many frames."""
    steps = 1000
    long = jax.tree.map(lambda rows: np.repeat(np.asarray(rows)[:1], steps, 0), frames())
    people, present = np.array(long.people, float), np.ones(long.present.shape, bool)
    people[:, 0, 0] = np.where(np.arange(steps) < 501, -3.0, 3.0)
    for gap in (500, 501):
        present[:, 0] = np.arange(steps) != gap
        axes = Figure().add_subplot()
        layers.draw_trails(axes, long.replace(people=people, present=present), steps)
        lengths = [np.ptp(np.asarray(path.vertices), axis=0).max() for path in axes.collections[0].get_paths()]
        assert len(lengths) > 200 and max(lengths) < 1.0
