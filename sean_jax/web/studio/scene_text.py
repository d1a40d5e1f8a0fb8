"""Boxes of a scene.xml, and changes of their attributes in its text: all other characters stay."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat

import numpy as np

from sean_jax.core.errors import InputError
from sean_jax.world import environment

ATTRIBUTE = rb"""\s+([\w:.-]+)\s*=\s*("[^"]*"|'[^']*')"""
TAG = re.compile(rb"<geom((?:" + ATTRIBUTE + rb")*)\s*(/?)>")
TURNS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")  # attributes that turn a geom
NEW = 0.8, 0.8, 1.0  # m, of a new box


class SceneBox(NamedTuple):
    """A box that the page can change."""

    center: tuple[float, ...]  # m
    half: tuple[float, ...]  # m
    yaw: float  # degrees


class _Geom(NamedTuple):
    start: int  # bytes, of its element
    head: int  # where its first tag ends
    end: int


class _GeomPlaces(NamedTuple):
    geoms: dict[str, _Geom]  # that have a name and stand in the world itself
    names: set[str]  # of all geoms
    compiler: dict[str, str]
    last: int  # where the last of the geoms ends, or the world's first tag


def boxes(path: Path, text: str) -> dict[str, SceneBox]:
    """The obstacles of a scene, whose text is in a file already, that have a name and stand in the world itself."""
    names = _scan(text.encode()).geoms
    return {name: SceneBox(*values) for name, values in environment.named_boxes(path).items() if name in names}


def moved(text: str, name: str, before: SceneBox, after: SceneBox) -> str:
    """The text with a box elsewhere, of another size or turned.

    Raises:
        InputError: the file turns its geoms in another way.
    """
    data = text.encode()
    scene = _scan(data)
    changes = {}
    if before.center != after.center:
        changes["pos"] = _numbers(after.center)
    if before.half != after.half:
        changes["size"] = _numbers(after.half)
    if before.yaw != after.yaw:
        if scene.compiler.get("eulerseq", "xyz") != "xyz":
            raise InputError("edit: the file has another order of turns, eulerseq; turn the box in the file.")
        radians = scene.compiler.get("angle") == "radian"
        changes |= dict.fromkeys(TURNS, "")
        changes["euler"] = f"0 0 {np.deg2rad(after.yaw) if radians else after.yaw:.6g}"
    geom = scene.geoms[name]
    tag = data[geom.start : geom.head]
    for key, value in changes.items():
        tag = _with_attribute(tag, key.encode(), value.encode())
    return (data[: geom.start] + tag + data[geom.head :]).decode()


def added(text: str, name: str, x: float, y: float) -> str:
    """The text with another box, behind the other geoms.

    Raises:
        InputError: the name is no word, or another geom's.
    """
    data = text.encode()
    scene = _scan(data)
    if not re.fullmatch(r"[\w.-]+", name, re.ASCII):
        raise InputError(f"edit: {name!r} is no name for a box; give letters, digits and _.")
    if name in scene.names:
        raise InputError(f"edit: there is a geom {name!r} already; give another name.")
    half = [side / 2 for side in NEW]
    geom = f'<geom name="{name}" type="box" pos="{_numbers((x, y, half[2]))}" size="{_numbers(half)}"/>'
    indent = b"    "
    if scene.geoms:  # as the last of them
        line = data[data.rfind(b"\n", 0, scene.last) + 1 :]
        indent = line[: len(line) - len(line.lstrip(b" \t"))]
    return (data[: scene.last] + b"\n" + indent + geom.encode() + data[scene.last :]).decode()


def removed(text: str, name: str) -> str:
    """The text without a box, and without its line if there is nothing else in it."""
    data = text.encode()
    geom = _scan(data).geoms[name]
    start = data.rfind(b"\n", 0, geom.start) + 1
    end = data.find(b"\n", geom.end) + 1
    if end == 0 or data[start : geom.start].strip() or data[geom.end : end].strip():
        return (data[: geom.start] + data[geom.end :]).decode()
    return (data[:start] + data[end:]).decode()


def _with_attribute(tag: bytes, key: bytes, value: bytes) -> bytes:
    """A tag with another value of an attribute; without it if the value is empty."""
    for match in re.finditer(ATTRIBUTE, tag):
        if match[1] == key:
            if not value:
                return tag[: match.start()] + tag[match.end() :]
            return tag[: match.start(2)] + b'"' + value + b'"' + tag[match.end() :]
    if not value:
        return tag
    end = b"/>" if tag.endswith(b"/>") else b">"
    before = tag.removesuffix(end).rstrip()
    return before + b" " + key + b'="' + value + b'"' + tag[len(before) :]


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _scan(data: bytes) -> _GeomPlaces:
    """Where the geoms of a scene are in its bytes, which are XML."""
    parser = expat.ParserCreate("utf-8")
    above: list[str] = []  # elements that are open
    scene = {"geoms": {}, "names": set(), "compiler": {}, "last": 0}
    begun: list[tuple[str, int, int]] = []  # name ("" if it cannot be changed), start and end of the tag of open geoms

    def begin(name: str, attributes: Mapping[str, str]) -> None:
        place = parser.CurrentByteIndex
        if name == "compiler":
            scene["compiler"].update(attributes)
        elif name == "worldbody":
            scene["last"] = data.index(b">", place) + 1
        elif name == "geom":
            own = attributes.get("name", "")
            scene["names"].add(own)
            tag = TAG.match(data, place)
            if above == ["mujoco", "worldbody"] and tag is not None:
                begun.append(("" if "fromto" in attributes else own, place, tag.end()))
        above.append(name)

    def end(name: str) -> None:
        above.pop()
        if name == "geom" and begun and above == ["mujoco", "worldbody"]:
            own, start, head = begun.pop()
            closed = data[head - 2 : head] == b"/>"
            scene["last"] = head if closed else data.index(b">", parser.CurrentByteIndex) + 1
            if own:
                scene["geoms"][own] = _Geom(start, head, scene["last"])

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.Parse(data, True)
    return _GeomPlaces(**scene)
