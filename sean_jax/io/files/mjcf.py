"""MJCF files, checked before MuJoCo compiles them, since it accepts any size, and NaN for a number.

Elements without use in a scene or a robot, and larger numbers than any of them needs, are refused at their line.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mujoco
import numpy as np

from sean_jax.core.errors import FileError
from sean_jax.core.messages import MAX_DEPTH, shorten
from sean_jax.io.files.reading import file_error, read_bytes, read_text, short_name

MAX_ELEMENTS = 10_000  # in all, with all copies of replicates
MAX_JOINTS = 100
MAX_PIXELS = 25_000_000  # of all textures and height fields together
MAX_FOLDERS = 30  # that <compiler> names for meshes and textures
MAX_TEXT = 10_000_000  # bytes
MAX_ASSET = 50_000_000  # bytes of a mesh or an image
MAX_MAGNITUDE = 1e10  # of a number; MuJoCo's own bound
# (element, attribute) -> its maximum; MuJoCo allocates as much
MAX_COUNTS = {
    ("replicate", "count"): 1_000,
    ("numeric", "size"): 500,
    ("user", "dim"): 1_000,
    ("mesh", "params"): 256,
}
MAX_RESERVED = 10_000  # of what <size> reserves, memory excepted
MAX_MEMORY = 100_000_000  # bytes
REFUSED = ("attach", "composite", "extension", "flex", "flexcomp", "plugin", "skin")
FOLDERS = ("meshdir", "texturedir", "assetdir")  # attributes of <compiler>
WORDS = ("name", "class", "childclass", "file", "filename", "model", "prefix")  # attributes that are no numbers


def read(path: Path, edit: Callable[[Any], None] | None = None) -> Any:
    """The ``mujoco.MjModel`` of an MJCF file, in which every number is finite.

    Args:
        edit: changes its ``mujoco.MjSpec`` before it is compiled.

    Raises:
        FileError: one sentence that names the file, the line where there is one, and the cure.
    """
    sources(path)  # refuses elements and files
    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)  # or it prints, and writes a log where the program was started
    try:
        if edit is None:
            model = mujoco.MjModel.from_xml_path(str(path))
        else:
            spec = mujoco.MjSpec.from_file(str(path))
            edit(spec)
            model = spec.compile()
    except (ValueError, RuntimeError, MemoryError) as error:
        raise file_error(path, f"MuJoCo cannot read it: {_cause(str(error))}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    if warnings:
        raise file_error(path, f"MuJoCo warns of it: {' '.join(warnings[0].split()).rstrip('.')}")
    for name in dir(model):
        value = None if name.startswith("_") else getattr(model, name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not (np.abs(value) <= MAX_MAGNITUDE).all():
            raise file_error(
                path,
                f"MuJoCo makes a number of it ({name}) that is not finite; look for numbers that are very large or "
                "very small",
            )
    return model


def _cause(message: str) -> str:
    """MuJoCo's message about a file, in one clause."""
    text, _, place = re.sub(r"^(XML )?(Error: )*", "", message).partition("\nElement ")
    text = " ".join(text.split()).strip(" .").replace(" . T", "; t")
    text = text.replace("Error opening file", "it cannot open the file") or "it is too large"
    position = re.search(r"'(.*?)'.* line (\d+)", place)
    return f"{text} (line {position[2]}, element '{position[1]}')" if position else text


def sources(path: Path) -> list[Path]:
    """The files that an MJCF file reads: includes, meshes and images; FileError if an element or a file is refused."""
    scan = _Scan(path)
    scan.run(path, read_text(path, MAX_TEXT))
    scan.check_assets()
    return sorted(scan.files)


class _Scan:
    """One pass through a file and the files that it includes."""

    def __init__(self, path: Path):
        self.folder = path.parent
        self.elements = self.joints = self.pixels = 0
        self.folders = {""}  # that <compiler> names, before or after the assets in them
        self.assets: list[tuple[str, list[str], int]] = []  # "file:line", files of one asset, number of copies
        self.files: set[Path] = set()  # that are read besides it
        self.place = ""  # "file:line" of the current element

    def run(self, path: Path, content: str, including: tuple[Path, ...] = (), times: int = 1) -> None:
        """Check the text of a file, its content made ``times``; FileError if it is not XML or an element is refused."""
        parser = expat.ParserCreate("utf-8")
        above = [times]  # of each open element: number of copies of its content

        def refuse(what: str) -> None:
            raise file_error(path, what, parser.CurrentLineNumber)

        def begin(name: str, attributes: dict[str, str]) -> None:
            self.place = f"{short_name(path)}:{parser.CurrentLineNumber}"
            try:
                above.append(above[-1] * self.element(name, attributes, above[-1]))
            except (_ElementError, FileError) as error:
                refuse(str(error).rstrip("."))
            if len(above) > MAX_DEPTH:
                refuse(f"elements are nested deeper than {MAX_DEPTH} levels; make it simpler")
            if name == "include" and attributes.get("file"):
                inner = self.folder / attributes["file"]
                if inner in (path, *including) or len(including) > 10:
                    refuse(f"{attributes['file']} includes itself; remove this")
                try:
                    included = read_text(inner, MAX_TEXT)
                except FileError as error:
                    return refuse(str(error).rstrip("."))
                self.files.add(inner)
                self.run(inner, included, (*including, path), above[-1])

        parser.StartElementHandler = begin
        parser.EndElementHandler = lambda _: above.pop()
        parser.StartDoctypeDeclHandler = lambda *_: refuse("has a document type, which MJCF does not; remove it")
        try:
            parser.Parse(content.encode("utf-8"), True)
        except expat.ExpatError as error:
            text = f"is not XML: {expat.ErrorString(error.code)}"
            raise file_error(path, text, error.lineno, error.offset + 1) from None

    def element(self, name: str, attributes: dict[str, str], times: int) -> int:
        """Check an element; returns the number of copies of its content. Raises _ElementError."""
        if name == "robot":
            raise _ElementError("is URDF and not MJCF; sean import-robot makes a robot file of it")
        if name in REFUSED:
            raise _ElementError(f"<{name}> has no place in a scene or a robot; write its bodies and geoms instead")
        for key, value in attributes.items():
            self.check_attribute(name, key, value)

        # With all copies of replicates, of which each costs memory.
        self.elements += times
        if self.elements > MAX_ELEMENTS:
            raise _ElementError(f"makes more than {MAX_ELEMENTS:,} elements; use fewer")
        if name in ("joint", "freejoint"):
            self.joints += times
        if self.joints > MAX_JOINTS:
            raise _ElementError(f"makes more than {MAX_JOINTS} joints; obstacles need none, and a robot has five")
        if name == "compiler":
            self.folders.update(attributes[key] for key in FOLDERS if key in attributes)
            if len(self.folders) > MAX_FOLDERS:
                raise _ElementError(f"names more than {MAX_FOLDERS} folders of assets; use fewer")
        self.count_images(name, attributes)
        if name != "replicate":
            return 1
        count, *_ = _numbers(attributes.get("count", "")) or [1]
        return max(1, int(count))

    def check_attribute(self, name: str, key: str, value: str) -> None:
        """Check the numbers of an element's attribute. Raises _ElementError."""
        if key not in WORDS and not key.startswith("file"):
            _check_numbers(key, value)
        if (name, key) == ("size", "memory"):
            if _bytes(value) > MAX_MEMORY:
                raise _ElementError(f'size memory="{shorten(value, 40)}" must be at most {MAX_MEMORY // 10**6}M')
            return
        maximum = MAX_COUNTS.get((name, key), MAX_RESERVED if name == "size" else None)
        if maximum is not None and any(not -1 <= number <= maximum for number in _numbers(value)):
            raise _ElementError(f'{name} {key}="{shorten(value, 40)}" must be at most {maximum:,}')

    def count_images(self, name: str, attributes: dict[str, str]) -> None:
        """Count the pixels that MuJoCo paints for an element, and collect its files. Raises _ElementError."""
        cube = name == "texture" and attributes.get("type", "cube") in ("cube", "skybox")
        if name in ("texture", "hfield"):
            sides = ("width", "height") if name == "texture" else ("nrow", "ncol")
            width, height = (_side(attributes.get(side, "")) for side in sides)
            self.count_pixels(6 * width * max(width, height) if cube else width * height)  # a cube's sides are squares

        # Without a grid the image is all six sides of a cube.
        names = [value for key, value in attributes.items() if key.startswith("file")]
        if names and name != "include":
            copies = 6 if cube and "gridsize" not in attributes else 1
            self.assets.append((self.place, names, copies))

    def check_assets(self) -> None:
        """Count the pixels of the files of all assets, in all folders where they may be. Raises FileError."""
        pixels: dict[Path, int] = {}
        for place, names, copies in self.assets:
            largest = 0
            try:
                for path in sorted(self.possible_paths(names)):
                    if path not in pixels:
                        pixels[path] = _pixels(read_bytes(path, MAX_ASSET)) if path.exists() else 0
                    largest = max(largest, pixels[path])
                    if path.is_file():
                        self.files.add(path)
                self.count_pixels(largest * max(copies, len(names)))
            except (_ElementError, FileError) as error:
                raise FileError(f"{place}: {str(error).rstrip('.')}.") from None

    def possible_paths(self, names: list[str]) -> set[Path]:
        """Where the files of an asset may be: in each folder, with and without their own folders (strippath)."""
        paths = set()
        for name in names:
            for folder in self.folders:
                paths |= {self.folder / folder / name, self.folder / folder / re.split(r"[/\\]", name)[-1]}
        return paths

    def count_pixels(self, pixels: float) -> None:
        """Add pixels to the total; _ElementError if there are too many."""
        self.pixels += pixels
        if self.pixels > MAX_PIXELS:
            raise _ElementError(
                f"textures have more than {MAX_PIXELS // 10**6} million pixels in all; make them smaller"
            )


class _ElementError(Exception):
    """An element is refused, for a reason in one clause."""


def _numbers(value: str) -> list[float]:
    numbers = []
    for word in value.split():
        try:
            numbers.append(float(word))
        except ValueError:
            continue
    return numbers


def _side(value: str) -> float:
    """The width or height of an image, at least 1."""
    size, *_ = _numbers(value) or [1.0]
    return max(size, 1.0)


def _check_numbers(key: str, value: str) -> None:
    text = f'{key}="{shorten(value, 40)}"'
    for number in _numbers(value):
        if not math.isfinite(number):
            raise _ElementError(f"{text} holds a number that is not finite; give one that is")
        if abs(number) > MAX_MAGNITUDE:
            raise _ElementError(f"{text} holds a number beyond {MAX_MAGNITUDE:g}; give a smaller one")


def _bytes(value: str) -> float:
    """The bytes of a size such as 1M; 0 without a number."""
    power = "KMGTPE".find(value[-1:].upper() or " ") + 1
    number = _numbers(value[:-1] if power else value)
    return number[0] * 1024**power if number else 0.0


def _pixels(image: bytes) -> int:
    """Number of pixels of a PNG; 0 of other files, whose size bounds their pixels."""
    if not image.startswith(b"\x89PNG\r\n"):
        return 0
    return int.from_bytes(image[16:20], "big") * int.from_bytes(image[20:24], "big")
