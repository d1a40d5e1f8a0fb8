"""MJCF files, looked through before MuJoCo compiles them: it takes sizes as they come, and NaN for a number.

What a scene or a robot of this package has no use for, and what is larger than any of them, is refused at its line.
"""

import math
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from sean_jax.files.content import DEEPEST, FileError, content, shown, text

MOST_ELEMENTS = 10_000  # in all, those of a replicate as often as it makes them
MOST_JOINTS = 100
MOST_PIXELS = 25_000_000  # of all textures and height fields together
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
WORDS = ("name", "class", "childclass", "file", "filename", "model", "prefix")  # attributes that are no numbers


def read(path: Path) -> Any:
    """The ``mujoco.MjModel`` of an MJCF (or URDF) file, in which every number is finite.

    Raises:
        FileError: one sentence that names the file, the line where there is one, and the cure.
    """
    _Scan(path).run(path, text(path, MOST_TEXT))
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
        self.assets = {"meshdir": "", "texturedir": "", "assetdir": ""}

    def run(self, path: Path, found: str, including: tuple[Path, ...] = (), times: int = 1) -> None:
        """Looks through the text ``found`` of a file that is made so many times. Raises FileError."""
        parser = expat.ParserCreate("utf-8")
        above = [times]  # how often what stands within the elements that are open is made

        def refuse(what: str) -> None:
            raise FileError(f"{shown(path)}:{parser.CurrentLineNumber}: {what}.")

        def begin(name: str, attributes: dict[str, str]) -> None:
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
            self.assets.update({key: attributes[key] for key in self.assets if key in attributes})
        self.images(name, attributes)
        return max(1, int((_numbers(attributes.get("count", "")) or [1])[0])) if name == "replicate" else 1

    def images(self, name: str, attributes: dict[str, str]) -> None:
        """Counts pixels, and looks at the files that an asset is made of. Raises _Wrong."""
        if name in ("texture", "hfield"):
            sides = ("width", "height") if name == "texture" else ("nrow", "ncol")
            sizes = [(_numbers(attributes.get(side, "")) or [1.0])[0] for side in sides]
            many = 6 if attributes.get("type", "cube") in ("cube", "skybox") else 1
            self.pixels += math.prod(max(size, 1.0) for size in sizes) * many
        for key, value in attributes.items():
            if key.startswith("file") and name != "include":
                for inner in {self.folder / folder / value for folder in self.assets.values()}:
                    if inner.exists():
                        self.pixels += _pixels(content(inner, MOST_ASSET))
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
