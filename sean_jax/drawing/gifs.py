"""Looping GIFs: few colors have to do for all pictures, and rare ones get their place among them.

A palette made of the pictures as they are is filled by the many shades of sky and floor, and a yellow shirt turns
brown. So colors are counted in cells of their cube, in which common ones count hardly more than rare ones, and a part
of the palette goes to those that are farthest from it, one after the other.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sean_jax.options import check_file

COLORS = 255  # of the palette: one of GIF's 256 stays free, to say that a pixel has not changed
CELLS = 64  # each way of the cube of colors
POWER = 0.5  # of a cell's number of pixels: how often its color counts
ROUNDS = 2  # in which the palette's colors move
RARE = 0.25  # share of the palette that the colors get which are farthest from all others
SAMPLES = 24  # pictures that the palette is made from, at most


def save(
    path: Any, number: int, picture: Callable[[int], Any], pause: float, *, last: float = 2.0, colors: int = COLORS
) -> None:
    """Write a looping GIF.

    Args:
        path: where to write, a path or a binary file.
        number: of pictures.
        picture: gives the one of that index (PIL, RGB); it is asked again for some.
        pause: how long each is shown [s], in hundredths of a second.
        last: how long the last is shown [s].
        colors: of the palette.
    """
    from PIL import Image
    from scipy.spatial import KDTree

    chosen = np.linspace(0, number - 1, min(SAMPLES, number)).round().astype(int)
    table = palette([np.asarray(picture(int(index)).convert("RGB")) for index in chosen], colors)
    nearest = KDTree(table)

    def reduced(index: int) -> Any:
        pixels = np.asarray(picture(index).convert("RGB")).astype(np.int32)
        shades, where = np.unique(pixels @ (1 << 16, 1 << 8, 1), return_inverse=True)
        found: Any = nearest.query(np.stack([shades >> 16, shades >> 8 & 255, shades & 255], 1))[1]
        small = Image.fromarray(found.astype(np.uint8)[where].reshape(pixels.shape[:2]))
        small.putpalette(table.ravel().tolist())
        return small

    few = [reduced(index) for index in range(number)]
    pauses = [max(20, round(100 * pause) * 10)] * (number - 1) + [round(1000 * last)]
    few[0].save(path, format="GIF", save_all=True, append_images=few[1:], duration=pauses, loop=0, optimize=False)


def check(path: Any) -> None:
    """Refuse, with a ValueError, a path that no GIF can be written to; a binary file is in order."""
    if isinstance(path, str | os.PathLike):
        check_file(Path(path), (".gif",), "path")


def palette(pictures: list[np.ndarray], colors: int = COLORS) -> np.ndarray:
    """(C, 3) uint8: so many colors at most that serve all of the pictures (H, W, 3) uint8."""
    from PIL import Image
    from scipy.spatial import KDTree

    pixels = np.concatenate([picture.reshape(-1, 3) for picture in pictures])
    cell = np.ravel_multi_index(tuple((pixels // (256 // CELLS)).T), (CELLS,) * 3)
    _, where, count = np.unique(cell, return_inverse=True, return_counts=True)
    total = np.stack([np.bincount(where, pixels[:, axis], len(count)) for axis in range(3)], 1)
    mean = (total / count[:, None] + 0.5).astype(np.uint8)
    often = np.repeat(mean, np.ceil(count**POWER).astype(int), axis=0)
    common = Image.fromarray(often[None]).quantize(colors - round(RARE * colors), method=Image.Quantize.MEDIANCUT)
    table = np.array(common.getpalette(), np.uint8).reshape(-1, 3)[: len(common.getcolors())]  # pyright: ignore
    away = KDTree(table).query(mean)[0]
    while len(table) < colors and away.max() > 0:  # the color that is farthest from all that are there
        table = np.concatenate([table, mean[[away.argmax()]]])
        away = np.minimum(away, np.linalg.norm(mean - table[-1].astype(float), axis=1))
    for _ in range(ROUNDS):  # each to the middle of the colors that it stands for
        near = KDTree(table).query(mean)[1]
        weight = np.bincount(near, count**POWER, len(table))
        middle = [np.bincount(near, count**POWER * mean[:, axis], len(table)) for axis in range(3)]
        table = np.where(weight > 0, np.stack(middle) / np.maximum(weight, 1e-9), table.T).T
    return (table + 0.5).astype(np.uint8)
