"""What messages about wrong values have in common."""


def shorten(text: str, length: int = 60) -> str:
    """A text, cut to ``length`` characters."""
    return text if len(text) <= length else text[: length - 3] + "..."
