"""Physical environments (section IV-C): a folder's files become obstacles on a floor, with places to stand on it."""

import os
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
import pydantic

from sean_jax import files
from sean_jax.base import Array, Environment, Obstacles, Scenery
from sean_jax.files import mjcf
from sean_jax.geometry import room, room_on_host
from sean_jax.nearby import tabulate
from sean_jax.platforms import put
from sean_jax.quantities import FARTHEST, LARGEST_FLOOR, MOST_OBSTACLES, MOST_PEOPLE, Coordinate
from sean_jax.scenery import appearance

HERE = Path(__file__).resolve().parent
# Beside the package in a checkout, inside it once installed.
ENVS: Path = next((path for path in (HERE / "envs", HERE.parent / "envs") if path.is_dir()), HERE / "envs")

SETTINGS, SCENE = "environment.yaml", "scene.xml"
UPRIGHT = 1e-4  # how far from 1 the cosine of a box's tilt may be
LOWEST = 0.05  # m above the floor, to which a box must reach down
SEAM = 0.01  # m, between boxes side by side that cover an edge of the floor
DEPTH = 10.0  # m, half of how deep an edge of the floor is: nobody gets so far in that its other side is nearer
LEAST_FLOOR = 0.5  # m, of a side
THINNEST = 5e-4  # m, of half the side of a box
BATCH = 1024  # candidates that free_points looks at in one go


class Settings(pydantic.BaseModel):
    """What environment.yaml holds."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    name: Annotated[str, pydantic.Field(min_length=1)]
    floor: tuple[Coordinate, Coordinate, Coordinate, Coordinate]  # m: x_min, y_min, x_max, y_max
    people: Annotated[int, pydantic.Field(ge=0, le=MOST_PEOPLE)]  # unless told otherwise
    source: str = ""
    open: bool = False  # whether people and robots may leave the floor


def available() -> list[str]:
    """Names of the environments that come with the package."""
    return sorted(path.parent.name for path in ENVS.glob(f"*/{SETTINGS}"))


def find(name_or_path: str | Path) -> Path:
    """Folder of an environment that comes with the package, or of any other by its path; ValueError if none."""
    names = available()
    if str(name_or_path) in names:
        return ENVS / str(name_or_path)
    folder = Path(name_or_path).expanduser()
    if (folder / SETTINGS).is_file():
        return folder
    if folder.is_dir() and (os.sep in str(name_or_path) or "/" in str(name_or_path)):
        raise ValueError(f"{folder} is no environment: it holds no {SETTINGS}.")
    hint = files.suggest(str(name_or_path), names) or f"; give one of them or a folder with {SETTINGS} and {SCENE}."
    raise ValueError(f"environment '{name_or_path}' is not one of {', '.join(names)}{hint}")


def default_people(folder: str | Path) -> int:
    """How many people an environment has unless told otherwise."""
    return _settings(Path(folder)).people


def floor(folder: str | Path) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max [m] of an environment's floor."""
    return _settings(Path(folder)).floor


def load(name_or_path: str | Path) -> Environment:
    """The environment of that name or folder: environment.yaml and the upright boxes of scene.xml.

    Unless it is open, the edges of the floor are obstacles as well, but for those that obstacles cover anyway.

    Raises ValueError for an unknown name and FileError for files that cannot be used.
    """
    folder = find(name_or_path)
    settings = _settings(folder)
    boxes, looks = _boxes(folder / SCENE)
    if not settings.open:
        boxes = np.concatenate([boxes, _edges(boxes, settings.floor)])
    floor = put(np.array(settings.floor))
    obstacles = Obstacles(*put((boxes[:, :2], boxes[:, 2:4], *boxes[:, 4:].T)))
    return Environment(
        floor=floor,
        obstacles=obstacles,
        nearby=tabulate(obstacles, floor),
        scenery=looks,
        name=settings.name,
        open=settings.open,
    )


def clearance(environment: Environment, points: Array) -> Array:
    """(P,) distance [m] from each of the points (P, 2) [m] to the nearest obstacle or edge of the floor.

    Negative inside an obstacle and off the floor.
    """
    return jnp.minimum(*room(environment, points))


def free_points(environment: Environment, radius: float, number: int, seed: int = 0) -> np.ndarray:
    """(number, 2) float32 places [m], uniform over where a disc of that radius [m] touches no obstacle or edge.

    Drawn on the host, outside jit; the same seed gives the same places. Whether one can walk from one to another
    is for navigation to say. Raises ValueError if (almost) no place is free.
    """
    generator = np.random.default_rng(seed)
    floor = np.asarray(environment.floor, np.float64)
    found: list[np.ndarray] = []
    missing, tried = number, 0
    while missing > 0:
        places = generator.uniform(floor[:2], floor[2:], (BATCH, 2)).astype(np.float32)
        free = places[np.minimum(*room_on_host(environment, places)) >= radius]
        found.append(free[:missing])
        missing -= len(found[-1])
        tried += BATCH
        if tried >= 20 * BATCH and (number - missing) * 2000 < tried:
            raise ValueError(
                f"environment '{environment.name}' has hardly any place where a disc of {radius:g} m is clear of "
                f"obstacles ({number - missing} of {tried} tried); use a smaller radius."
            )
    return np.concatenate([np.zeros((0, 2), np.float32), *found])


def _settings(folder: Path) -> Settings:
    return files.load(folder / SETTINGS, Settings, _floor_problems)


def _floor_problems(settings: Settings) -> list[files.Problem]:
    x_min, y_min, x_max, y_max = settings.floor
    wide, deep = x_max - x_min, y_max - y_min
    if not (wide >= LEAST_FLOOR and deep >= LEAST_FLOOR):
        why = "empty" if min(wide, deep) <= 0 else f"{wide:g} by {deep:g} m, too narrow to walk on"
        return [(("floor",), f"{list(settings.floor)} is {why}; give x_min, y_min, x_max, y_max in this order")]
    if max(wide, deep) > LARGEST_FLOOR:
        return [(("floor",), f"is {wide:g} by {deep:g} m, and {LARGEST_FLOOR:g} m is the longest side; cut it out")]
    return []


def _edges(boxes: np.ndarray, floor: tuple[float, ...]) -> np.ndarray:
    """(E, 6), as ``_boxes`` has them, of no height: what lies beyond edges of the floor that no boxes (W, 6) cover."""
    lower, upper = np.array(floor[:2]), np.array(floor[2:])
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    cosine, sine = np.cos(boxes[:, 4]), np.sin(boxes[:, 4])
    found = []
    for axis, side in ((0, -1.0), (1, -1.0), (0, 1.0), (1, 1.0)):
        out, along = np.eye(2)[axis] * side, np.eye(2)[1 - axis]
        begin = middle + half * (out - along) - boxes[:, :2]  # one end of the edge, from each box
        begin, way = (
            np.stack([cosine * x + sine * y, cosine * y - sine * x], -1)
            for x, y in (begin.T, 2 * half[1 - axis] * along[:, None])
        )
        with np.errstate(divide="ignore", invalid="ignore"):  # of the way along the edge, where a box begins and ends
            ends = (np.array([[[-1.0]], [[1.0]]]) * (boxes[:, 2:4] + SEAM) - begin) / way
        beside = (way == 0.0) & (np.abs(begin) > boxes[:, 2:4] + SEAM)
        first = np.where(way == 0.0, np.where(beside, np.inf, -np.inf), ends.min(0)).max(-1)
        last = np.where(way == 0.0, np.where(beside, -np.inf, np.inf), ends.max(0)).min(-1)
        covered = 0.0
        for number in np.argsort(first):
            if first[number] <= covered:
                covered = max(covered, last[number])
        if covered < 1.0:
            found.append([*(middle + out * (half + DEPTH)), *(half * along + DEPTH * np.array([1.0, 1.0])), 0.0, 0.0])
    return np.array(found).reshape(-1, 6)


def _boxes(path: Path) -> tuple[np.ndarray, Scenery]:
    """(W, 6) the boxes of an MJCF file, and what it looks like: center x, y, half extent x, y [m], yaw, height [m].

    Horizontal planes are floors; geoms that nothing can touch are decoration.

    MJCF makes decoration of a geom by contype="0" conaffinity="0".
    """
    if not path.exists():
        raise files.FileError(f"{path}: there is no such file; an environment's obstacles are MJCF boxes in it.")
    model = mjcf.read(path)
    mujoco: Any = import_module("mujoco")  # late, for it takes time; Any, for it has no type stubs
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    kind = [mujoco.mjtGeom(number).name.removeprefix("mjGEOM_").lower() for number in model.geom_type]
    solid = [index for index in range(model.ngeom) if model.geom_contype[index] or model.geom_conaffinity[index]]
    clauses = {index: _refusal(model, data, index, kind[index]) for index in solid}
    lines = [f"{files.shown(path)}: {_called(model, index)} {text}." for index, text in clauses.items() if text]
    boxes = [index for index in solid if kind[index] == "box"]
    if len(boxes) > MOST_OBSTACLES:
        lines.append(f"{files.shown(path)}: has {len(boxes)} boxes that can be touched; {MOST_OBSTACLES} are the most.")
    if lines:
        raise files.FileError("\n".join(lines))
    position, half, turn = data.geom_xpos[boxes], model.geom_size[boxes], data.geom_xmat[boxes]
    yaw, height = np.arctan2(turn[:, 3], turn[:, 0]), position[:, 2] + half[:, 2]
    return np.column_stack([position[:, :2], half[:, :2], yaw, height]), appearance(model, data, boxes)


def _called(model: Any, index: int) -> str:
    name = model.geom(index).name
    return f"geom '{name}'" if name else f"the unnamed geom number {index + 1}"


def _refusal(model: Any, data: Any, index: int, kind: str) -> str:
    """Why a geom cannot be an obstacle, in words that follow its name; empty if it can, or is the floor."""
    tilt = data.geom_xmat[index, 8]  # cosine of the angle between its z axis and the vertical
    if kind == "plane":
        return "" if tilt > 1 - UPRIGHT else "is a tilted plane; make the wall a box"
    if kind != "box":
        return f"is a {kind}; replace it by one or more boxes"
    if model.body_weldid[model.geom_bodyid[index]] != 0:
        return "is on a body with a joint; obstacles stand still, so remove the joint"
    if abs(tilt) < 1 - UPRIGHT:
        return "is tilted; turn it about the vertical axis only"
    bottom, top = data.geom_xpos[index, 2] + model.geom_size[index, 2] * np.array([-1.0, 1.0])
    if np.abs(data.geom_xpos[index]).max() > FARTHEST or model.geom_size[index].max() > FARTHEST:
        return f"reaches farther than {FARTHEST:g} m; give metres"
    if model.geom_size[index].min() < THINNEST:
        return f"is thinner than {2000 * THINNEST:g} mm; make it thicker"
    if bottom > LOWEST:
        return f"begins {bottom:.2f} m above the floor; extend it down to z = 0"
    if top <= 0:
        return "lies below the floor; its top must be above z = 0"
    return ""
