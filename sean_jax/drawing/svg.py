"""Figures as inline SVG in pages."""

import html
import io
import re
from typing import Any

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
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(name)}"', 1)
