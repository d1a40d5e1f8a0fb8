"""Figures inside the page: drawings and charts as SVG in the colors of the page, light or dark."""

import html as markup
import io
import re
from typing import Any

import numpy as np

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
    counts = [np.histogram(np.minimum(seconds[mask], time_limit), edges)[0]
              for mask in (completed, ~completed)]  # fmt: skip
    highest = max(1, int((counts[0] + counts[1]).max()))
    width, height, left, base = 720.0, 200.0, 36.0, 160.0
    step = (width - left - 16) / len(counts[0])
    shapes = [f'<line x1="{left}" x2="{width - 16}" y1="{base}" y2="{base}" stroke="var(--muted)"/>']
    for k, (done, late) in enumerate(zip(*counts, strict=True)):
        x, lower, upper = left + k * step, 140.0 * done / highest, 140.0 * late / highest
        for y, h, kind in ((base - lower, lower, "done"), (base - lower - upper, upper, "late")):
            if h:
                shapes.append(
                    f'<rect class={kind} x="{x + 1:.1f}" y="{y:.1f}" width="{step - 2:.1f}" height="{h:.1f}"/>'
                )
    for k in range(0, len(edges), 4):
        shapes.append(f'<text x="{left + k * step:.1f}" y="{base + 16}" text-anchor="middle">{edges[k]:g}</text>')
    shapes.append(f'<text x="{left - 6}" y="24" text-anchor="end">{highest}</text>')
    shapes.append(f'<text x="{left - 6}" y="{base}" text-anchor="end">0</text>')
    shapes.append(f'<text x="{(left + width) / 2}" y="{height - 6}" text-anchor="middle">seconds</text>')
    keys = (("done", "completed", 60.0), ("late", "out of time", 150.0))
    for kind, label, x in keys:
        shapes.append(f'<rect class={kind} x="{x}" y="{height - 16}" width="10" height="10"/>')
        shapes.append(f'<text x="{x + 15}" y="{height - 7}">{label}</text>')
    label = 'role="img" aria-label="durations of the episodes"'
    return f'<svg class=histogram viewBox="0 0 {width:g} {height:g}" {label}>{"".join(shapes)}</svg>'
