"""Physical environments (section IV-C): the files of a folder as obstacles on a floor, free places, scenery."""

import dataclasses
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pydantic
from jaxtyping import Float
from numpy.typing import ArrayLike

from sean_jax.core.bounds import MAX_COORDINATE, MAX_FLOOR_SIDE, MAX_OBSTACLES, MAX_PEOPLE, Coordinate
from sean_jax.core.data_types import PATTERNS, Array, Environment, Obstacles, Scenery, Solids
from sean_jax.core.devices import to_device
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.geometry import build_obstacle_grid, signed_distances, signed_distances_on_host
from sean_jax.io import files
from sean_jax.io.files import mjcf

HERE = Path(__file__).resolve().parents[1]
# Beside the package in a checkout, inside it once installed.
ENVS: Path = next((path for path in (HERE / "envs", HERE.parent / "envs") if path.is_dir()), HERE / "envs")

SETTINGS = "environment.yaml"
SCENE = "scene.xml"
ANNOTATIONS = "graph.yaml", "handcrafted.yaml"  # which some behaviors read
TILT_TOLERANCE = 1e-4  # maximum deviation of the cosine of a box's tilt from 1
MAX_BOTTOM = 0.05  # m above the floor, for the bottom of a box
MAX_SEAM = 0.01  # m, between boxes side by side that cover an edge of the floor
EDGE_DEPTH = 10.0  # m, half the depth of an edge of the floor: so deep that its other side is never nearer
MIN_FLOOR_SIDE = 0.5  # m, of a side
MIN_HALF_SIDE = 5e-4  # m, of a box
BATCH = 1024  # candidates that free_points tries at a time
OBSTACLE = (0.62, 0.64, 0.68)  # color of an obstacle that has none
FLOOR = ((0.78, 0.78, 0.76), (0.74, 0.74, 0.72))
SKY = ((0.55, 0.70, 0.88), (0.92, 0.95, 0.97))
SUN = (0.35, -0.25, 0.9)
SQUARE = 1.0  # m
LOWEST_CEILING = 1.8  # m; people are 1.73 m tall
HIGHEST_CEILING = 100.0  # m
PATTERN_OF = {"wall": "wall", "shelf": "shelf", "rack": "shelf", "facade": "facade"}
"""First word of the name of a material, or of a geom without one -> its pattern."""


class Settings(pydantic.BaseModel):
    """The keys of environment.yaml."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    name: Annotated[str, pydantic.Field(min_length=1)]
    floor: tuple[Coordinate, Coordinate, Coordinate, Coordinate]  # m: x_min, y_min, x_max, y_max
    people: Annotated[int, pydantic.Field(ge=0, le=MAX_PEOPLE)]  # default number of people
    source: str = ""
    open: bool = False  # whether people and robots may leave the floor
    ceiling: Annotated[float, pydantic.Field(ge=LOWEST_CEILING, le=HIGHEST_CEILING)] | None = None  # m; None: sky


def available() -> list[str]:
    """The environments that come with the package."""
    return sorted(path.parent.name for path in ENVS.glob(f"*/{SETTINGS}"))


def find(name_or_path: str | Path) -> Path:
    """The folder of an environment: of a name that comes with the package, or a path.

    Raises:
        InputError: there is no such environment.
    """
    names = available()
    if str(name_or_path) in names:
        return ENVS / str(name_or_path)
    folder = Path(name_or_path).expanduser()
    if (folder / SETTINGS).is_file():
        return folder
    if folder.is_dir() and (os.sep in str(name_or_path) or "/" in str(name_or_path)):
        raise InputError(f"{folder} is no environment: it holds no {SETTINGS}.")
    hint = files.suggest(str(name_or_path), names) or f"; give one of them or a folder with {SETTINGS} and {SCENE}."
    raise InputError(f"environment '{name_or_path}' is not one of {', '.join(names)}{hint}")


def sources(folder: Path) -> list[Path]:
    """The files that an environment and its scene are read from; FileError if the scene cannot be read."""
    paths = [folder / name for name in (SETTINGS, SCENE, *ANNOTATIONS)]
    return [path for path in paths if path.is_file()] + mjcf.sources(folder / SCENE)


def default_people(folder: str | Path) -> int:
    """The default number of people of an environment."""
    return _settings(Path(folder)).people


def floor(folder: str | Path) -> tuple[float, float, float, float]:
    """The floor of an environment: x_min, y_min, x_max, y_max [m]."""
    return _settings(Path(folder)).floor


def load(name_or_path: str | Path) -> Environment:
    """Load an environment by name or folder: its environment.yaml and the upright boxes of its scene.xml.

    Unless it is open, edges of the floor are obstacles too, where no other obstacles cover them.

    Raises:
        InputError: there is no such environment.
        FileError: a file cannot be used.
    """
    folder = find(name_or_path)
    settings = _settings(folder)
    return of_boxes(settings, *_boxes(folder / SCENE))


def of_boxes(settings: Settings, boxes: Float[np.ndarray, "W 6"], looks: Scenery | None = None) -> Environment:
    """The environment of boxes: center x, y, half extent x, y [m], yaw [rad], height [m]; grey without ``looks``."""
    if not settings.open:
        boxes = np.concatenate([boxes, _edges(boxes, settings.floor)])
    floor = to_device(np.array(settings.floor))
    center = boxes[:, :2]
    half_extent = boxes[:, 2:4]
    yaw, height = boxes[:, 4:].T
    obstacles = Obstacles(*to_device((center, half_extent, yaw, height)))
    if looks is None:
        looks = plain_scenery(obstacles)
    if settings.ceiling is not None:
        looks = dataclasses.replace(looks, ceiling=to_device(np.asarray(settings.ceiling)))
    return Environment(
        floor=floor,
        obstacles=obstacles,
        obstacle_grid=build_obstacle_grid(obstacles, floor),
        scenery=looks,
        name=settings.name,
        open=settings.open,
    )


def write(
    folder: Path,
    settings: Settings,
    boxes: np.ndarray,
    colors: np.ndarray | None = None,
    kinds: Sequence[str] | None = None,
) -> None:
    """Write the files of an environment without a graph to an existing folder.

    Args:
        boxes: (W, 6) center x, y, half extent x, y [m], yaw [rad], height [m].
        colors: (W, 3) from 0 to 1.
        kinds: first words of the names of the boxes, as of ``PATTERN_OF``; ``box`` if None.
    """
    x0, y0, x1, y1 = settings.floor
    middle = f"{(x0 + x1) / 2:g} {(y0 + y1) / 2:g}"
    half = f"{(x1 - x0) / 2:g} {(y1 - y0) / 2:g}"
    span = max(x1 - x0, y1 - y0)
    geoms = []
    for index, box in enumerate(boxes):
        kind = "box" if kinds is None else kinds[index]
        color = None if colors is None else colors[index]
        geoms.append(_geom(f"{kind}_{index + 1}", box, color))
    scene = "\n".join([
        '<mujoco model="map">',
        f'  <statistic center="{middle} 0" extent="{span:g}"/>',
        "  <worldbody>",
        f'    <light name="sun" directional="true" pos="{middle} {span:g}" dir="-0.35 0.25 -0.9" castshadow="false"/>',
        f'    <camera name="top" pos="{middle} {1.15 * span:g}" fovy="48"/>',
        f'    <geom name="floor" type="plane" pos="{middle} 0" size="{half} 0.1"/>',
        *geoms,
        "  </worldbody>",
        "</mujoco>",
        "",
    ])  # fmt: skip
    floor = ", ".join(f"{value:.9g}" for value in settings.floor)
    lines = [
        f"name: {json.dumps(settings.name)}",
        f"floor: [{floor}]  # m: x_min, y_min, x_max, y_max",
        f"people: {settings.people}  # default number",
        f"source: {json.dumps(settings.source)}",
    ]
    if settings.ceiling is not None:
        lines.append(f"ceiling: {settings.ceiling:g}  # m")
    (folder / SETTINGS).write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / SCENE).write_text(scene, encoding="utf-8")


def _geom(name: str, box: Sequence[float], color: Sequence[float] | None) -> str:
    """A line of MJCF: a box as in ``write``."""
    x, y, hx, hy, yaw, height = box
    half_height = height / 2
    pose = f'pos="{x:.9g} {y:.9g} {half_height:g}" size="{hx:.9g} {hy:.9g} {half_height:g}"'
    euler = f' euler="0 0 {np.rad2deg(yaw):.9g}"' if yaw else ""
    rgba = "" if color is None else f' rgba="{" ".join(f"{channel:g}" for channel in color)} 1"'
    return f'    <geom name="{name}" type="box" {pose}{euler}{rgba}/>'


def clearance(environment: Environment, points: Float[Array, "P 2"]) -> Float[Array, "P"]:
    """Distance [m] to the nearest obstacle or edge of the floor; negative inside an obstacle and off the floor."""
    return jnp.minimum(*signed_distances(environment, points))


def free_points(environment: Environment, radius: float, number: int, seed: int = 0) -> np.ndarray:
    """(number, 2) float32 m: places, uniform over where a disc of ``radius`` [m] touches no obstacle and no edge.

    Drawn on the host, outside jit. Whether a path leads from one to another is up to ``navigation``.

    Raises:
        InputError: hardly any place is free.
    """
    generator = np.random.default_rng(seed)
    floor = np.asarray(environment.floor, np.float64)
    batches: list[np.ndarray] = []
    missing = number
    tried = 0
    while missing > 0:
        places = generator.uniform(floor[:2], floor[2:], (BATCH, 2)).astype(np.float32)
        to_obstacle, to_edge = signed_distances_on_host(environment, places)
        free = places[np.minimum(to_obstacle, to_edge) >= radius]
        batches.append(free[:missing])
        missing -= len(batches[-1])
        tried += BATCH
        if tried >= 20 * BATCH and (number - missing) * 2000 < tried:
            raise InputError(
                f"environment '{environment.name}' has hardly any place where a disc of {radius:g} m is clear of "
                f"obstacles ({number - missing} of {tried} tried); use a smaller radius."
            )
    return np.concatenate([np.zeros((0, 2), np.float32), *batches])


def _settings(folder: Path) -> Settings:
    return files.load(folder / SETTINGS, Settings, _floor_problems)


def _floor_problems(settings: Settings) -> list[files.Problem]:
    x_min, y_min, x_max, y_max = settings.floor
    wide = x_max - x_min
    deep = y_max - y_min
    if not (wide >= MIN_FLOOR_SIDE and deep >= MIN_FLOOR_SIDE):
        fault = "empty" if min(wide, deep) <= 0 else f"{wide:g} by {deep:g} m, too narrow to walk on"
        return [(("floor",), f"{list(settings.floor)} is {fault}; give x_min, y_min, x_max, y_max in this order")]
    if max(wide, deep) > MAX_FLOOR_SIDE:
        return [(("floor",), f"is {wide:g} by {deep:g} m, and {MAX_FLOOR_SIDE:g} m is the longest side; cut it out")]
    return []


def _edges(boxes: np.ndarray, floor: tuple[float, ...]) -> np.ndarray:
    """(E, 6) boxes as in ``_boxes``, without height: beyond the edges of the floor that no boxes (W, 6) cover."""
    lower = np.array(floor[:2])
    upper = np.array(floor[2:])
    middle = (lower + upper) / 2
    half = (upper - lower) / 2
    edges = []
    for axis, side in ((0, -1.0), (1, -1.0), (0, 1.0), (1, 1.0)):
        out = np.eye(2)[axis] * side
        along = np.eye(2)[1 - axis]
        start = middle + half * (out - along)
        way = 2 * half[1 - axis] * along
        if _is_covered(start, way, boxes):
            continue
        center = middle + out * (half + EDGE_DEPTH)
        extent = half * along + EDGE_DEPTH * np.array([1.0, 1.0])
        edges.append([*center, *extent, 0.0, 0.0])
    return np.array(edges).reshape(-1, 6)


def _is_covered(start: Float[np.ndarray, "2"], way: Float[np.ndarray, "2"], boxes: Float[np.ndarray, "W 6"]) -> bool:
    """Whether boxes side by side cover the segment from a start along a way [m] (slab method, as for rays)."""
    yaw = boxes[:, 4]
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    half = boxes[:, 2:4] + MAX_SEAM
    dx, dy = (start - boxes[:, :2]).T

    # In the frame of each box, (W, 2).
    start = _in_frames(cosine, sine, dx, dy)
    way = _in_frames(cosine, sine, way[0], way[1])

    # The shares of the way where each box begins and ends; along a side of its frame, all or none.
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([-half - start, half - start]) / way  # (2, W, 2)
    is_along = way == 0.0
    low = np.where(np.abs(start) > half, np.inf, -np.inf)
    first = np.where(is_along, low, ends.min(0)).max(-1)
    last = np.where(is_along, -low, ends.max(0)).min(-1)

    covered = 0.0
    for index in np.argsort(first):
        if first[index] <= covered:
            covered = max(covered, last[index])
    return bool(covered >= 1.0)


def _in_frames(cosine: np.ndarray, sine: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(W, 2) vectors (x, y) in frames that are turned by angles (W,) of that cosine and sine."""
    u = cosine * x + sine * y
    v = cosine * y - sine * x
    return np.stack([u, v], -1)


def _boxes(path: Path) -> tuple[np.ndarray, Scenery]:
    """(W, 6) boxes of an MJCF file: center x, y, half extent x, y [m], yaw, height [m]; and its scenery.

    Horizontal planes are floors. Geoms that nothing can touch (contype="0" conaffinity="0") are decoration.
    """
    if not path.exists():
        raise FileError(f"{path}: there is no such file; an environment's obstacles are MJCF boxes in it.")
    model, data = _read_scene(path)
    boxes = []
    problems = []
    for index in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist():
        geom_type = mujoco.mjtGeom(model.geom_type[index])
        kind = geom_type.name.removeprefix("mjGEOM_").lower()
        if kind == "box":
            boxes.append(index)
        refusal = _refusal(model, data, index, kind)
        if refusal:
            name = model.geom(index).name
            label = f"geom '{name}'" if name else f"the unnamed geom number {index + 1}"
            problems.append(f"{label} {refusal}")
    if len(boxes) > MAX_OBSTACLES:
        problems.append(f"has {len(boxes)} boxes that can be touched; {MAX_OBSTACLES} are the most")
    if problems:
        errors = (files.file_error(path, problem) for problem in problems)
        raise FileError("\n".join(map(str, errors)))

    # The columns of the boxes.
    position = data.geom_xpos[boxes]
    half = model.geom_size[boxes]
    rotation = data.geom_xmat[boxes]
    yaw = np.arctan2(rotation[:, 3], rotation[:, 0])
    height = position[:, 2] + half[:, 2]
    rows = np.column_stack([position[:, :2], half[:, :2], yaw, height])
    return rows, scenery_from_mjcf(model, data, boxes)


def _read_scene(path: Path) -> tuple[Any, Any]:
    """The ``mujoco.MjModel`` of a file, and its ``mujoco.MjData`` with the positions of its geoms."""
    model = mjcf.read(path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def named_boxes(path: Path) -> dict[str, tuple[tuple[float, ...], tuple[float, ...], float]]:
    """Center, half sides [m] and yaw [degrees] of the obstacles of an MJCF file that have a name.

    Raises:
        FileError: MuJoCo cannot read the file.
    """
    model, data = _read_scene(path)
    boxes = {}
    for index in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX):
        name = model.geom(index).name
        if not name or not (model.geom_contype[index] or model.geom_conaffinity[index]):
            continue
        center = tuple(data.geom_xpos[index].tolist())
        half = tuple(model.geom_size[index].tolist())
        rotation = data.geom_xmat[index]
        yaw = np.arctan2(rotation[3], rotation[0])
        boxes[name] = center, half, float(np.rad2deg(yaw))
    return boxes


def _refusal(model: Any, data: Any, index: int, kind: str) -> str:
    """Why a geom cannot be an obstacle, as a clause that follows its name; empty if it can, or is the floor."""
    tilt = data.geom_xmat[index, 8]  # cosine of the angle between its z axis and the vertical
    if kind == "plane":
        if tilt > 1 - TILT_TOLERANCE:
            return ""
        return "is a tilted plane; make the wall a box"
    if kind != "box":
        return f"is a {kind}; replace it by one or more boxes"
    if model.body_weldid[model.geom_bodyid[index]] != 0:
        return "is on a body with a joint; obstacles stand still, so remove the joint"
    if abs(tilt) < 1 - TILT_TOLERANCE:
        return "is tilted; turn it about the vertical axis only"
    position = data.geom_xpos[index]
    half = model.geom_size[index]
    bottom = position[2] - half[2]
    top = position[2] + half[2]
    if np.abs(position).max() > MAX_COORDINATE or half.max() > MAX_COORDINATE:
        return f"reaches farther than {MAX_COORDINATE:g} m; give metres"
    if half.min() < MIN_HALF_SIDE:
        return f"is thinner than {2000 * MIN_HALF_SIDE:g} mm; make it thicker"
    if bottom > MAX_BOTTOM:
        return f"begins {bottom:.2f} m above the floor; extend it down to z = 0"
    if top <= 0:
        return "lies below the floor; its top must be above z = 0"
    return ""


# ------------------------------------------------------------------ scenery


def plain_scenery(obstacles: Obstacles) -> Scenery:
    """The scenery of obstacles without colors: grey boxes on the default floor, under the default sky."""
    center, extent, yaw, height = (np.asarray(field, float) for field in jax.tree.leaves(obstacles))
    half_height = 0.5 * height
    boxes = np.column_stack([center, half_height, extent, half_height, np.cos(yaw), np.sin(yaw)])
    color = np.tile((*OBSTACLE, 0.0), (len(height), 1))
    no_cylinders = np.zeros((0, 8))
    no_spheres = np.zeros((0, 4))
    return _scenery(_solids(boxes, no_cylinders, no_spheres, color))


def scenery_from_mjcf(model: Any, data: Any, obstacles: list[int]) -> Scenery:
    """The scenery of a ``mujoco.MjModel`` with its ``mujoco.MjData``; geoms of the indices ``obstacles`` come first."""
    decoration = sorted(set(range(model.ngeom)) - set(obstacles))
    solids = solids_from_mjcf(model, data, [*obstacles, *decoration])
    sky = _texture(model, "skybox")
    sky = SKY if sky is None else sky
    sun = -model.light_dir[0] if model.nlight else np.array(SUN)
    return _scenery(solids, _floor_look(model), (sky[0], sky[-1]), sun)


def solids_from_mjcf(model: Any, data: Any, geoms: list[int]) -> Solids:
    """The bodies of geoms of a ``mujoco.MjModel``, at the positions of its ``mujoco.MjData``.

    A capsule becomes a cylinder of the same extent. Geoms of other kinds and transparent geoms are left out.
    """
    kinds = mujoco.mjtGeom
    boxes = []
    cylinders = []
    spheres = []
    box_colors = []
    cylinder_colors = []
    sphere_colors = []
    for index in geoms:
        color = _color(model, index)
        if color is None:
            continue
        position = data.geom_xpos[index]
        size = model.geom_size[index]
        rotation = data.geom_xmat[index].reshape(3, 3)
        kind = kinds(int(model.geom_type[index]))
        if kind == kinds.mjGEOM_BOX:
            boxes.append([*position, *size, rotation[0, 0], rotation[1, 0]])
            box_colors.append(color)
        elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            cap = size[0] if kind == kinds.mjGEOM_CAPSULE else 0.0
            cylinders.append([*position, *rotation[:, 2], size[0], size[1] + cap])
            cylinder_colors.append(color)
        elif kind == kinds.mjGEOM_SPHERE:
            spheres.append([*position, size[0]])
            sphere_colors.append(color)
    return _solids(boxes, cylinders, spheres, [*box_colors, *cylinder_colors, *sphere_colors])


def _color(model: Any, index: int) -> list | None:
    """Color and pattern of a geom, by its material if it has one; None if it is transparent."""
    material = model.geom_matid[index]
    if material < 0:
        name = model.geom(index).name
        rgba = model.geom_rgba[index]
    else:
        name = model.mat(material).name
        rgba = model.mat_rgba[material]
    if rgba[3] < 0.5:
        return None
    pattern = PATTERN_OF.get(name.split("_")[0], "plain")
    return [*rgba[:3], PATTERNS.index(pattern)]


def _solids(boxes: ArrayLike, cylinders: ArrayLike, spheres: ArrayLike, color: ArrayLike) -> Solids:
    def table(rows: ArrayLike, columns: int) -> Array:
        return to_device(np.asarray(rows, float).reshape(-1, columns))

    return Solids(table(boxes, 8), table(cylinders, 8), table(spheres, 4), color=table(color, 4))


FloorLook = tuple[np.ndarray, float, float]  # (3, 3) colors, m side of a square, m width of a joint
PLAIN_FLOOR: FloorLook = (np.array((*FLOOR, FLOOR[0])), SQUARE, 0.0)
UNPAINTED = np.array([0.5, 0.5, 0.5, 1.0])  # the color of geoms in MJCF that give none


def _scenery(solids: Solids, floor: FloorLook = PLAIN_FLOOR, sky: ArrayLike = SKY, sun: ArrayLike = SUN) -> Scenery:
    to_sun = np.asarray(sun, float)
    to_sun = to_sun / np.linalg.norm(to_sun)
    no_ceiling = np.zeros(())
    looks = to_device((*map(np.asarray, floor), no_ceiling, np.asarray(sky), to_sun))
    return Scenery(solids, *looks)


def _floor_look(model: Any) -> FloorLook:
    """The colors of the first texture, repeated as the first plane's material says; without one the plane's color."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    plane = int(planes[0]) if len(planes) else -1
    material = int(model.geom_matid[plane]) if plane >= 0 else -1
    colors = _texture(model, "2d")
    if colors is None:
        color = UNPAINTED if plane < 0 else model.geom_rgba[plane]
        if material >= 0:
            color = model.mat_rgba[material]
        if np.allclose(color, UNPAINTED):
            return PLAIN_FLOOR
        return np.tile(color[:3], (3, 1)), SQUARE, 0.0

    # How far the texture reaches before it is repeated.
    period = 2 * SQUARE
    if material >= 0:
        repeats = model.mat_texrepeat[material, 0]
        half_side = model.geom_size[plane, 0]
        if model.mat_texuniform[material]:
            period = 1 / repeats
        elif half_side > 0:
            period = 2 * half_side / repeats

    # Two squares to a period, and joints where the texture has a mark along its edges.
    square = period / 2
    darkest, lightest = colors
    joint, width = _edge(model)
    if joint is None:
        return np.array([darkest, lightest, lightest]), square, 0.0
    return np.array([darkest, lightest, joint]), square, 2 * period / width


def _edge(model: Any) -> tuple[np.ndarray | None, int]:
    """(3,) the color of the first texture's mark along its edges, if it has one; and the texture's width in pixels."""
    pixels = _pixels(model, "2d")
    assert pixels is not None
    border = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
    color = border[0]
    is_mark = (border == color).all() and (pixels[1:-1, 1:-1] != color).any()
    width = pixels.shape[1]
    if not is_mark:
        return None, width
    return color / 255, width


def _texture(model: Any, kind: str) -> np.ndarray | None:
    """(n, 3) colors of the first texture of a kind: a floor's darkest and lightest, or a sky from its top down."""
    pixels = _pixels(model, kind)
    if pixels is None:
        return None
    if kind == "skybox":
        return pixels[:, pixels.shape[1] // 2] / 255.0
    inner = pixels[1:-1, 1:-1] if min(pixels.shape[:2]) > 2 else pixels  # without a mark along the edges
    shades = inner.reshape(-1, 3)
    light = shades.sum(-1, dtype=np.int32)
    return shades[[light.argmin(), light.argmax()]] / 255


def _pixels(model: Any, kind: str) -> np.ndarray | None:
    """(H, W, 3) pixels from 0 to 255 of the first texture of a kind."""
    texture = {"2d": mujoco.mjtTexture.mjTEXTURE_2D, "skybox": mujoco.mjtTexture.mjTEXTURE_SKYBOX}[kind]
    indices = np.flatnonzero(model.tex_type == texture)
    if len(indices) == 0:
        return None
    index = indices[0]
    channels = model.tex_nchannel[index]
    shape = model.tex_height[index], model.tex_width[index], channels
    start = model.tex_adr[index]
    pixels = model.tex_data[start : start + np.prod(shape)].reshape(shape)
    if channels < 3:  # grey
        return np.repeat(pixels[:, :, :1], 3, axis=-1)
    return pixels[:, :, :3]
