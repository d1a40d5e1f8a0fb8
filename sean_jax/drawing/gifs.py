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
RATE, SPEED = 5.0, 4.0  # pictures a second of a camera's film; films are as many times faster than the episode
LAST = 2.0  # s, for which the last picture is shown
WIDTH, HEIGHT = 320, 240  # pixels, of a camera that is named


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
    check(path)
    frames = layers.one_episode(frames)
    names = layers.situation_names(frames, situations)
    scene = _Scene(environment, frames, graph, names, time_step, robot_radius, size, title, every)
    steps = [*range(0, len(frames.active) - 1, every), len(frames.active) - 1]
    save(path, len(steps), lambda index: scene.picture(steps[index]), every * time_step / SPEED, colors=FLAT_COLORS)


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

    check(path)
    eye = camera(scenario, view, width=WIDTH, height=HEIGHT) if isinstance(view, str) else view
    frames = layers.one_episode(frames)
    every = max(1, round(SPEED / RATE / scenario.time_step))
    steps = [*range(0, len(frames.active) - 1, every), len(frames.active) - 1]
    rendered = render_frames(jax.tree.map(lambda leaf: leaf[steps], frames), scenario, eye)
    pictures = [Image.fromarray(picture) for picture in rendered]
    save(path, len(pictures), pictures.__getitem__, every * scenario.time_step / SPEED)


def check(path: Target) -> None:
    """Raise InputError if a GIF cannot be written to a path; binary files pass."""
    if isinstance(path, str | os.PathLike):
        check_file(Path(path), (".gif",), "path")


def save(path: Target, number: int, picture: Callable[[int], Image.Image], pause: float, colors: int = COLORS) -> None:
    """Write a looping GIF with one palette, which covers rare colors too (a yellow shirt among shades of sky).

    Args:
        picture: gives the picture of an index (PIL, RGB); called twice for some.
        pause: s, for which each picture is shown, rounded to hundredths; the last one is shown for ``LAST``.
    """
    from PIL import Image

    samples = np.linspace(0, number - 1, min(MAX_SAMPLES, number)).round().astype(int)
    pixels = _fewer_pixels(np.concatenate([np.asarray(picture(int(index)).convert("RGB")) for index in samples]))
    palette = Image.fromarray(pixels).quantize(colors, method=Image.Quantize.MAXCOVERAGE, kmeans=1)
    images = [
        picture(index).convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE) for index in range(number)
    ]
    pauses = [max(20, round(100 * pause) * 10)] * (number - 1) + [round(1000 * LAST)]
    images[0].save(path, format="GIF", save_all=True, append_images=images[1:], duration=pauses, loop=0, optimize=False)


def _fewer_pixels(pixels: np.ndarray) -> np.ndarray:
    """(1, P, 3) about ``SAMPLE`` pixels of pictures (H, W, 3): all of their colors, by their shares of the area."""
    shades = pixels.reshape(-1, 3).astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)
    counts = np.bincount(shades)
    colors = np.flatnonzero(counts)
    each = np.repeat(colors, -(-counts[colors] * SAMPLE // len(shades)))
    return np.stack([each >> 16, each >> 8 & 255, each & 255], -1)[None].astype(np.uint8)


# ------------------------------------------------------------------ from above


class _Scene:
    """All positions in pixels, at twice the size: halving a picture smooths its edges."""

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
        from matplotlib import get_data_path
        from PIL import Image, ImageFont

        figure, axes = layers.canvas(environment, 6.4, "")
        layers.draw_obstacles(axes, environment)
        if graph is not None:
            layers.draw_graph(axes, graph, alone=False)
        layers.draw_scale(axes, environment)
        figure.set_dpi(2 * size / 6.4)
        figure.canvas.draw()
        self.background = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())  # pyright: ignore
        height, self.every = self.background.height, every
        corner = np.array([0.0, height])
        flip = np.array([1.0, -1.0])

        def pixels(points: ArrayLike) -> np.ndarray:
            points = np.asarray(points, float)
            return corner + flip * axes.transData.transform(points.reshape(-1, 2)).reshape(points.shape)

        self.metre = float((axes.transData.transform((1.0, 0.0)) - axes.transData.transform((0.0, 0.0)))[0])
        self.line = max(2, round(self.metre * 0.07))
        font = Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
        self.font, self.small = (ImageFont.truetype(str(font), round(size / part)) for part in (22, 32))
        others = layers.of_others(frames)
        sizes = np.maximum(np.broadcast_to(robot_radius, 1 + len(others)) * self.metre, 2.0 * self.line)
        self.radius, self.radii = float(sizes[0]), sizes[1:]
        around = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
        self.body = np.stack([layers.DEPTH * np.cos(around), np.sin(around)], 1)  # (24, 2) ahead and aside
        self.people, self.group, self.present = pixels(frames.people), frames.group, np.asarray(frames.present, bool)
        self.heading_ends = self.people + flip * frames.people_heading * (1.9 * layers.PERSON_RADIUS * self.metre)
        self.path, self.heading, self.goal = pixels(frames.position), flip * frames.heading, pixels(frames.goal[-1])
        self.others = pixels(others[..., :2])
        self.noses = self.others + flip * others[..., 2:4] * (2.2 * self.radii[:, None, None])
        self.goals = [self.goal, *pixels(others[:, -1, 4:])]
        self.shades = layers.step_colors(frames, situations)
        self.flags = np.asarray(frames.situations, bool)
        self.names, self.name_colors = situations, colors.situation_colors(situations)
        self.time_step, self.title = time_step, title
        self.tail = round(TAIL / time_step)

    def picture(self, t: int) -> Image.Image:
        """Frame ``t``, with people and robot."""
        from PIL import ImageDraw

        image = self.background.copy()
        draw, metre, line = ImageDraw.Draw(image), self.metre, self.line

        def disc(place: np.ndarray, radius: float, **style: Any) -> None:
            draw.ellipse((place[0] - radius, place[1] - radius, place[0] + radius, place[1] + radius), **style)

        disc(self.path[0], 0.42 * metre, outline=colors.ROBOT, width=2 * line)
        for number, goal in enumerate(self.goals):
            disc(goal, 0.75 * metre, outline=colors.ROBOT, width=line if number else 2 * line)
            disc(goal, 0.28 * metre, fill=colors.ROBOT)
        for first in range(0, t, self.every):
            last = min(first + self.every, t)
            draw.line([*self.path[first], *self.path[last]], fill=self.shades[last], width=3 * line)
        tail = slice(max(0, t - self.tail), t + 1)
        tails, here = self.people[tail][:: max(1, self.tail // 5)], np.flatnonzero(self.present[t])
        complete = np.all(self.present[tail], axis=0)  # people who have just entered have no tail yet
        for n in here[complete[here]] if len(tails) > 1 else ():
            draw.line([tuple(place) for place in tails[:, n]], fill=colors.TRAIL, width=line)
        for place, end, group in zip(
            self.people[t, here], self.heading_ends[t, here], self.group[t, here], strict=True
        ):
            draw.line([*place, *end], fill=colors.PERSON_EDGE, width=line)
            face = colors.MEMBER if group >= 0 else colors.PERSON
            ahead = (end - place) / max(float(np.hypot(*(end - place))), 1e-9)
            outline = place + layers.PERSON_RADIUS * metre * (self.body @ np.stack([ahead, (-ahead[1], ahead[0])]))
            draw.polygon([tuple(corner) for corner in outline], fill=face, outline=colors.PERSON_EDGE, width=line)
        for path, ends, radius in zip(self.others, self.noses, self.radii, strict=True):
            disc(path[t], layers.HALO * metre, outline=colors.ROBOT, width=line)
            disc(path[t], radius, fill=colors.ROBOT, outline=colors.ROBOT_EDGE, width=line)
            draw.line([*path[t], *ends[t]], fill=colors.ROBOT_EDGE, width=line)
        disc(self.path[t], layers.HALO * metre, outline=colors.ROBOT, width=line)
        disc(self.path[t], self.radius, fill=colors.ROBOT, outline=colors.ROBOT_EDGE, width=line)
        nose = self.path[t] + self.heading[t] * 2.2 * self.radius
        draw.line([*self.path[t], *nose], fill=colors.ROBOT_EDGE, width=line)
        self._caption(draw, t)
        return image.reduce(2)

    def _caption(self, draw: ImageDraw.ImageDraw, t: int) -> None:
        """Below the floor: title and time in the middle, current situations at the right."""
        wide, tall = self.background.size
        base = tall - 0.6 * self.font.size
        draw.text((0.30 * wide, base), f"{t * self.time_step:.1f} s", font=self.font, fill=colors.INK, anchor="rs")
        if self.title:
            draw.text((0.33 * wide, base), self.title, font=self.font, fill=colors.MUTED, anchor="ls")
        title_end = 0.33 * wide + draw.textlength(self.title, font=self.font) + self.font.size
        holding = [pair for flag, *pair in zip(self.flags[t], self.names, self.name_colors, strict=True) if flag]
        right, font, lines = wide * (1 - layers.MARGIN), self.font, [holding]
        if self._length(draw, holding, font) > right - title_end:  # smaller, on as many lines as needed
            font, lines = self.small, [[]]
            for pair in holding:
                if lines[-1] and self._length(draw, [*lines[-1], pair], font) > right - title_end:
                    lines.append([])
                lines[-1].append(pair)
        for up, line in enumerate(reversed(lines)):
            x = right - self._length(draw, line, font)
            for name, color in line:
                label = name.replace("_", " ")
                draw.text((x, base - 1.2 * up * font.size), label, font=font, fill=color, anchor="ls")
                x += draw.textlength(label, font=font) + font.size

    def _length(self, draw: ImageDraw.ImageDraw, names: list, font: ImageFont.FreeTypeFont) -> float:
        """Width in pixels of the names of situations in one row."""
        return sum(draw.textlength(name.replace("_", " "), font=font) + font.size for name, _ in names) - font.size


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
        return rgb.reshape(eye.height, SUPERSAMPLING, eye.width, SUPERSAMPLING, 3).mean((1, 3))

    for t in range(len(frames.active)):
        image = np.asarray(picture(jax.tree.map(lambda leaf, t=t: jnp.asarray(leaf[t]), frames)))
        yield depth_colors(image, eye.far) if eye.name == "depth" else (255 * image + 0.5).astype(np.uint8)


def depth_colors(image: np.ndarray, far: float) -> np.ndarray:
    """Depths (H, W) [m] as colors (H, W, 3) uint8: blue near, red far, dark grey from ``far`` [m] on."""
    from matplotlib import colormaps

    shades = colormaps["turbo"](np.sqrt(np.clip(image / far, 0.0, 1.0)))[..., :3]
    return (255 * np.where(image[..., None] < far, shades, 0.2) + 0.5).astype(np.uint8)


def _state(frame: Trajectory) -> State:
    """The fields of a state that a camera reads; all others are None."""
    nothing: Any = None
    body = dict(position=frame.people, velocity=frame.people_velocity, heading=frame.people_heading)
    person = dict.fromkeys(Pedestrians.__dataclass_fields__, nothing) | body
    person |= dict(group=frame.group, present=frame.present)
    robot = Robot(frame.position, frame.heading, nothing, nothing, nothing)
    state = dict.fromkeys(State.__dataclass_fields__, nothing) | dict(situations=frame.situations, robot=robot)
    return State(**state | dict(pedestrians=Pedestrians(**person)))  # pyright: ignore[reportArgumentType]
