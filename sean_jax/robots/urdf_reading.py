"""Robots of URDF files, the XML of ROS, with meshes reduced to boxes, cylinders and spheres.

Source of the format: the URDF specification of ROS, http://wiki.ros.org/urdf/XML.
"""

from pathlib import Path

import numpy as np

from sean_jax.core.errors import FileError
from sean_jax.core.messages import shorten
from sean_jax.io.files import file_error, short_name
from sean_jax.io.files.meshes import LINE, Element, rotation, vertices, xml_tree
from sean_jax.robots.foreign_links import GRAY, THIN, Body, Link, Shape, enclosing

KINDS = {
    "revolute": "hinge",
    "continuous": "hinge",
    "prismatic": "slide",
    "fixed": "fixed",
    "floating": "other",
    "planar": "other",
}
MAX_LINKS = 500
MAX_NAME = 1_000  # characters of a file's name
UNLIMITED = 1e4  # rad/s, N m or rad; greater limits are none
SCHEMES = ("package://", "model://", "file://")


def read(path: Path) -> Body:
    """The robot of a URDF file.

    Raises:
        FileError: the file is no URDF; the sentence names file, line and element.
    """
    root = xml_tree(path)
    if root.tag != "robot":
        raise _error(path, root, "is no <robot>, so this is no URDF")
    values = (value for element in root.iter() for value in element.attrib.values())
    if any(element.tag.startswith("xacro:") for element in root.iter()) or any("${" in value for value in values):
        raise file_error(path, f"is xacro; expand it to URDF: xacro {path.name} > robot.urdf")
    elements = _named(path, root, "link")
    joints = _named(path, root, "joint")
    if not elements:
        raise _error(path, root, "has no <link>")
    if len(elements) > MAX_LINKS:
        raise _error(path, root, f"has {len(elements)} links; the most is {MAX_LINKS}")
    above: dict[str, Element] = {}
    for joint in joints.values():
        parent, child = (_link_of(path, joint, role, elements) for role in ("parent", "child"))
        if child in above:
            raise _error(path, joint, f"is the second joint above the link '{child}'; a link has one parent")
        if parent == child:
            raise _error(path, joint, f"has the link '{child}' as parent and as child")
        above[child] = joint
    roots = [name for name in elements if name not in above]
    if len(roots) != 1:
        some = ", ".join(f"'{name}'" for name in roots[:5])
        what = f"has {len(roots)} links without a parent ({some})" if roots else "has a loop of joints and no root link"
        raise _error(path, root, f"{what}; all links must hang on one")
    colors = {material.get("name", ""): _color(path, material) for material in root.findall("material")}
    body = Body(root.get("name") or path.stem, [], [], [])
    waiting = [(roots[0], -1)]
    while waiting:
        name, parent = waiting.pop(0)
        body.links.append(_link(path, elements[name], above.get(name), parent, body, colors))
        index = len(body.links) - 1
        waiting += [
            (child, index) for child, joint in above.items() if _link_of(path, joint, "parent", elements) == name
        ]
    if len(body.links) < len(elements):
        raise _error(path, root, "has a loop of joints; links must form a tree")
    body.frames = [(link.name, link.place, link.turn) for link in body.links]
    return body


def _link(path: Path, element: Element, joint: Element | None, parent: int, body: Body, colors: dict) -> Link:
    place, turn, axis, kind = np.zeros(3), np.eye(3), np.array([0.0, 0.0, 1.0]), "fixed"
    if joint is not None:
        kind = joint.get("type", "")
        if kind not in KINDS:
            raise _error(path, joint, f"has the type '{shorten(kind, 30)}'; types are {', '.join(KINDS)}")
        on = body.links[parent]
        offset, own = _origin(path, joint)
        place, turn, kind = on.place + on.turn @ offset, on.turn @ own, KINDS[kind]
        line = joint.find("axis")
        along = np.array([1.0, 0.0, 0.0]) if line is None else _numbers(path, line, "xyz", 3)
        if kind in ("hinge", "slide"):
            if not np.linalg.norm(along) > 1e-6:
                raise _error(path, joint if line is None else line, "is no direction; give an xyz that is not 0 0 0")
            axis = turn @ (along / np.linalg.norm(along))
    link = Link(
        element.get("name", ""), parent, "" if joint is None else joint.get("name", ""), kind, axis, place, turn
    )
    inertial = element.find("inertial")
    if inertial is not None and (mass := inertial.find("mass")) is not None:
        offset, own = _origin(path, inertial)
        link.mass = _number(path, mass, "value")
        if link.mass < 0.0:
            raise _error(path, mass, f"is {link.mass:g} kg; give 0 or more")
        link.center = place + turn @ offset
        about = inertial.find("inertia")
        if about is not None:
            xx, xy, xz, yy, yz, zz = (
                _number(path, about, key, 0.0) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            )
            matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            link.inertia = turn @ own @ matrix @ own.T @ turn.T
    else:
        link.center = place
    limit = None if joint is None else joint.find("limit")
    if limit is not None:
        link.max_rate = _limit(path, limit, "velocity")
        link.max_torque = _limit(path, limit, "effort")
        sides = [_limit(path, limit, key) for key in ("lower", "upper")]
        link.max_angle = None if None in sides else min(side for side in sides if side is not None)
    link.shapes = _shapes(path, element, link, body, colors)
    return link


def _shapes(path: Path, element: Element, link: Link, body: Body, colors: dict) -> list[Shape]:
    """The shapes of the collision geometry of a link, or of its visual geometry if it has no other."""
    material = element.find("visual/material")
    color = GRAY
    if material is not None:
        color = _color(path, material) or colors.get(material.get("name", "")) or GRAY
    result: list[Shape] = []
    missing: list[str] = []
    for role in ("collision", "visual"):
        for part in element.findall(role):
            offset, own = _origin(path, part)
            place, turn = link.place + link.turn @ offset, link.turn @ own
            shape = _shape(path, part, place, turn, color, missing)
            result += [] if shape is None else [shape]
        if result:
            return result
    body.missing += missing
    return result


def _shape(path: Path, part: Element, place: np.ndarray, turn: np.ndarray, color: tuple, missing: list) -> Shape | None:
    geometry = part.find("geometry")
    kind = None if geometry is None or not len(geometry) else geometry[0]
    if kind is None:
        raise _error(path, part, "has no <geometry> with a shape in it")
    if kind.tag == "box":
        return Shape("box", _positive(path, kind, _numbers(path, kind, "size", 3)) / 2, place, turn, color)
    if kind.tag in ("cylinder", "capsule"):
        size = np.array([_number(path, kind, "radius"), _number(path, kind, "length") / 2])
        return Shape("cylinder", _positive(path, kind, size), place, turn, color)
    if kind.tag == "sphere":
        return Shape("sphere", _positive(path, kind, np.array([_number(path, kind, "radius")])), place, turn, color)
    if kind.tag != "mesh":
        raise _error(path, kind, "is no shape; shapes are box, cylinder, sphere and mesh")
    name = kind.get("filename", "")
    found = _find(path, name)
    scale = _numbers(path, kind, "scale", 3) if kind.get("scale") else np.ones(3)
    try:
        if found is None:
            raise FileError(f"{name}: there is no such file.")
        return enclosing(vertices(found) * scale, place, turn, color)
    except FileError:
        missing.append(name)
        return None


def _positive(path: Path, element: Element, size: np.ndarray) -> np.ndarray:
    if not (size > 0.0).all():
        raise _error(path, element, "has a size that is 0 or negative")
    return np.maximum(size, THIN)


def _find(path: Path, name: str) -> Path | None:
    """The file of a mesh: beside the URDF file, or below one of its folders, as packages of ROS lie."""
    for scheme in SCHEMES:
        name = name.removeprefix(scheme)
    if len(name) > MAX_NAME:
        return None
    parts = [part for part in Path(name).parts if part not in ("..", "/")]
    for folder in path.resolve().parents:
        tries = [folder.joinpath(*parts)] if parts else []
        if len(parts) > 1 and folder.name == parts[0]:
            tries.append(folder.joinpath(*parts[1:]))
        for candidate in [path.parent / name, *tries]:
            if candidate.is_file():
                return candidate
    return None


def _named(path: Path, root: Element, tag: str) -> dict[str, Element]:
    result: dict[str, Element] = {}
    for element in root.findall(tag):
        name = element.get("name", "")
        if not name:
            raise _error(path, element, "has no name")
        if name in result:
            raise _error(path, element, f"has the name of the one in line {result[name].get(LINE)}")
        result[name] = element
    return result


def _link_of(path: Path, joint: Element, role: str, links: dict[str, Element]) -> str:
    part = joint.find(role)
    name = "" if part is None else part.get("link", "")
    if name not in links:
        raise _error(
            path, joint, f"has the {role} '{shorten(name, 40)}', which is no link" if name else f"has no {role}"
        )
    return name


def _origin(path: Path, element: Element) -> tuple[np.ndarray, np.ndarray]:
    """(3,) m and (3, 3) of the <origin> in an element."""
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.eye(3)
    roll, pitch, yaw = _numbers(path, origin, "rpy", 3) if origin.get("rpy") else np.zeros(3)
    place = _numbers(path, origin, "xyz", 3) if origin.get("xyz") else np.zeros(3)
    x, y, z = np.eye(3)
    return place, rotation(z, yaw) @ rotation(y, pitch) @ rotation(x, roll)


def _color(path: Path, material: Element) -> tuple[float, ...] | None:
    color = material.find("color")
    return None if color is None else tuple(np.clip(_numbers(path, color, "rgba", 4)[:3], 0.0, 1.0).tolist())


def _limit(path: Path, element: Element, key: str) -> float | None:
    """The size of a limit; None if there is none, which some files write as 0 or as a huge number."""
    value = abs(float(_numbers(path, element, key, 1, 0.0, np.inf)[0]))
    return value if 0.0 < value <= UNLIMITED else None


def _number(path: Path, element: Element, key: str, default: float | None = None) -> float:
    return float(_numbers(path, element, key, 1, default)[0])


def _numbers(
    path: Path, element: Element, key: str, count: int, default: float | None = None, maximum: float = 1e6
) -> np.ndarray:
    text = element.get(key)
    if text is None and default is not None:
        return np.full(count, default)
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.abs(values) <= maximum).all():
        many = "a number" if count == 1 else f"{count} numbers"
        has = "is missing" if text is None else f'is "{shorten(text, 40)}"'
        bounds = " from -1e6 to 1e6" if np.isfinite(maximum) else ""
        raise _error(path, element, f"needs {many}{bounds}, but {key} {has}")
    return values


def _error(path: Path, element: Element, text: str) -> FileError:
    name = element.get("name")
    label = f"<{element.tag}>" if name is None else f'<{element.tag} name="{shorten(name, 40)}">'
    return FileError(f"{short_name(path)}:{element.get(LINE)}: {label} {text}.")
