"""Looping GIFs of one episode: from above, and as a camera of the robot sees it (section IV-F)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from sean_jax.core.data_types import Array, Environment, Pedestrians, Robot, Scenario, State, Trajectory
from sean_jax.drawing import colors, layers
from sean_jax.graph import BehaviorGraph
from sean_jax.io.writing import check_file
from sean_jax.sensors import Camera, camera, depth, render

if TYPE_CHECKING:
    from PIL import Image, ImageDraw, ImageFont

Target = str | os.PathLike[str] | BinaryIO  # where a GIF is written
COLORS = 255  # of the palette: one of GIF's 256 stays free, to mark pixels that have not changed
FLAT_COLORS = 128  # of a picture from above: colors.py, and the colors between them at smooth edges
MAX_SAMPLES = 24  # pictures from which the palette is made
SAMPLE = 500_000  # pixels that stand for theirs; all ten million took most of the time of a film
TAIL = 2.0  # s, of the line behind a person
SUPERSAMPLING = 2  # a camera's pictures are rendered with this many times the pixels each way, then averaged
RATE = 5.0  # pictures a second of a camera's film
SPEED = 4.0  # films are as many times faster than the episode
LAST = 2.0  # s, for which the last picture is shown
WIDTH = 320  # pixels, of a camera that is named
HEIGHT = 240


def animate(
    environment: Environment,
    frames: Trajectory,
    path: Target,
    *,
    graph: BehaviorGraph | None = None,
    situations: Sequence[str] | None = None,
    time_step: float = 0.1,
    robot_radius: ArrayLike = layers.ROBOT_RADIUS,
    every: int = 5,
    size: int = 640,
    title: str = "",
) -> None:
    """Write one episode from above, frames (T, ...), as a GIF.

    Args:
        path: a path or a binary file.
        situations: names of the frames' situations; the paper's five, or numbers, if None.
        time_step: s, between two frames.
        robot_radius: m, of all robots, or (1 + R,) of the robot and the other ones of its team.
        every: frames from one picture to the next; the last frame is always shown.
        size: width in pixels.

    Raises:
        InputError: frames with a batch axis or another number of situations, or a path that cannot be written.
    """
    check_gif_path(path)
    frames = layers.one_episode(frames)
    names = layers.situation_names(frames, situations)
    film = _Film(environment, frames, graph, names, time_step, robot_radius, size, title, every)
    steps = _steps_of_film(frames, every)
    pause = every * time_step / SPEED
    save_gif(path, len(steps), lambda index: film.picture(steps[index]), pause, colors=FLAT_COLORS)


def _steps_of_film(frames: Trajectory, every: int) -> list[int]:
    """The steps of one episode that a film shows: each ``every``-th, and the last."""
    last = len(frames.active) - 1
    return [*range(0, last, every), last]


def video(frames: Trajectory, scenario: Scenario, path: Target, *, view: str | Camera = "first_person") -> None:
    """Render one episode, frames (T, ...), from a camera of the robot as a GIF, with the sensors' rays.

    Args:
        path: a path or a binary file.
        view: name of a camera, for pictures of 320 x 240 pixels, or a camera of ``sensors.camera``. Depth is shown
            in colors, blue near and red far.

    Raises:
        InputError: frames with a batch axis, an unknown camera, or a path that cannot be written.
    """
    from PIL import Image

    check_gif_path(path)
    if isinstance(view, str):
        view = camera(scenario, view, width=WIDTH, height=HEIGHT)
    frames = layers.one_episode(frames)
    every = max(1, round(SPEED / RATE / scenario.time_step))
    steps = _steps_of_film(frames, every)
    shown = jax.tree.map(lambda leaf: leaf[steps], frames)
    pictures = [Image.fromarray(picture) for picture in render_frames(shown, scenario, view)]
    pause = every * scenario.time_step / SPEED
    save_gif(path, len(pictures), pictures.__getitem__, pause)


def check_gif_path(path: Target) -> None:
    """Raise InputError if a GIF cannot be written to a path; binary files pass."""
    if isinstance(path, str | os.PathLike):
        check_file(Path(path), (".gif",), "path")


def save_gif(
    path: Target, number: int, picture: Callable[[int], Image.Image], pause: float, colors: int = COLORS
) -> None:
    """Write a looping GIF with one palette, which covers rare colors too (a yellow shirt among shades of sky).

    Args:
        picture: gives the picture of an index (PIL, RGB); called twice for some.
        pause: s, for which each picture is shown, rounded to hundredths; the last one is shown for ``LAST``.
    """
    from PIL import Image

    # One palette for all pictures, from some of them.
    samples = np.linspace(0, number - 1, min(MAX_SAMPLES, number)).round().astype(int)
    sampled = [np.asarray(picture(int(index)).convert("RGB")) for index in samples]
    pixels = _fewer_pixels(np.concatenate(sampled))
    palette = Image.fromarray(pixels).quantize(colors, method=Image.Quantize.MAXCOVERAGE, kmeans=1)

    images = []
    for index in range(number):
        image = picture(index).convert("RGB")
        images.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
    first, *following = images
    milliseconds = max(20, round(100 * pause) * 10)
    pauses = [milliseconds] * (number - 1) + [round(1000 * LAST)]
    first.save(path, format="GIF", save_all=True, append_images=following, duration=pauses, loop=0, optimize=False)


def _fewer_pixels(pixels: np.ndarray) -> np.ndarray:
    """(1, P, 3) about ``SAMPLE`` pixels of pictures (H, W, 3): all of their colors, by their shares of the area."""
    shades = pixels.reshape(-1, 3).astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)
    counts = np.bincount(shades)
    colors = np.flatnonzero(counts)
    repeats = -(-counts[colors] * SAMPLE // len(shades))
    sample = np.repeat(colors, repeats)
    red = sample >> 16
    green = sample >> 8 & 255
    blue = sample & 255
    return np.stack([red, green, blue], -1)[None].astype(np.uint8)


# ------------------------------------------------------------------ from above


FLIP = np.array([1.0, -1.0])  # y points down in pictures
BODY_ANGLES = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
BODY = np.stack([layers.DEPTH * np.cos(BODY_ANGLES), np.sin(BODY_ANGLES)], 1)  # (24, 2) ahead and aside
START_RADIUS = 0.42  # m
GOAL_RADIUS = 0.75  # m
TARGET_RADIUS = 0.28  # m


class _Background:
    """The floor without people and robots, and its scale, at twice the size: halving a picture smooths its edges."""

    def __init__(self, environment: Environment, graph: BehaviorGraph | None, size: int) -> None:
        from PIL import Image

        figure, axes = layers.canvas(environment, 6.4, "")
        layers.draw_obstacles(axes, environment)
        if graph is not None:
            layers.draw_graph(axes, graph, alone=False)
        layers.draw_scale(axes, environment)
        figure.set_dpi(2 * size / 6.4)
        figure.canvas.draw()
        self.image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())  # pyright: ignore
        self.to_pixels = axes.transData.transform
        metre = self.to_pixels((1.0, 0.0)) - self.to_pixels((0.0, 0.0))
        self.metre = float(metre[0])  # pixels
        self.line = max(2, round(self.metre * 0.07))  # pixels

    def pixels(self, points: ArrayLike) -> np.ndarray:
        """Points (..., 2) [m] as pixels from the upper left corner."""
        points = np.asarray(points, float)
        corner = np.array([0.0, self.image.height])
        pixels = self.to_pixels(points.reshape(-1, 2)).reshape(points.shape)
        return corner + FLIP * pixels


class _Caption:
    """Below the floor: title and time in the middle, current situations at the right."""

    def __init__(self, frames: Trajectory, situations: tuple[str, ...], time_step: float, size: int, title: str):
        from matplotlib import get_data_path
        from PIL import ImageFont

        font = Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
        self.font = ImageFont.truetype(str(font), round(size / 22))
        self.small_font = ImageFont.truetype(str(font), round(size / 32))
        self.flags = np.asarray(frames.situations, bool)
        self.situations = list(zip(situations, colors.situation_colors(situations), strict=True))
        self.time_step = time_step
        self.title = title

    def draw(self, draw: ImageDraw.ImageDraw, size: tuple[int, int], t: int) -> None:
        """Draw the caption of frame ``t`` on a picture of a size in pixels."""
        width, height = size
        font = self.font
        baseline = height - 0.6 * font.size
        time = f"{t * self.time_step:.1f} s"
        draw.text((0.30 * width, baseline), time, font=font, fill=colors.INK, anchor="rs")
        title_start = 0.33 * width
        if self.title:
            draw.text((title_start, baseline), self.title, font=font, fill=colors.MUTED, anchor="ls")
        title_end = title_start + draw.textlength(self.title, font=font) + font.size
        right = width * (1 - layers.MARGIN)
        room = right - title_end

        # Situations in one row, or smaller in as many rows as needed.
        holding = [situation for flag, situation in zip(self.flags[t], self.situations, strict=True) if flag]
        rows = [holding]
        if _row_length(draw, holding, font) > room:
            font = self.small_font
            rows = _break_rows(draw, holding, font, room)
        for up, row in enumerate(reversed(rows)):
            x = right - _row_length(draw, row, font)
            y = baseline - 1.2 * up * font.size
            for name, color in row:
                label = name.replace("_", " ")
                draw.text((x, y), label, font=font, fill=color, anchor="ls")
                x += draw.textlength(label, font=font) + font.size


def _break_rows(draw: ImageDraw.ImageDraw, situations: list, font: ImageFont.FreeTypeFont, width: float) -> list[list]:
    """The situations in rows of a width in pixels."""
    rows: list[list] = [[]]
    for situation in situations:
        if rows[-1] and _row_length(draw, [*rows[-1], situation], font) > width:
            rows.append([])
        rows[-1].append(situation)
    return rows


def _row_length(draw: ImageDraw.ImageDraw, situations: list, font: ImageFont.FreeTypeFont) -> float:
    """Width in pixels of the names of situations in one row."""
    labels = [name.replace("_", " ") for name, _ in situations]
    lengths = (draw.textlength(label, font=font) + font.size for label in labels)
    return sum(lengths) - font.size


class _Film:
    """One episode from above. All positions are in pixels, at twice the size of the pictures."""

    def __init__(
        self,
        environment: Environment,
        frames: Trajectory,
        graph: BehaviorGraph | None,
        situations: tuple[str, ...],
        time_step: float,
        robot_radius: ArrayLike,
        size: int,
        title: str,
        every: int,
    ) -> None:
        self.background = _Background(environment, graph, size)
        self.caption = _Caption(frames, situations, time_step, size, title)
        self.metre = self.background.metre
        self.line = self.background.line
        pixels = self.background.pixels
        self.every = every
        self.tail = round(TAIL / time_step)

        # People.
        self.people = pixels(frames.people)
        self.group = frames.group
        self.present = np.asarray(frames.present, bool)
        heading = FLIP * frames.people_heading
        tick = 1.9 * layers.PERSON_RADIUS * self.metre  # pixels
        self.heading_ends = self.people + heading * tick

        # The robot and the other ones of its team.
        others = layers.other_robots(frames)  # (R, T, 6)
        radii = np.broadcast_to(robot_radius, 1 + len(others)) * self.metre
        radii = np.maximum(radii, 2.0 * self.line)
        self.radius = float(radii[0])
        self.other_radii = radii[1:]
        self.path = pixels(frames.position)
        self.heading = FLIP * frames.heading
        self.path_colors = layers.step_colors(frames, situations)
        self.others = pixels(others[..., :2])
        other_headings = FLIP * others[..., 2:4]
        self.other_noses = self.others + other_headings * (2.2 * self.other_radii[:, None, None])
        self.goals = [pixels(frames.goal[-1]), *pixels(others[:, -1, 4:])]

    def picture(self, t: int) -> Image.Image:
        """Frame ``t``, with people and robot."""
        from PIL import ImageDraw

        image = self.background.image.copy()
        draw = ImageDraw.Draw(image)
        self._draw_goals(draw)
        self._draw_path(draw, t)
        self._draw_tails(draw, t)
        self._draw_people(draw, t)
        for path, noses, radius in zip(self.others, self.other_noses, self.other_radii, strict=True):
            self._draw_robot(draw, path[t], noses[t], radius)
        place = self.path[t]
        nose = place + self.heading[t] * 2.2 * self.radius
        self._draw_robot(draw, place, nose, self.radius)
        self.caption.draw(draw, self.background.image.size, t)
        return image.reduce(2)

    def _draw_goals(self, draw: ImageDraw.ImageDraw) -> None:
        """The robot's start, and the goals of all robots, of which its own is bolder."""
        bold = 2 * self.line
        _disc(draw, self.path[0], START_RADIUS * self.metre, outline=colors.ROBOT, width=bold)
        width = bold
        for goal in self.goals:
            _disc(draw, goal, GOAL_RADIUS * self.metre, outline=colors.ROBOT, width=width)
            _disc(draw, goal, TARGET_RADIUS * self.metre, fill=colors.ROBOT)
            width = self.line

    def _draw_path(self, draw: ImageDraw.ImageDraw, t: int) -> None:
        for first in range(0, t, self.every):
            last = min(first + self.every, t)
            draw.line([*self.path[first], *self.path[last]], fill=self.path_colors[last], width=3 * self.line)

    def _draw_tails(self, draw: ImageDraw.ImageDraw, t: int) -> None:
        """Where people walked in the last seconds; those who have just entered have no tail yet."""
        ticks = slice(max(0, t - self.tail), t + 1)
        tails = self.people[ticks][:: max(1, self.tail // 5)]
        if len(tails) < 2:
            return
        complete = np.all(self.present[ticks], axis=0)
        for person in np.flatnonzero(self.present[t] & complete):
            draw.line([tuple(place) for place in tails[:, person]], fill=colors.TRAIL, width=self.line)

    def _draw_people(self, draw: ImageDraw.ImageDraw, t: int) -> None:
        """Shoulders, with a tick along the heading."""
        for person in np.flatnonzero(self.present[t]):
            place = self.people[t, person]
            end = self.heading_ends[t, person]
            draw.line([*place, *end], fill=colors.PERSON_EDGE, width=self.line)

            # The outline of the shoulders, ahead along x and aside along y.
            tick = end - place
            x, y = tick / max(float(np.hypot(*tick)), 1e-9)
            axes = np.array([(x, y), (-y, x)])
            outline = place + layers.PERSON_RADIUS * self.metre * (BODY @ axes)
            corners = [tuple(corner) for corner in outline]
            face = colors.PERSON
            if self.group[t, person] >= 0:
                face = colors.MEMBER
            draw.polygon(corners, fill=face, outline=colors.PERSON_EDGE, width=self.line)

    def _draw_robot(self, draw: ImageDraw.ImageDraw, place: np.ndarray, nose: np.ndarray, radius: float) -> None:
        _disc(draw, place, layers.HALO * self.metre, outline=colors.ROBOT, width=self.line)
        _disc(draw, place, radius, fill=colors.ROBOT, outline=colors.ROBOT_EDGE, width=self.line)
        draw.line([*place, *nose], fill=colors.ROBOT_EDGE, width=self.line)


def _disc(draw: ImageDraw.ImageDraw, place: np.ndarray, radius: float, **style: Any) -> None:
    x, y = place
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), **style)


# ------------------------------------------------------------------ from a camera


def render_frames(frames: Trajectory, scenario: Scenario, eye: Camera) -> Iterator[np.ndarray]:
    """Pictures (H, W, 3) uint8 of frames (T, ...), as the camera sees them by the sensors' rays."""
    fine = eye.resized(SUPERSAMPLING * eye.width, SUPERSAMPLING * eye.height)

    @jax.jit
    def picture(frame: Trajectory) -> Array:
        state = _state(frame)
        if eye.name == "depth":
            return depth(scenario, state, eye)
        rgb = render(scenario, state, fine).rgb
        blocks = rgb.reshape(eye.height, SUPERSAMPLING, eye.width, SUPERSAMPLING, 3)
        return blocks.mean((1, 3))

    for t in range(len(frames.active)):
        frame = jax.tree.map(lambda leaf, t=t: jnp.asarray(leaf[t]), frames)
        image = np.asarray(picture(frame))
        if eye.name == "depth":
            yield depth_colors(image, eye.far)
        else:
            yield (255 * image + 0.5).astype(np.uint8)


def depth_colors(image: np.ndarray, far: float) -> np.ndarray:
    """Depths (H, W) [m] as colors (H, W, 3) uint8: blue near, red far, dark grey from ``far`` [m] on."""
    from matplotlib import colormaps

    share = np.clip(image / far, 0.0, 1.0)
    shades = colormaps["turbo"](np.sqrt(share))[..., :3]
    shades = np.where(image[..., None] < far, shades, 0.2)
    return (255 * shades + 0.5).astype(np.uint8)


def _state(frame: Trajectory) -> State:
    """The fields of a state that a camera reads; all others are None."""
    nothing: Any = None
    people: dict[str, Any] = dict.fromkeys(Pedestrians.__dataclass_fields__, nothing)
    people |= dict(position=frame.people, velocity=frame.people_velocity, heading=frame.people_heading)
    people |= dict(group=frame.group, present=frame.present)

    state: dict[str, Any] = dict.fromkeys(State.__dataclass_fields__, nothing)
    state["situations"] = frame.situations
    state["robot"] = Robot(frame.position, frame.heading, nothing, nothing, nothing)
    state["pedestrians"] = Pedestrians(**people)
    return State(**state)
