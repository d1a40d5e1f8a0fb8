"""The points of meshes in STL, OBJ and COLLADA files, and XML as a tree whose elements know their lines."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat

import numpy as np

from sean_jax.core.errors import FileError
from sean_jax.core.messages import MAX_DEPTH
from sean_jax.io.files.reading import file_error, read_bytes, read_text

Element = ElementTree.Element
MAX_MESH = 50_000_000  # bytes
MAX_ELEMENTS = 100_000  # of an XML file
MAX_REACH = 1e6  # of a corner, in the units of the file, which may be millimetres
LINE = "line"  # attribute of an element of ``xml_tree``: its line in the file
MESHES = (".stl", ".obj", ".dae")
HEADER, TRIANGLE = 84, 50  # bytes of a binary STL file


def xml_tree(path: Path, max_bytes: int = MAX_MESH) -> Element:
    """The root element of an XML file; each element has its line as the attribute ``LINE``.

    Raises:
        FileError: the file cannot be read, is no XML, has a document type, or is too deep or too large.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate("utf-8")
    depth = count = 0

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise file_error(
                path, "elements are too many or nested too deep; make it simpler", parser.CurrentLineNumber
            )
        builder.start(name, {**attributes, LINE: str(parser.CurrentLineNumber)})

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def refuse(*_: object) -> None:
        raise file_error(path, "has a document type; remove it", parser.CurrentLineNumber)

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = begin, end, builder.data
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(read_text(path, max_bytes).encode("utf-8"), True)
    except expat.ExpatError as error:
        text = f"is not XML: {expat.ErrorString(error.code)}"
        raise file_error(path, text, error.lineno, error.offset + 1) from None
    return builder.close()


def vertices(path: Path) -> np.ndarray:
    """The corners (n, 3) of a mesh, in the units of the file; of COLLADA in metres.

    Raises:
        FileError: the file is none of ``MESHES``, cannot be read, or holds no finite corner.
    """
    kind = path.suffix.lower()
    if kind not in MESHES:
        raise file_error(path, f"is a mesh of a kind that is not read; convert it to one of {', '.join(MESHES)}")
    try:
        points = {".stl": _stl, ".obj": _obj, ".dae": _collada}[kind](path).reshape(-1, 3)
    except FileError:
        raise
    except (ValueError, IndexError, KeyError):
        cure = "a number is none, or too few stand together; write it again with the program that made it"
        raise file_error(path, f"is no {kind[1:].upper()} mesh: {cure}") from None
    if not len(points) or not (np.abs(points) <= MAX_REACH).all():
        raise file_error(path, f"holds no corner, or one beyond {MAX_REACH:g}; look at its numbers")
    return points


def _stl(path: Path) -> np.ndarray:
    content = read_bytes(path, MAX_MESH)
    number = int.from_bytes(content[80:HEADER], "little")
    if len(content) == HEADER + TRIANGLE * number:
        rows = np.frombuffer(content, np.uint8, offset=HEADER).reshape(-1, TRIANGLE)[:, 12:48]
        return np.ascontiguousarray(rows).view("<f4").astype(float)
    corners = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
    return np.array([[float(part) for part in corner] for corner in corners])


def _obj(path: Path) -> np.ndarray:
    lines = (line.split() for line in read_text(path, MAX_MESH).splitlines())
    return np.array([[float(part) for part in words[1:4]] for words in lines if words[:1] == ["v"]])


def _collada(path: Path) -> np.ndarray:
    root = xml_tree(path)
    scale = float(next((unit.get("meter", "1") for unit in root.iter("unit")), "1"))
    shapes = {geometry.get("id"): _positions(geometry) for geometry in root.iter("geometry")}
    scenes = list(root.iter("visual_scene"))
    found = [points for scene in scenes for node in scene.findall("node") for points in _node(node, np.eye(4), shapes)]
    return scale * np.concatenate(found or list(shapes.values()) or [np.zeros((0, 3))])


def _positions(geometry: Element) -> np.ndarray:
    """(n, 3) of a COLLADA geometry."""
    sources = {source.get("id"): source for source in geometry.iter("source")}
    rows = [np.zeros((0, 3))]
    for where in (entry for group in geometry.iter("vertices") for entry in group.findall("input")):
        source = sources.get(where.get("source", "")[1:])
        numbers = None if source is None else source.find("float_array")
        if where.get("semantic") == "POSITION" and numbers is not None:
            rows.append(np.array((numbers.text or "").split(), float).reshape(-1, 3))
    return np.concatenate(rows)


def _node(node: Element, above: np.ndarray, shapes: dict) -> list[np.ndarray]:
    """The points of a COLLADA node and of the nodes in it."""
    for part in node:
        numbers = [float(word) for word in (part.text or "").split()] if len(part) == 0 else []
        if part.tag == "matrix":
            above = above @ np.reshape(numbers, (4, 4))
        elif part.tag == "translate":
            above = above @ np.block([[np.eye(3), np.reshape(numbers, (3, 1))], [np.zeros(3), 1.0]])
        elif part.tag == "scale":
            above = above @ np.diag([*numbers, 1.0])
        elif part.tag == "rotate":
            turn = np.eye(4)
            turn[:3, :3] = rotation(np.array(numbers[:3]), np.deg2rad(numbers[3]))
            above = above @ turn
    result = []
    for part in node.findall("instance_geometry"):
        points = shapes.get(part.get("url", "")[1:], np.zeros((0, 3)))
        result.append(points @ above[:3, :3].T + above[:3, 3])
    return result + [points for inner in node.findall("node") for points in _node(inner, above, shapes)]


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """The matrix (3, 3) of a rotation by an angle [rad] about an axis of any length."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
