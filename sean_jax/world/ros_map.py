"""ROS maps (section IV-C): an occupancy image becomes an environment of few upright boxes, and boxes become an image.

Conventions of map_server: the origin is the lower left corner of the image, whose rows run from top to bottom;
p = (255 - x) / 255 is how occupied a pixel of value x is, or x / 255 with ``negate``.
"""

import contextlib
import dataclasses
import io
import json
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, BinaryIO, Literal

import jax
import numpy as np
import pydantic
from PIL import Image, UnidentifiedImageError

from sean_jax.core import bounds
from sean_jax.core.bounds import MAX_FLOOR_SIDE, MAX_OBSTACLES, Coordinate
from sean_jax.core.data_types import Environment, Obstacles
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.geometry import rotate
from sean_jax.io import files, writing
from sean_jax.world import environment as environments

MIN_AGREEMENT = 0.995  # share of cells that are equal in the map and in the boxes
SLIVER_SHARE = 0.2  # of the cells that may differ: so many slivers along larger boxes are left out at most
WORTH = 0.25  # share of boxes that slivers have to save to be left out
OCCUPIED_PERCENT = 65  # occupancy [%] from which a cell of a "scale" or "raw" map is an obstacle; map_saver's default
AREA_PER_PERSON = 25.0  # m2 of free floor, as in the warehouse
MAX_BOXES = MAX_OBSTACLES  # more are noise, and no path could be planned among them
MAX_RESOLUTION = 0.5  # m: a larger pixel than a person leaves open neither a door nor the way between two walls
MAX_BYTES = 100_000_000  # of an image
MAX_CELLS = 16_000_000
SIZE_CURE = "cut it out or lower its resolution"
FORMATS = ("PNG", "PPM", "BMP", "GIF", "JPEG", "TIFF")
FORMAT_NAMES = "a PGM or PNG file"
MAX_DEFAULT_PEOPLE = 60  # the default number of people of a map, at most


class MapFile(pydantic.BaseModel):
    """The keys of a ROS map's YAML file; keys for other programs are ignored."""

    model_config = pydantic.ConfigDict(extra="ignore", allow_inf_nan=False)

    image: Annotated[str, pydantic.Field(min_length=1)]
    resolution: Annotated[float, pydantic.Field(ge=1e-3)]  # m, side of a pixel
    origin: tuple[Coordinate, Coordinate, float]  # m, m, rad: pose of the lower left corner
    negate: bool | Literal[0, 1] = 0
    occupied_thresh: Annotated[float, pydantic.Field(ge=0, le=1)]
    free_thresh: Annotated[float, pydantic.Field(ge=0, le=1)]
    mode: Literal["trinary", "scale", "raw"] = "trinary"


@dataclasses.dataclass(frozen=True)
class Raster:
    """The cells of a map: column i, row j is the square from ``origin + resolution * (i, j)``, so row 0 is lowest."""

    occupied: np.ndarray  # (rows, columns) bool
    unknown: np.ndarray  # (rows, columns) bool, neither occupied nor free
    resolution: float  # m
    origin: tuple[float, float]  # m


@dataclasses.dataclass(frozen=True)
class ImportSummary:
    """Result of an import."""

    folder: Path  # of the environment
    boxes: int  # in its scene
    people: int  # default number of people
    cells: int  # of the map
    agreement: float  # share of cells that are equal in the map and in the boxes


def read_map(path: Path | str) -> Raster:
    """Read a map, a map_server YAML file and its PGM or PNG image; FileError if one cannot be used."""
    path = Path(path)
    if path.is_file() and _is_image(path):
        raise files.file_error(path, "is an image; give the map's YAML file, which names it")
    settings = files.load(path, MapFile, _problems)
    image = path.parent / settings.image
    if not os.path.lexists(image):
        raise files.file_error(path, f"image: there is no file {settings.image!r:.200}")
    shades, opaque = _image(image)
    size = settings.resolution * max(shades.shape)
    if size > MAX_FLOOR_SIDE:
        raise files.file_error(
            path, f"the map is {size:g} m long, of {shades.shape} cells; look at resolution and at the image"
        )
    occupancy = np.where(opaque, _occupancy(settings, shades), -1.0)[::-1]
    return Raster(occupancy >= OCCUPIED_PERCENT, occupancy < 0, settings.resolution, settings.origin[:2])


def _occupancy(settings: MapFile, shades: np.ndarray) -> np.ndarray:
    """Occupancy [%] of pixels, -1 where it is unknown, by the modes of map_server."""
    if settings.mode == "raw":
        return np.where(shades <= 100, shades, -1.0)
    share = shades / 255 if settings.negate else (255 - shades) / 255
    low = settings.free_thresh
    high = settings.occupied_thresh
    between = 99 * (share - low) / max(high - low, 1e-9) if settings.mode == "scale" else -1.0
    return np.where(share > high, 100.0, np.where(share < low, 0.0, between))


def _problems(settings: MapFile) -> list[files.Problem]:
    problems: list[files.Problem] = []
    if settings.resolution > MAX_RESOLUTION:
        text = (
            f"a pixel of {settings.resolution:g} m is larger than a door is wide; give metres a pixel, such as 0.05, "
            f"and {MAX_RESOLUTION:g} at most"
        )
        problems.append((("resolution",), text))
    if settings.origin[2] != 0:
        problems.append((("origin", 2), f"the map is turned by {settings.origin[2]:g} rad; turn its image and give 0"))
    if settings.free_thresh > settings.occupied_thresh:
        problems.append((("free_thresh",), f"{settings.free_thresh:g} is more than occupied_thresh; exchange them"))
    return problems


@contextlib.contextmanager
def _opened(stream: BinaryIO) -> Iterator[Image.Image]:
    """An image, of whose size Pillow does not warn: it is checked here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        with Image.open(stream, formats=FORMATS) as opened:
            yield opened


def _is_image(path: Path) -> bool:
    try:
        with files.open_file(path, MAX_BYTES) as stream, _opened(stream):
            return True
    except Image.DecompressionBombError:
        return True
    except (OSError, ValueError, UnidentifiedImageError):
        return False


def _image(image: Path) -> tuple[np.ndarray, np.ndarray]:
    """The shades of an image file, as in ``_shades``. Raises FileError."""
    content = files.read_bytes(image, MAX_BYTES)
    try:
        with _opened(io.BytesIO(content)) as opened:
            width, height = opened.size
            if width * height > MAX_CELLS:
                raise Image.DecompressionBombError
            return _shades(opened)
    except FileError:
        raise
    except Image.DecompressionBombError:
        raise files.file_error(image, f"has more than {MAX_CELLS // 10**6} million cells; {SIZE_CURE}") from None
    except UnidentifiedImageError:
        raise files.file_error(image, f"is no image that can be read; give {FORMAT_NAMES}") from None
    except Exception as error:  # Pillow's decoders raise many types of errors for damaged files
        raise files.file_error(image, f"is damaged; save it again as {FORMAT_NAMES}") from error


def _shades(image: Image.Image) -> tuple[np.ndarray, np.ndarray]:
    """(rows, columns) mean of the colors, 0 to 255, and whether a pixel is opaque at all."""
    if image.mode.startswith("I") or image.mode == "F":  # 16 bits
        values = np.asarray(image, np.float32)
        values = np.where(np.isfinite(values), values, 0.0)
        scale = np.float32(255 / 65535 if values.max(initial=0) > 255 else 1.0)
        return values * scale, np.ones(values.shape, bool)
    values = np.asarray(image.convert("RGBA"))
    return values[..., :3].mean(-1, dtype=np.float32), values[..., 3] > 0


def rectangles(occupied: np.ndarray, spare: int = 0) -> np.ndarray:
    """Cover the True cells by few rectangles (B, 4) [column, row, column end, row end), which may overlap.

    From the first uncovered cell, in the order of the rows, take the rectangle that covers most new cells. A sliver is
    a rectangle whose own cells all touch another rectangle.

    Args:
        occupied: (rows, columns) bool.
        spare: number of cells of slivers that may stay uncovered, if that saves a fifth of the rectangles.

    Raises:
        InputError: more than ``MAX_BOXES`` rectangles are needed.
    """
    rows, columns = occupied.shape
    run = np.zeros((rows, columns + 1), int)  # number of occupied cells from each cell to the right
    for column in range(columns - 1, -1, -1):
        run[:, column] = np.where(occupied[:, column], run[:, column + 1] + 1, 0)
    covered = np.zeros((rows, columns), int)
    boxes: list[tuple[int, int, int, int]] = []
    for row in range(rows):
        while True:
            free = occupied[row] & (covered[row] == 0)
            if not free.any():
                break
            left, low, right, high = box = _widen(occupied, _best(run, covered, row, int(free.argmax())))
            boxes.append(box)
            covered[low:high, left:right] += 1
            if len(boxes) > MAX_BOXES:
                raise InputError(
                    f"the map needs more than {MAX_BOXES} boxes; smooth its image, or lower its resolution."
                )

    # A map that was made of boxes comes back exactly.
    exact = _without_slivers(boxes, covered.copy(), 0)
    simpler = _without_slivers(boxes, covered, spare)
    chosen = exact if len(exact) <= (1 + WORTH) * len(simpler) else simpler
    return np.array(chosen, int).reshape(-1, 4)


def _best(run: np.ndarray, covered: np.ndarray, row: int, column: int) -> tuple[int, int, int, int]:
    """The rectangle upwards and to the right of a cell that covers most uncovered cells."""
    depth = int(np.argmin(np.append(run[row:, column] > 0, False)))
    width = np.minimum.accumulate(run[row : row + depth, column])  # of a rectangle up to each row
    new = np.cumsum(covered[row : row + depth, column : column + width[0]] == 0, axis=1)

    # As high as each width allows.
    heights = np.flatnonzero(np.append(width[1:] != width[:-1], True)) + 1
    gains = [int(new[:height, width[height - 1] - 1].sum()) for height in heights]
    height = int(heights[int(np.argmax(gains))])
    return column, row, column + int(width[height - 1]), row + height


def _widen(occupied: np.ndarray, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The box extended to the left and downwards as far as cells are occupied."""
    left, low, right, high = box
    while left > 0 and occupied[low:high, left - 1].all():
        left -= 1
    while low > 0 and occupied[low - 1, left:right].all():
        low -= 1
    return left, low, right, high


def _without_slivers(boxes: list[tuple[int, int, int, int]], covered: np.ndarray, spare: int) -> list:
    """The boxes without slivers of up to ``spare`` cells in all; obstacles that stand alone stay."""
    kept = []
    for left, low, right, high in sorted(boxes, key=lambda box: (box[2] - box[0]) * (box[3] - box[1])):
        cells = covered[low:high, left:right]
        alone = cells == 1  # cells that no other box covers
        count = int(alone.sum())
        if count <= spare:
            cells -= 1
            if (_touches_covered(covered, left, low, right, high) | ~alone).all():
                spare -= count
                continue
            cells += 1
        kept.append((left, low, right, high))
    return sorted(kept, key=lambda box: (box[1], box[0]))


def _touches_covered(covered: np.ndarray, left: int, low: int, right: int, high: int) -> np.ndarray:
    """(high - low, right - left) bool: cells of a box that are covered or have a covered cell around them."""
    window = covered[max(low - 1, 0) : high + 1, max(left - 1, 0) : right + 1] > 0
    around = np.zeros((high - low + 2, right - left + 2), bool)  # no copy of the whole map for each box
    y = int(low == 0)
    x = int(left == 0)
    around[y : y + window.shape[0], x : x + window.shape[1]] = window
    shifts = [around[a : a + high - low, b : b + right - left] for a in range(3) for b in range(3)]
    return np.any(shifts, axis=0)


def import_map(
    path: Path | str, folder: Path | str, *, people: int | None = None, height: float = 2.0, unknown: str = "obstacle"
) -> ImportSummary:
    """Write the environment of a ROS map to a folder, read it again, and compare it with the map cell by cell.

    Args:
        folder: of the environment; must be new or empty.
        people: default number of people; one for each 25 m2 of free floor if None.
        height: m, of all boxes, since a map has none.
        unknown: what unknown cells become, ``obstacle`` or ``free``.

    Raises:
        InputError: a number is out of range, or the map cannot be described by boxes.
        FileError: a file cannot be used.
        WriteError: the folder cannot be written.
    """
    # Mistakes are told before a large map is read and covered by boxes.
    folder = Path(folder)
    bounds.check_number("height", height, 0.1, 100.0, "m")
    if people is not None:
        bounds.check_integer("people", people, 0, bounds.MAX_PEOPLE)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and is not an empty folder; give another one.")

    # Unknown is no free floor: what a robot has not seen counts as an obstacle unless the user knows better.
    raster = read_map(path)
    solid = raster.occupied | raster.unknown if unknown == "obstacle" else raster.occupied
    if not solid.any() or solid.all():
        quantity = "every" if solid.any() else "no"
        raise InputError(
            f"{files.short_name(Path(path))}: {quantity} cell is an obstacle; look at negate and the thresholds."
        )

    # Rays and paths cost by the number of boxes, so few cover the obstacles, without slivers within the agreement.
    rows = rectangles(solid, int(solid.size * (1 - MIN_AGREEMENT) * SLIVER_SHARE))  # (boxes, 4)

    # The default crowd is as dense as in the warehouse.
    if people is None:
        free = float((~solid).sum()) * raster.resolution**2
        people = max(1, min(MAX_DEFAULT_PEOPLE, round(free / AREA_PER_PERSON)))

    # The files are read again before the folder appears: an error leaves nothing behind.
    with writing.atomic_folder(folder) as new_folder:
        lower = np.asarray(raster.origin)
        upper = lower + raster.resolution * np.asarray(solid.shape[::-1])
        # Six digits, or the file would show sums such as 9.600000000000001.
        x0, y0, x1, y1 = (round(float(value), 6) for value in (*lower, *upper))
        name = folder.resolve().name
        source = f"ROS map {Path(path).name}, {raster.resolution:g} m a cell"
        settings = environments.Settings(name=name, floor=(x0, y0, x1, y1), people=people, source=source)
        environments.write(new_folder, settings, _boxes(rows, raster, height))
        agreement = float(np.mean(rasterize(environments.load(new_folder).obstacles, raster) == solid))
        if agreement < MIN_AGREEMENT:
            raise InputError(f"the boxes describe only {agreement:.2%} of the map's cells; nothing was written.")
    return ImportSummary(folder, len(rows), people, solid.size, agreement)


def _boxes(rows: np.ndarray, raster: Raster, height: float) -> np.ndarray:
    """Boxes (B, 6) as of ``environment.write`` from rectangles (B, 4) of cells."""
    low = rows[:, :2] * raster.resolution  # from the origin
    high = rows[:, 2:] * raster.resolution
    center = np.asarray(raster.origin) + (low + high) / 2
    yaw_and_height = np.broadcast_to([0.0, height], (len(rows), 2))
    return np.concatenate([center, (high - low) / 2, yaw_and_height], 1)


def rasterize(obstacles: Obstacles, raster: Raster) -> np.ndarray:
    """(rows, columns) bool: cells of a map whose middle lies in one of the boxes."""
    rows, columns = raster.occupied.shape
    x = raster.origin[0] + (np.arange(columns) + 0.5) * raster.resolution
    y = raster.origin[1] + (np.arange(rows) + 0.5) * raster.resolution
    inside = np.zeros((rows, columns), bool)
    boxes = (np.asarray(field, float) for field in (obstacles.center, obstacles.half_extent, obstacles.yaw))
    for (cx, cy), (hx, hy), yaw in zip(*boxes, strict=True):
        cosine = np.cos(yaw)
        sine = np.sin(yaw)
        reach_x = abs(cosine) * hx + abs(sine) * hy
        reach_y = abs(sine) * hx + abs(cosine) * hy
        near_y = np.abs(y - cy) < reach_y + 1e-9
        near_x = np.abs(x - cx) < reach_x + 1e-9

        # In the frame of the box.
        u, v = rotate(x[near_x] - cx, y[near_y, None] - cy, cosine, -sine)
        inside[np.ix_(near_y, near_x)] |= (np.abs(u) < hx) & (np.abs(v) < hy)
    return inside


def of_environment(environment: Environment, resolution: float = 0.05, height: float = 0.0) -> Raster:
    """The map of an environment: cells whose middle lies in an obstacle that is at least so high.

    Args:
        resolution: m, side of a cell.
        height: m; SEAN's short map has all obstacles, its tall map those of 1 m and more.

    Raises:
        InputError: the map has too many cells.
    """
    x0, y0, x1, y1 = (round(float(value), 6) for value in np.asarray(environment.floor, float))
    columns, rows = (max(1, round(side / resolution)) for side in (x1 - x0, y1 - y0))
    if columns * rows > MAX_CELLS:
        raise InputError(
            f"resolution: cells of {resolution:g} m would be {columns * rows:,}; {MAX_CELLS:,} are the most, so give "
            "larger ones."
        )
    empty = np.zeros((rows, columns), bool)
    raster = Raster(empty, empty, resolution, (x0, y0))
    boxes = environment.obstacles
    heights = np.asarray(boxes.height)
    tall = (heights > 0.0) & (heights >= height - 1e-6)
    occupied = rasterize(jax.tree.map(lambda field: np.asarray(field)[tall], boxes), raster)
    return dataclasses.replace(raster, occupied=occupied)


def export_map(environment: Environment, path: Path, resolution: float = 0.05, height: float = 0.0) -> Raster:
    """Write the map of an environment for map_server: a YAML file, and its image, a PGM, beside it.

    Args:
        path: of the YAML file.
        resolution, height: m, as of ``of_environment``.

    Raises:
        InputError: a number is out of range.
        WriteError: a file cannot be written.
    """
    bounds.check_number("resolution", resolution, 1e-3, MAX_RESOLUTION, "m")
    bounds.check_number("height", height, 0.0, 100.0, "m")
    raster = of_environment(environment, resolution, height)
    image = path.with_suffix(".pgm")
    shades = np.where(raster.occupied, 0, 254).astype(np.uint8)[::-1]  # map_saver's
    rows, columns = shades.shape
    writing.write(image, f"P5\n{columns} {rows}\n255\n".encode() + shades.tobytes())
    x, y = raster.origin
    lines = [
        f"image: {json.dumps(image.name)}",
        "mode: trinary",
        f"resolution: {resolution:.9g}",
        f"origin: [{x:.9g}, {y:.9g}, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
    ]
    writing.write(path, "\n".join(lines) + "\n")
    return raster
