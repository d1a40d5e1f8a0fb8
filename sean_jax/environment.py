"""Physical environments (section IV-C): the files of a folder as obstacles on a floor, and free places on it."""

import os
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
import pydantic
from jaxtyping import Float

from sean_jax import files, obstacle_grid
from sean_jax.base import Array, Environment, Obstacles, Scenery
from sean_jax.errors import FileError, InputError
from sean_jax.files import mjcf
from sean_jax.geometry import signed_distances, signed_distances_on_host
from sean_jax.platforms import to_device
from sean_jax.quantities import MAX_COORDINATE, MAX_FLOOR_SIDE, MAX_OBSTACLES, MAX_PEOPLE, Coordinate
from sean_jax.scenery import scenery_from_mjcf

HERE = Path(__file__).resolve().parent
# Beside the package in a checkout, inside it once installed.
ENVS: Path = next((path for path in (HERE / "envs", HERE.parent / "envs") if path.is_dir()), HERE / "envs")

SETTINGS, SCENE = "environment.yaml", "scene.xml"
ANNOTATIONS = "graph.yaml", "handcrafted.yaml"  # which some behaviors read
TILT_TOLERANCE = 1e-4  # how far from 1 the cosine of a box's tilt may be
MAX_BOTTOM = 0.05  # m above the floor, for the bottom of a box
MAX_SEAM = 0.01  # m, between boxes side by side that cover an edge of the floor
EDGE_DEPTH = 10.0  # m, half the depth of an edge of the floor: so deep that its other side is never nearer
MIN_FLOOR_SIDE = 0.5  # m, of a side
MIN_HALF_SIDE = 5e-4  # m, of a box
BATCH = 1024  # candidates that free_points tries at a time


class Settings(pydantic.BaseModel):
    """The keys of environment.yaml."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    name: Annotated[str, pydantic.Field(min_length=1)]
    floor: tuple[Coordinate, Coordinate, Coordinate, Coordinate]  # m: x_min, y_min, x_max, y_max
    people: Annotated[int, pydantic.Field(ge=0, le=MAX_PEOPLE)]  # default number of people
    source: str = ""
    open: bool = False  # whether people and robots may leave the floor


def available() -> list[str]:
    """The environments that come with the package."""
    return sorted(path.parent.name for path in ENVS.glob(f"*/{SETTINGS}"))


def find(name_or_path: str | Path) -> Path:
    """The folder of an environment.

    Args:
        name_or_path: name of one that comes with the package, or the path of any other.

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
    """The files that an environment is read from.

    Returns:
        Their paths; those that the scene reads are among them.

    Raises:
        FileError: the scene cannot be read.
    """
    own = [folder / name for name in (SETTINGS, SCENE, *ANNOTATIONS)]
    return [path for path in own if path.is_file()] + mjcf.sources(folder / SCENE)


def default_people(folder: str | Path) -> int:
    """The default number of people of an environment."""
    return _settings(Path(folder)).people


def floor(folder: str | Path) -> tuple[float, float, float, float]:
    """The floor of an environment.

    Returns:
        x_min, y_min, x_max, y_max [m].
    """
    return _settings(Path(folder)).floor


def load(name_or_path: str | Path) -> Environment:
    """Load an environment: its environment.yaml and the upright boxes of its scene.xml.

    Unless it is open, the edges of the floor are obstacles as well, but for those that obstacles cover anyway.

    Args:
        name_or_path: name of one that comes with the package, or the folder of any other.

    Returns:
        The environment on the default device.

    Raises:
        InputError: there is no such environment.
        FileError: a file cannot be used.
    """
    folder = find(name_or_path)
    settings = _settings(folder)
    boxes, looks = _boxes(folder / SCENE)
    if not settings.open:
        boxes = np.concatenate([boxes, _edges(boxes, settings.floor)])
    floor = to_device(np.array(settings.floor))
    obstacles = Obstacles(*to_device((boxes[:, :2], boxes[:, 2:4], *boxes[:, 4:].T)))
    return Environment(
        floor=floor,
        obstacles=obstacles,
        obstacle_grid=obstacle_grid.build(obstacles, floor),
        scenery=looks,
        name=settings.name,
        open=settings.open,
    )


def clearance(environment: Environment, points: Float[Array, "P 2"]) -> Float[Array, "P"]:
    """Distance to the nearest obstacle or edge of the floor.

    Args:
        points: (P, 2) m.

    Returns:
        (P,) m, negative inside an obstacle and off the floor.
    """
    return jnp.minimum(*signed_distances(environment, points))


def free_points(environment: Environment, radius: float, number: int, seed: int = 0) -> np.ndarray:
    """Draw places, uniform over where a disc touches no obstacle and no edge of the floor.

    They are drawn on the host, outside jit. Whether a path leads from one to another is for navigation to tell.

    Args:
        radius: m, of the disc.
        seed: the same one gives the same places.

    Returns:
        (number, 2) float32 m.

    Raises:
        InputError: hardly any place is free.
    """
    generator = np.random.default_rng(seed)
    floor = np.asarray(environment.floor, np.float64)
    batches: list[np.ndarray] = []
    missing, tried = number, 0
    while missing > 0:
        places = generator.uniform(floor[:2], floor[2:], (BATCH, 2)).astype(np.float32)
        free = places[np.minimum(*signed_distances_on_host(environment, places)) >= radius]
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
    wide, deep = x_max - x_min, y_max - y_min
    if not (wide >= MIN_FLOOR_SIDE and deep >= MIN_FLOOR_SIDE):
        why = "empty" if min(wide, deep) <= 0 else f"{wide:g} by {deep:g} m, too narrow to walk on"
        return [(("floor",), f"{list(settings.floor)} is {why}; give x_min, y_min, x_max, y_max in this order")]
    if max(wide, deep) > MAX_FLOOR_SIDE:
        return [(("floor",), f"is {wide:g} by {deep:g} m, and {MAX_FLOOR_SIDE:g} m is the longest side; cut it out")]
    return []


def _edges(boxes: np.ndarray, floor: tuple[float, ...]) -> np.ndarray:
    """(E, 6) boxes as of ``_boxes``, without height: beyond the edges of the floor that no boxes (W, 6) cover."""
    lower, upper = np.array(floor[:2]), np.array(floor[2:])
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    cosine, sine = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    edges = []
    for axis, side in ((0, -1.0), (1, -1.0), (0, 1.0), (1, 1.0)):
        out, along = np.eye(2)[axis] * side, np.eye(2)[1 - axis]
        begin = middle + half * (out - along) - boxes[:, :2]  # one end of the edge, from each box
        begin, way = (
            np.stack([cosine * x + sine * y, cosine * y - sine * x], -1)
            for x, y in (begin.T, 2 * half[1 - axis] * along[:, None])
        )
        with np.errstate(divide="ignore", invalid="ignore"):  # of the way along the edge, where a box begins and ends
            ends = (np.array([[[-1.0]], [[1.0]]]) * (boxes[:, 2:4] + MAX_SEAM) - begin) / way
        beside = (way == 0.0) & (np.abs(begin) > boxes[:, 2:4] + MAX_SEAM)
        first = np.where(way == 0.0, np.where(beside, np.inf, -np.inf), ends.min(0)).max(-1)
        last = np.where(way == 0.0, np.where(beside, -np.inf, np.inf), ends.max(0)).min(-1)
        covered = 0.0
        for number in np.argsort(first):
            if first[number] <= covered:
                covered = max(covered, last[number])
        if covered < 1.0:
            center, extent = middle + out * (half + EDGE_DEPTH), half * along + EDGE_DEPTH * np.array([1.0, 1.0])
            edges.append([*center, *extent, 0.0, 0.0])
    return np.array(edges).reshape(-1, 6)


def _boxes(path: Path) -> tuple[np.ndarray, Scenery]:
    """(W, 6) boxes of an MJCF file: center x, y, half extent x, y [m], yaw, height [m]; and its scenery.

    Horizontal planes are floors. Geoms that nothing can touch (contype="0" conaffinity="0") are decoration.
    """
    if not path.exists():
        raise FileError(f"{path}: there is no such file; an environment's obstacles are MJCF boxes in it.")
    model = mjcf.read(path)
    mujoco: Any = import_module("mujoco")  # late, for it takes time; Any, for it has no type stubs
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    kind = [mujoco.mjtGeom(number).name.removeprefix("mjGEOM_").lower() for number in model.geom_type]
    solid = [index for index in range(model.ngeom) if model.geom_contype[index] or model.geom_conaffinity[index]]
    clauses = {index: _refusal(model, data, index, kind[index]) for index in solid}
    lines = [f"{files.short_name(path)}: {_geom_name(model, index)} {text}." for index, text in clauses.items() if text]
    boxes = [index for index in solid if kind[index] == "box"]
    if len(boxes) > MAX_OBSTACLES:
        what = f"has {len(boxes)} boxes that can be touched; {MAX_OBSTACLES} are the most"
        lines.append(f"{files.short_name(path)}: {what}.")
    if lines:
        raise FileError("\n".join(lines))
    position, half, turn = data.geom_xpos[boxes], model.geom_size[boxes], data.geom_xmat[boxes]
    yaw, height = np.arctan2(turn[:, 3], turn[:, 0]), position[:, 2] + half[:, 2]
    return np.column_stack([position[:, :2], half[:, :2], yaw, height]), scenery_from_mjcf(model, data, boxes)


def _geom_name(model: Any, index: int) -> str:
    name = model.geom(index).name
    return f"geom '{name}'" if name else f"the unnamed geom number {index + 1}"


def _refusal(model: Any, data: Any, index: int, kind: str) -> str:
    """Why a geom cannot be an obstacle, as a clause that follows its name; empty if it can, or is the floor."""
    tilt = data.geom_xmat[index, 8]  # cosine of the angle between its z axis and the vertical
    if kind == "plane":
        return "" if tilt > 1 - TILT_TOLERANCE else "is a tilted plane; make the wall a box"
    if kind != "box":
        return f"is a {kind}; replace it by one or more boxes"
    if model.body_weldid[model.geom_bodyid[index]] != 0:
        return "is on a body with a joint; obstacles stand still, so remove the joint"
    if abs(tilt) < 1 - TILT_TOLERANCE:
        return "is tilted; turn it about the vertical axis only"
    bottom, top = data.geom_xpos[index, 2] + model.geom_size[index, 2] * np.array([-1.0, 1.0])
    if np.abs(data.geom_xpos[index]).max() > MAX_COORDINATE or model.geom_size[index].max() > MAX_COORDINATE:
        return f"reaches farther than {MAX_COORDINATE:g} m; give metres"
    if model.geom_size[index].min() < MIN_HALF_SIDE:
        return f"is thinner than {2000 * MIN_HALF_SIDE:g} mm; make it thicker"
    if bottom > MAX_BOTTOM:
        return f"begins {bottom:.2f} m above the floor; extend it down to z = 0"
    if top <= 0:
        return "lies below the floor; its top must be above z = 0"
    return ""
