"""Looping GIFs with one palette for all pictures, in which rare colors have their place.

A palette made from all pixels is filled by the many shades of sky and floor, and a yellow shirt turns brown. So colors
are counted in cells of their cube, where common ones count hardly more than rare ones. A part of the palette goes to
the colors that are farthest from it, one after the other.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from sean_jax.writing import check_file

if TYPE_CHECKING:
    from PIL import Image

Target = str | os.PathLike[str] | BinaryIO  # where a GIF is written
COLORS = 255  # of the palette: one of GIF's 256 stays free, to mark pixels that have not changed
CELLS = 64  # of the cube of colors, each way
POWER = 0.5  # of a cell's number of pixels, with which its color counts
ROUNDS = 2  # in which the palette's colors move
RARE_SHARE = 0.25  # of the palette, for the colors that are farthest from all others
MAX_SAMPLES = 24  # pictures from which the palette is made


def save(
    path: Target,
    number: int,
    picture: Callable[[int], Image.Image],
    pause: float,
    *,
    last: float = 2.0,
    colors: int = COLORS,
) -> None:
    """Write a looping GIF.

    Args:
        path: where to write, a path or a binary file.
        picture: gives the picture of an index (PIL, RGB); called twice for some.
        pause: s, for which each picture is shown; rounded to hundredths.
        last: s, for which the last picture is shown.
    """
    from PIL import Image
    from scipy.spatial import KDTree

    chosen = np.linspace(0, number - 1, min(MAX_SAMPLES, number)).round().astype(int)
    table = palette([np.asarray(picture(int(index)).convert("RGB")) for index in chosen], colors)
    nearest = KDTree(table)

    def reduced(index: int) -> Image.Image:
        pixels = np.asarray(picture(index).convert("RGB")).astype(np.int32)
        shades, where = np.unique(pixels @ (1 << 16, 1 << 8, 1), return_inverse=True)
        index_of: Any = nearest.query(np.stack([shades >> 16, shades >> 8 & 255, shades & 255], 1))[1]
        small = Image.fromarray(index_of.astype(np.uint8)[where].reshape(pixels.shape[:2]))
        small.putpalette(table.ravel().tolist())
        return small

    images = [reduced(index) for index in range(number)]
    pauses = [max(20, round(100 * pause) * 10)] * (number - 1) + [round(1000 * last)]
    images[0].save(path, format="GIF", save_all=True, append_images=images[1:], duration=pauses, loop=0, optimize=False)


def check(path: Target) -> None:
    """Check that a GIF can be written.

    Args:
        path: where to write, a path or a binary file.

    Raises:
        InputError: the path cannot be written.
    """
    if isinstance(path, str | os.PathLike):
        check_file(Path(path), (".gif",), "path")


def palette(pictures: list[np.ndarray], colors: int = COLORS) -> np.ndarray:
    """Choose colors for several pictures.

    Args:
        pictures: (H, W, 3) uint8 each.
        colors: number of colors at most.

    Returns:
        (C, 3) uint8.
    """
    from PIL import Image
    from scipy.spatial import KDTree

    pixels = np.concatenate([picture.reshape(-1, 3) for picture in pictures])
    cell = np.ravel_multi_index(tuple((pixels // (256 // CELLS)).T), (CELLS,) * 3)
    _, where, count = np.unique(cell, return_inverse=True, return_counts=True)
    total = np.stack([np.bincount(where, pixels[:, axis], len(count)) for axis in range(3)], 1)
    mean = (total / count[:, None] + 0.5).astype(np.uint8)
    often = np.repeat(mean, np.ceil(count**POWER).astype(int), axis=0)
    common = Image.fromarray(often[None]).quantize(colors - round(RARE_SHARE * colors), method=Image.Quantize.MEDIANCUT)
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
