"""MJCF files, looked through before MuJoCo compiles them: it takes sizes as they come, and NaN for a number.

What a scene or a robot of this package has no use for, and what is larger than any of them, is refused at its line.
"""

import math
import re
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from sean_jax.files.content import DEEPEST, FileError, content, shown, text

MOST_ELEMENTS = 10_000  # in all, those of a replicate as often as it makes them
MOST_JOINTS = 100
MOST_PIXELS = 25_000_000  # of all textures and height fields together
MOST_FOLDERS = 30  # that <compiler> names for meshes and textures
MOST_TEXT = 10_000_000  # bytes
MOST_ASSET = 50_000_000  # bytes of a mesh or an image
LARGEST = 1e10  # of a number; MuJoCo's own bound of what a simulation may hold
# element, attribute -> the most that it may be; what it sets is allocated
COUNTS = {
    ("replicate", "count"): 1_000,
    ("numeric", "size"): 500,
    ("user", "dim"): 1_000,
    ("mesh", "params"): 256,
}
MOST_SIZE = 10_000  # of what <size> reserves, memory excepted
MOST_MEMORY = 100_000_000  # bytes
REFUSED = ("attach", "composite", "extension", "flex", "flexcomp", "plugin", "skin")
FOLDERS = ("meshdir", "texturedir", "assetdir")  # attributes of <compiler>
WORDS = ("name", "class", "childclass", "file", "filename", "model", "prefix")  # attributes that are no numbers


def read(path: Path) -> Any:
    """The ``mujoco.MjModel`` of an MJCF (or URDF) file, in which every number is finite.

    Raises:
        FileError: one sentence that names the file, the line where there is one, and the cure.
    """
    scan = _Scan(path)
    scan.run(path, text(path, MOST_TEXT))
    scan.files()
    mujoco: Any = import_module("mujoco")  # late, for it takes time; Any, for it has no type stubs
    warned: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warned.append)  # or it prints, and writes a log where the program was started
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError, MemoryError) as error:
        told = " ".join(str(error).split()).rstrip(".") or "it is too large"
        raise FileError(f"{shown(path)}: MuJoCo cannot read it: {told}.") from None
    finally:
        mujoco.set_mju_user_warning(before)
    if warned:
        raise FileError(f"{shown(path)}: MuJoCo warns of it: {' '.join(warned[0].split()).rstrip('.')}.")
    for name in dir(model):
        value = None if name.startswith("_") else getattr(model, name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not (np.abs(value) <= LARGEST).all():
            raise FileError(
                f"{shown(path)}: MuJoCo makes a number of it ({name}) that is not finite; look for numbers "
                f"that are very large or very small."
            )
    return model


class _Scan:
    """One look through a file and those that it includes."""

    def __init__(self, path: Path):
        self.folder = path.parent
        self.elements = self.joints = self.pixels = 0
        self.folders = {""}  # that <compiler> names, before or after the assets that lie there
        self.assets: list[tuple[str, list[str], int]] = []  # "file:line", files that make one asset, how often
        self.place = ""  # "file:line" of the element that is looked at

    def run(self, path: Path, found: str, including: tuple[Path, ...] = (), times: int = 1) -> None:
        """Looks through the text ``found`` of a file that is made so many times. Raises FileError."""
        parser = expat.ParserCreate("utf-8")
        above = [times]  # how often what stands within the elements that are open is made

        def refuse(what: str) -> None:
            raise FileError(f"{shown(path)}:{parser.CurrentLineNumber}: {what}.")

        def begin(name: str, attributes: dict[str, str]) -> None:
            self.place = f"{shown(path)}:{parser.CurrentLineNumber}"
            try:
                above.append(above[-1] * self.element(name, attributes, above[-1]))
            except (_Wrong, FileError) as wrong:
                refuse(str(wrong).rstrip("."))
            if len(above) > DEEPEST:
                refuse(f"elements are nested deeper than {DEEPEST} levels; make it simpler")
            if name == "include" and attributes.get("file"):
                inner = self.folder / attributes["file"]
                if inner in (path, *including) or len(including) > 10:
                    refuse(f"{attributes['file']} includes itself; remove this")
                try:
                    included = text(inner, MOST_TEXT)
                except FileError as wrong:
                    return refuse(str(wrong).rstrip("."))
                self.run(inner, included, (*including, path), above[-1])

        def doctype(*_: Any) -> None:
            refuse("has a document type, which MJCF does not; remove it")

        parser.StartElementHandler = begin
        parser.EndElementHandler = lambda _: above.pop()
        parser.StartDoctypeDeclHandler = doctype
        try:
            parser.Parse(found.encode("utf-8"), True)
        except expat.ExpatError as error:
            place = f"{shown(path)}:{error.lineno}:{error.offset + 1}"
            raise FileError(f"{place}: is not XML: {expat.ErrorString(error.code)}.") from None

    def element(self, name: str, attributes: dict[str, str], times: int) -> int:
        """How often an element makes what stands in it. Raises _Wrong."""
        if name in REFUSED:
            raise _Wrong(f"<{name}> has no place in a scene or a robot; write its bodies and geoms instead")
        for key, value in attributes.items():
            if key not in WORDS and not key.startswith("file"):
                _check_numbers(key, value)
            most = COUNTS.get((name, key), MOST_SIZE if name == "size" and key != "memory" else None)
            if most is not None and any(not -1 <= number <= most for number in _numbers(value)):
                raise _Wrong(f'{name} {key}="{_short(value)}" must be at most {most:,}')
        if name == "size" and _bytes(attributes.get("memory", "")) > MOST_MEMORY:
            raise _Wrong(f'size memory="{_short(attributes["memory"])}" must be at most {MOST_MEMORY // 10**6}M')
        self.elements += times
        if self.elements > MOST_ELEMENTS:
            raise _Wrong(f"makes more than {MOST_ELEMENTS:,} elements; use fewer")
        self.joints += times if name in ("joint", "freejoint") else 0
        if self.joints > MOST_JOINTS:
            raise _Wrong(f"makes more than {MOST_JOINTS} joints; obstacles need none, and a robot has five")
        if name == "compiler":
            self.folders.update(attributes[key] for key in FOLDERS if key in attributes)
            if len(self.folders) > MOST_FOLDERS:
                raise _Wrong(f"names more than {MOST_FOLDERS} folders of assets; use fewer")
        self.images(name, attributes)
        return max(1, int((_numbers(attributes.get("count", "")) or [1])[0])) if name == "replicate" else 1

    def images(self, name: str, attributes: dict[str, str]) -> None:
        """Counts the pixels of what MuJoCo paints, and keeps the names of what it reads. Raises _Wrong."""
        cube = name == "texture" and attributes.get("type", "cube") in ("cube", "skybox")
        if name in ("texture", "hfield"):
            sides = ("width", "height") if name == "texture" else ("nrow", "ncol")
            sizes = [(_numbers(attributes.get(side, "")) or [1.0])[0] for side in sides]
            width, height = (max(size, 1.0) for size in sizes)
            self.count(6 * width * max(width, height) if cube else width * height)  # a cube's sides are squares
        if name != "include":
            found = [value for key, value in attributes.items() if key.startswith("file")]
            if found:  # without a grid the image is all six sides of a cube
                self.assets.append((self.place, found, 6 if cube and "gridsize" not in attributes else 1))

    def files(self) -> None:
        """Looks at the files of all assets, in whichever of the folders they are. Raises FileError."""
        seen: dict[Path, int] = {}
        for place, names, many in self.assets:
            largest = 0
            parts = {part for name in names for part in (name, re.split(r"[/\\]", name)[-1])}  # as of strippath
            try:
                for path in sorted({self.folder / folder / part for folder in self.folders for part in parts}):
                    if path not in seen:
                        seen[path] = _pixels(content(path, MOST_ASSET)) if path.exists() else 0
                    largest = max(largest, seen[path])
                self.count(largest * max(many, len(names)))
            except (_Wrong, FileError) as wrong:
                raise FileError(f"{place}: {str(wrong).rstrip('.')}.") from None

    def count(self, pixels: float) -> None:
        self.pixels += pixels
        if self.pixels > MOST_PIXELS:
            raise _Wrong(f"textures have more than {MOST_PIXELS // 10**6} million pixels in all; make them smaller")


class _Wrong(Exception):
    """What is wrong with an element, as a clause."""


def _short(value: str) -> str:
    return value if len(value) <= 40 else value[:37] + "..."


def _numbers(value: str) -> list[float]:
    found = []
    for word in value.split():
        try:
            found.append(float(word))
        except ValueError:
            continue
    return found


def _check_numbers(key: str, value: str) -> None:
    for number in _numbers(value):
        if not math.isfinite(number):
            raise _Wrong(f'{key}="{_short(value)}" holds a number that is not finite; give one that is')
        if abs(number) > LARGEST:
            raise _Wrong(f'{key}="{_short(value)}" holds a number beyond {LARGEST:g}; give a smaller one')


def _bytes(value: str) -> float:
    scale = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}.get(value[-1:].upper(), 0)
    number = _numbers(value[:-1] if scale else value)
    return number[0] * (scale or 1) if number else 0.0


def _pixels(image: bytes) -> int:
    """Of a PNG; 0 of other files, whose size bounds what they hold."""
    if not image.startswith(b"\x89PNG\r\n"):
        return 0
    return int.from_bytes(image[16:20], "big") * int.from_bytes(image[20:24], "big")
