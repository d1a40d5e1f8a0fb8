"""One episode as a looping GIF. The background is drawn once, people and robot for each picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sean_jax.base import Environment, Trajectory
from sean_jax.drawing import colors, gifs, parts
from sean_jax.graph import BehaviorGraph

if TYPE_CHECKING:
    from PIL import Image, ImageDraw, ImageFont

COLORS = 128  # of the palette: those of colors.py and what lies between them at smooth edges
TAIL = 2.0  # s, of the line behind a person


def animate(
    environment: Environment,
    frames: Trajectory,
    path: gifs.Target,
    *,
    graph: BehaviorGraph | None = None,
    situations: Sequence[str] | None = None,
    time_step: float = 0.1,
    robot_radius: float = parts.ROBOT_RADIUS,
    every: int = 5,
    speed: float = 4.0,
    size: int = 640,
    title: str = "",
) -> None:
    """Write one episode as a GIF.

    Args:
        frames: (T, ...) of one episode.
        path: where to write, a path or a binary file.
        situations: names of the frames' situations, any names; the paper's five, or numbers, if None.
        time_step: s, between two frames.
        robot_radius: m.
        every: number of frames from one picture to the next; the last frame is always shown.
        size: pixels, the width.

    Raises:
        InputError: frames with a batch axis or another number of situations, or a path that cannot be written.
    """
    gifs.check(path)
    frames = parts.one_episode(frames)
    names = parts.situation_names(frames, situations)
    scene = _Scene(environment, frames, graph, names, time_step, robot_radius, size, title, every)
    steps = [*range(0, len(frames.active) - 1, every), len(frames.active) - 1]
    gifs.save(path, len(steps), lambda index: scene.picture(steps[index]), every * time_step / speed, colors=COLORS)


class _Scene:
    """All positions in pixels, at twice the size: halving a picture smooths its edges."""

    def __init__(
        self,
        environment: Environment,
        frames: Trajectory,
        graph: BehaviorGraph | None,
        situations: tuple[str, ...],
        time_step: float,
        robot_radius: float,
        size: int,
        title: str,
        every: int,
    ) -> None:
        from matplotlib import get_data_path
        from PIL import Image, ImageFont

        figure, axes = parts.canvas(environment, 6.4, "")
        parts.draw_obstacles(axes, environment)
        if graph is not None:
            parts.draw_graph(axes, graph, alone=False)
        parts.draw_scale(axes, environment)
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
        self.radius = max(robot_radius * self.metre, 2.0 * self.line)
        around = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
        self.body = np.stack([parts.DEPTH * np.cos(around), np.sin(around)], 1)  # (24, 2) ahead and aside
        self.people, self.group, self.present = pixels(frames.people), frames.group, np.asarray(frames.present, bool)
        self.heading_ends = self.people + flip * frames.people_heading * (1.9 * parts.PERSON_RADIUS * self.metre)
        self.path, self.heading, self.goal = pixels(frames.position), flip * frames.heading, pixels(frames.goal[-1])
        self.shades = parts.step_colors(frames, situations)
        self.flags = np.asarray(frames.situations, bool)
        self.names, self.name_colors = situations, colors.situation_colors(situations)
        self.time_step, self.title = time_step, title
        self.tail = round(TAIL / time_step)

    def picture(self, t: int) -> Image.Image:
        """Draw a frame."""
        from PIL import ImageDraw

        image = self.background.copy()
        draw, metre, line = ImageDraw.Draw(image), self.metre, self.line

        def disc(place: np.ndarray, radius: float, **style: Any) -> None:
            draw.ellipse((place[0] - radius, place[1] - radius, place[0] + radius, place[1] + radius), **style)

        disc(self.path[0], 0.42 * metre, outline=colors.ROBOT, width=2 * line)
        disc(self.goal, 0.75 * metre, outline=colors.ROBOT, width=2 * line)
        disc(self.goal, 0.28 * metre, fill=colors.ROBOT)
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
            outline = place + parts.PERSON_RADIUS * metre * (self.body @ np.stack([ahead, (-ahead[1], ahead[0])]))
            draw.polygon([tuple(corner) for corner in outline], fill=face, outline=colors.PERSON_EDGE, width=line)
        disc(self.path[t], parts.HALO * metre, outline=colors.ROBOT, width=line)
        disc(self.path[t], self.radius, fill=colors.ROBOT, outline=colors.ROBOT_EDGE, width=line)
        nose = self.path[t] + self.heading[t] * 2.2 * self.radius
        draw.line([*self.path[t], *nose], fill=colors.ROBOT_EDGE, width=line)
        self._caption(draw, t)
        return image.reduce(2)

    def _caption(self, draw: ImageDraw.ImageDraw, t: int) -> None:
        """Below the floor: title and time in the middle, the situations that hold at the right."""
        wide, tall = self.background.size
        base = tall - 0.6 * self.font.size
        draw.text((0.30 * wide, base), f"{t * self.time_step:.1f} s", font=self.font, fill=colors.INK, anchor="rs")
        if self.title:
            draw.text((0.33 * wide, base), self.title, font=self.font, fill=colors.MUTED, anchor="ls")
        title_end = 0.33 * wide + draw.textlength(self.title, font=self.font) + self.font.size
        holding = [pair for flag, *pair in zip(self.flags[t], self.names, self.name_colors, strict=True) if flag]
        right, font, lines = wide * (1 - parts.MARGIN), self.font, [holding]
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
        """Pixels that the names of situations need beside each other."""
        return sum(draw.textlength(name.replace("_", " "), font=font) + font.size for name, _ in names) - font.size
