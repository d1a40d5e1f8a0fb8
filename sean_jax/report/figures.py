"""Figures inside the page: drawings and charts as SVG in the colors of the page, light or dark."""

import html as markup
import io
import re
from typing import Any

import numpy as np

from sean_jax import pages
from sean_jax.drawing import colors


def svg(figure: Any, name: str) -> str:
    """A figure as inline SVG in the colors of the page, light or dark; its name makes ids unique."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(stream, format="svg", dpi=170, metadata={"Date": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{name}-", text)
    for shade, variable in (
        (colors.PAPER, "paper"),
        (colors.FLOOR, "floor"),
        (colors.INK, "ink"),
        (colors.MUTED, "muted"),
        (colors.TRAIL, "trail"),
        (colors.FAINT_EDGE, "faint"),
        (colors.OBSTACLE, "obstacle"),
    ):
        text = text.replace(shade, f"var(--{variable})")
    return text.replace("<svg", f'<svg role="img" aria-label="{markup.escape(name)}"', 1)


def durations(completed: np.ndarray, seconds: np.ndarray, time_limit: float) -> str:
    """Histogram of the episodes' durations (E,) s as SVG, up to the time limit; completed ones stand below."""
    edges = np.linspace(0.0, time_limit, 25)
    done, late = (np.histogram(np.minimum(seconds[mask], time_limit), edges)[0] for mask in (completed, ~completed))
    highest = max(1, int((done + late).max()))
    left, base, step, scale = 36.0, 160.0, 668.0 / len(done), 140.0 / highest
    bars = []
    for k, (lower, upper) in enumerate(zip(scale * done, scale * late, strict=True)):
        for kind, top, height in (("done", base - lower, lower), ("late", base - lower - upper, upper)):
            if height:
                bars.append((kind, left + k * step + 1.0, top, step - 2.0, height))
    ticks = [(left + k * step, f"{edges[k]:g}") for k in range(0, len(edges), 4)]
    return pages.render("report/durations.html", bars=bars, ticks=ticks, highest=highest)
