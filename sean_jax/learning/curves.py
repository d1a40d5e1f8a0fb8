"""The learning curve of a training: in a word, and as a picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sean_jax import writing
from sean_jax.learning.logs import read_lines

CURVE = "curve.png"
BLOCKS = "▁▂▃▄▅▆▇█"
WIDTH = 16  # characters of a curve in a word


def sparkline(values: Sequence[float]) -> str:
    """A curve in a word.

    Returns:
        A block for each value, as high as it is between the least and the greatest; if there are many, for means of as
        many in a row.
    """
    if not len(values):
        return ""
    means = np.array([part.mean() for part in np.array_split(np.asarray(values, float), min(len(values), WIDTH))])
    share = (means - means.min()) / max(float(np.ptp(means)), 1e-9)
    return "".join(BLOCKS[int(part * (len(BLOCKS) - 1) + 0.5)] for part in share)


def draw_curve(folder: Path) -> None:
    """Write the picture of a training: return, completed tasks and violations in evaluations, by steps and by time."""
    import io

    from matplotlib.figure import Figure

    lines = read_lines(folder)
    seconds = np.cumsum([line["seconds"] for line in lines])
    judged = [line for line in lines if "evaluation" in line]
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    for axes, (name, what) in zip(figure.subplots(1, 3), SHOWN, strict=True):
        for part in sorted({key for key in judged[-1] if key.startswith("agent ")}):
            axes.plot(*_points(judged, part, name), color="#1a6faf", alpha=0.3, linewidth=1.0)
        axes.plot(*_points(judged, "evaluation", name), color="#1a6faf")
        axes.set(xlabel="million scenario-steps of an agent", title=what)
        axes.grid(alpha=0.3)
    figure.suptitle(f"{len(judged)} evaluations, {seconds[-1]:,.0f} s of training", fontsize="medium")
    picture = io.BytesIO()
    figure.savefig(picture, dpi=110, format="png")
    writing.write(folder / CURVE, picture.getvalue())


SHOWN = (
    ("return", "return of an episode"),
    ("completed", "share of tasks completed"),
    ("intimate_robot_on_person", "intimate, robot on person"),
)
"""Name in an evaluation, and what it is."""


def _points(judged: list[dict], part: str, name: str) -> tuple[list[float], list[float]]:
    found = [(line["steps"] / 1e6, line[part][name]) for line in judged if name in line.get(part, {})]
    return [x for x, _ in found], [y for _, y in found]
