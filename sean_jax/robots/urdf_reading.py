"""Robots of URDF files, the XML of ROS, with meshes reduced to boxes, cylinders and spheres.

Source of the format: the URDF specification of ROS, http://wiki.ros.org/urdf/XML.
"""

from pathlib import Path

import numpy as np

from sean_jax.core.errors import FileError
from sean_jax.core.messages import shorten
from sean_jax.io.files import file_error, short_name
from sean_jax.io.files.meshes import LINE, Element, rotation, vertices, xml_tree
from sean_jax.robots.foreign_links import GRAY, THIN, ForeignBody, Link, LinkShape, enclosing

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


def read_urdf(path: Path) -> ForeignBody:
    """The robot of a URDF file.

    Raises:
        FileError: the file is no URDF; the sentence names file, line and element.
    """
    root = xml_tree(path)
    if root.tag != "robot":
        raise _error(path, root, "is no <robot>, so this is no URDF")
    values = (value for element in root.iter() for value in element.attrib.values())
    has_xacro_tags = any(element.tag.startswith("xacro:") for element in root.iter())
    if has_xacro_tags or any("${" in value for value in values):
        raise file_error(path, f"is xacro; expand it to URDF: xacro {path.name} > robot.urdf")
    elements = _named(path, root, "link")
    joints = _named(path, root, "joint")
    if not elements:
        raise _error(path, root, "has no <link>")
    if len(elements) > MAX_LINKS:
        raise _error(path, root, f"has {len(elements)} links; the most is {MAX_LINKS}")

    joint_above = _joints_above(path, joints, elements)
    root_link = _root_link(path, root, elements, joint_above)
    colors = {material.get("name", ""): _color(path, material) for material in root.findall("material")}
    body = ForeignBody(root.get("name") or path.stem, [], [], [])
    _add_links(path, body, root_link, elements, joint_above, colors)
    if len(body.links) < len(elements):
        raise _error(path, root, "has a loop of joints; links must form a tree")
    body.frames = [(link.name, link.place, link.turn) for link in body.links]
    return body


def _joints_above(path: Path, joints: dict[str, Element], elements: dict[str, Element]) -> dict[str, Element]:
    """The joint above each link, by the link's name; the root has none."""
    above: dict[str, Element] = {}
    for joint in joints.values():
        parent, child = (_link_of(path, joint, role, elements) for role in ("parent", "child"))
        if child in above:
            raise _error(path, joint, f"is the second joint above the link '{child}'; a link has one parent")
        if parent == child:
            raise _error(path, joint, f"has the link '{child}' as parent and as child")
        above[child] = joint
    return above


def _root_link(path: Path, root: Element, elements: dict[str, Element], joint_above: dict[str, Element]) -> str:
    """The name of the one link without a joint above it."""
    roots = [name for name in elements if name not in joint_above]
    if not roots:
        raise _error(path, root, "has a loop of joints and no root link; all links must hang on one")
    if len(roots) > 1:
        names = ", ".join(f"'{name}'" for name in roots[:5])
        raise _error(path, root, f"has {len(roots)} links without a parent ({names}); all links must hang on one")
    return roots[0]


def _add_links(
    path: Path,
    body: ForeignBody,
    root_link: str,
    elements: dict[str, Element],
    joint_above: dict[str, Element],
    colors: dict,
) -> None:
    """Append the links to the body, parents before children."""
    queue = [(root_link, -1)]
    while queue:
        name, parent = queue.pop(0)
        body.links.append(_link(path, elements[name], joint_above.get(name), parent, body, colors))
        index = len(body.links) - 1
        for child, joint in joint_above.items():
            if _link_of(path, joint, "parent", elements) == name:
                queue.append((child, index))


def _link(path: Path, element: Element, joint: Element | None, parent: int, body: ForeignBody, colors: dict) -> Link:
    if joint is None:
        upward = np.array([0.0, 0.0, 1.0])
        link = Link(element.get("name", ""), parent, "", "fixed", upward, np.zeros(3), np.eye(3))
    else:
        link = _jointed_link(path, element, joint, parent, body.links[parent])
    inertial = element.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is not None and mass is not None:
        _add_inertial(path, link, inertial, mass)
    else:
        link.center = link.place
    limit = None if joint is None else joint.find("limit")
    if limit is not None:
        link.max_rate = _limit(path, limit, "velocity")
        link.max_torque = _limit(path, limit, "effort")
        lower = _limit(path, limit, "lower")
        upper = _limit(path, limit, "upper")
        link.max_angle = None if lower is None or upper is None else min(lower, upper)
    link.shapes = _shapes(path, element, link, body, colors)
    return link


def _jointed_link(path: Path, element: Element, joint: Element, index: int, parent: Link) -> Link:
    """The frame of a link by the joint on its parent, the link of an index."""
    joint_type = joint.get("type", "")
    if joint_type not in KINDS:
        raise _error(path, joint, f"has the type '{shorten(joint_type, 30)}'; types are {', '.join(KINDS)}")
    kind = KINDS[joint_type]
    offset, rotation = _origin(path, joint)
    place = parent.place + parent.turn @ offset
    turn = parent.turn @ rotation

    # The axis of hinges and slides, by default along x.
    axis = np.array([0.0, 0.0, 1.0])
    line = joint.find("axis")
    along = np.array([1.0, 0.0, 0.0]) if line is None else _numbers(path, line, "xyz", 3)
    if kind in ("hinge", "slide"):
        length = np.linalg.norm(along)
        if not length > 1e-6:
            raise _error(path, joint if line is None else line, "is no direction; give an xyz that is not 0 0 0")
        axis = turn @ (along / length)
    return Link(element.get("name", ""), index, joint.get("name", ""), kind, axis, place, turn)


def _add_inertial(path: Path, link: Link, inertial: Element, mass: Element) -> None:
    """Mass, center and inertia of a link."""
    offset, rotation = _origin(path, inertial)
    link.mass = _number(path, mass, "value")
    if link.mass < 0.0:
        raise _error(path, mass, f"is {link.mass:g} kg; give 0 or more")
    link.center = link.place + link.turn @ offset
    inertia = inertial.find("inertia")
    if inertia is not None:
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = (_number(path, inertia, key, 0.0) for key in keys)
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        link.inertia = link.turn @ rotation @ matrix @ rotation.T @ link.turn.T


def _shapes(path: Path, element: Element, link: Link, body: ForeignBody, colors: dict) -> list[LinkShape]:
    """The shapes of the collision geometry of a link, or of its visual geometry if it has no other."""
    material = element.find("visual/material")
    color = GRAY
    if material is not None:
        color = _color(path, material) or colors.get(material.get("name", "")) or GRAY
    shapes: list[LinkShape] = []
    missing: list[str] = []
    for role in ("collision", "visual"):
        for element_with_shape in element.findall(role):
            offset, rotation = _origin(path, element_with_shape)
            place = link.place + link.turn @ offset
            shape = _shape(path, element_with_shape, place, link.turn @ rotation, color, missing)
            if shape is not None:
                shapes.append(shape)
        if shapes:
            return shapes
    body.missing += missing
    return shapes


def _shape(
    path: Path, element: Element, place: np.ndarray, turn: np.ndarray, color: tuple, missing: list
) -> LinkShape | None:
    """The shape in a <collision> or <visual>; None for a mesh that cannot be read, which is added to ``missing``."""
    geometry = element.find("geometry")
    if geometry is None or not len(geometry):
        raise _error(path, element, "has no <geometry> with a shape in it")
    shape = geometry[0]
    if shape.tag == "box":
        size = _positive(path, shape, _numbers(path, shape, "size", 3)) / 2
        return LinkShape("box", size, place, turn, color)
    if shape.tag in ("cylinder", "capsule"):
        size = np.array([_number(path, shape, "radius"), _number(path, shape, "length") / 2])
        return LinkShape("cylinder", _positive(path, shape, size), place, turn, color)
    if shape.tag == "sphere":
        size = np.array([_number(path, shape, "radius")])
        return LinkShape("sphere", _positive(path, shape, size), place, turn, color)
    if shape.tag != "mesh":
        raise _error(path, shape, "is no shape; shapes are box, cylinder, sphere and mesh")

    name = shape.get("filename", "")
    mesh_file = _find(path, name)
    scale = _numbers(path, shape, "scale", 3) if shape.get("scale") else np.ones(3)
    try:
        if mesh_file is None:
            raise FileError(f"{name}: there is no such file.")
        return enclosing(vertices(mesh_file) * scale, place, turn, color)
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
    words = [word for word in Path(name).parts if word not in ("..", "/")]
    for folder in path.resolve().parents:
        candidates = [path.parent / name]
        if words:
            candidates.append(folder.joinpath(*words))
        if len(words) > 1 and folder.name == words[0]:
            candidates.append(folder.joinpath(*words[1:]))
        for candidate in candidates:
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
    element = joint.find(role)
    name = "" if element is None else element.get("link", "")
    if name in links:
        return name
    if not name:
        raise _error(path, joint, f"has no {role}")
    raise _error(path, joint, f"has the {role} '{shorten(name, 40)}', which is no link")


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
    if color is None:
        return None
    return tuple(np.clip(_numbers(path, color, "rgba", 4)[:3], 0.0, 1.0).tolist())


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
        numbers = "a number" if count == 1 else f"{count} numbers"
        if text is None:  # a number without a maximum has a default
            raise _error(path, element, f"needs {numbers} from -1e6 to 1e6, but {key} is missing")
        if np.isinf(maximum):
            raise _error(path, element, f'needs {numbers}, but {key} is "{shorten(text, 40)}"')
        raise _error(path, element, f'needs {numbers} from -1e6 to 1e6, but {key} is "{shorten(text, 40)}"')
    return values


def _error(path: Path, element: Element, text: str) -> FileError:
    name = element.get("name")
    label = f"<{element.tag}>" if name is None else f'<{element.tag} name="{shorten(name, 40)}">'
    return FileError(f"{short_name(path)}:{element.get(LINE)}: {label} {text}.")
