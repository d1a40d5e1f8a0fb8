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
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    depth = count = 0

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth += 1
        count += 1
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

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
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
        raise file_error(
            path,
            f"is no {kind[1:].upper()} mesh: a number is none, or too few stand together; write it again with the "
            "program that made it",
        ) from None
    if not len(points) or not (np.abs(points) <= MAX_REACH).all():
        raise file_error(path, f"holds no corner, or one beyond {MAX_REACH:g}; look at its numbers")
    return points


def _stl(path: Path) -> np.ndarray:
    content = read_bytes(path, MAX_MESH)
    count = int.from_bytes(content[80:HEADER], "little")
    if len(content) == HEADER + TRIANGLE * count:
        triangles = np.frombuffer(content, np.uint8, offset=HEADER).reshape(-1, TRIANGLE)
        corners = np.ascontiguousarray(triangles[:, 12:48])  # bytes, behind the normal
        return corners.view("<f4").astype(float)
    words = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", content)
    return _floats(words)


def _obj(path: Path) -> np.ndarray:
    corners = []
    for line in read_text(path, MAX_MESH).splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            corners.append(words[1:4])
    return _floats(corners)


def _floats(rows: list) -> np.ndarray:
    return np.array([[float(word) for word in row] for row in rows])


def _collada(path: Path) -> np.ndarray:
    root = xml_tree(path)
    scale = float(next((unit.get("meter", "1") for unit in root.iter("unit")), "1"))
    shapes = {geometry.get("id"): _positions(geometry) for geometry in root.iter("geometry")}

    # Scenes place the shapes; a file without any has them where they are.
    points: list[np.ndarray] = []
    for scene in root.iter("visual_scene"):
        for node in scene.findall("node"):
            points += _node(node, np.eye(4), shapes)
    return scale * np.concatenate(points or list(shapes.values()) or [np.zeros((0, 3))])


def _positions(geometry: Element) -> np.ndarray:
    """(n, 3) of a COLLADA geometry."""
    sources = {source.get("id"): source for source in geometry.iter("source")}
    rows = [np.zeros((0, 3))]
    for entry in geometry.iterfind(".//vertices/input"):
        source = sources.get(entry.get("source", "")[1:])
        numbers = None if source is None else source.find("float_array")
        if entry.get("semantic") == "POSITION" and numbers is not None:
            rows.append(np.array((numbers.text or "").split(), float).reshape(-1, 3))
    return np.concatenate(rows)


def _node(node: Element, above: np.ndarray, shapes: dict) -> list[np.ndarray]:
    """The points of a COLLADA node and of the nodes in it."""
    transform = above  # (4, 4)
    for step in node:
        numbers = [] if len(step) else [float(word) for word in (step.text or "").split()]
        if step.tag in TRANSFORMS:
            transform = transform @ TRANSFORMS[step.tag](numbers)
    points = []
    for instance in node.findall("instance_geometry"):
        shape = shapes.get(instance.get("url", "")[1:], np.zeros((0, 3)))
        points.append(shape @ transform[:3, :3].T + transform[:3, 3])
    for inner in node.findall("node"):
        points += _node(inner, transform, shapes)
    return points


def _translation(numbers: list[float]) -> np.ndarray:
    return np.block([[np.eye(3), np.reshape(numbers, (3, 1))], [np.zeros(3), 1.0]])


def _rotation(numbers: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(np.array(numbers[:3]), np.deg2rad(numbers[3]))
    return matrix


TRANSFORMS = {
    "matrix": lambda numbers: np.reshape(numbers, (4, 4)),
    "translate": _translation,
    "scale": lambda numbers: np.diag([*numbers, 1.0]),
    "rotate": _rotation,
}
"""Element of a COLLADA node -> the matrix (4, 4) of its numbers."""


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """The matrix (3, 3) of a rotation by an angle [rad] about an axis of any length."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
