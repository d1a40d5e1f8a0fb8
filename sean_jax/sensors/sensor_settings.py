"""Settings of sensors: names and YAML files as ``Sensor`` values, and the sentences that refuse others."""

import itertools
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from sean_jax.core.data_types import RobotModel, Sensor
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.sensors.cameras import camera
from sean_jax.sensors.lidars import lidar
from sean_jax.sensors.readings import SENSORS, color_sensor, depth_sensor, lidar_sensor
from sean_jax.sensors.sensor_noise import distance_errors

SensorLike = Sensor | str | Path
"""Any form of a sensor: a ``Sensor``, a name in ``SENSORS``, or a YAML file."""

MAX_PIXELS = 8192  # of a side
MAX_RAYS = 100_000
MAX_RINGS = 256


class ErrorSettings(pydantic.BaseModel):
    """Errors of distances in a sensor's file; they have the fields of ``DistanceErrors``."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    min_deviation: Annotated[float, pydantic.Field(ge=0, le=10)] = 0.0012  # m
    growth: Annotated[float, pydantic.Field(ge=0, le=10)] = 0.0019  # 1/m
    drop_out: Annotated[float, pydantic.Field(ge=0, le=1)] = 0.0


class SensorSettings(pydantic.BaseModel):
    """A sensor's file. Missing keys have the defaults of ``sensors.camera`` and ``sensors.lidar``."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    kind: Literal["depth", "color", "lidar"]
    name: Annotated[str, pydantic.Field(min_length=1, max_length=100)] | None = None  # of the reading
    mount: str | None = None  # the camera in the robot's file; by default the kind's
    width: Annotated[int, pydantic.Field(ge=1, le=MAX_PIXELS)] = 640  # pixels
    height: Annotated[int, pydantic.Field(ge=1, le=MAX_PIXELS)] = 480  # pixels
    fovy: Annotated[float, pydantic.Field(gt=0, lt=180)] | None = None  # degrees
    near: Annotated[float, pydantic.Field(ge=0, le=1e4)] | None = None  # m
    far: Annotated[float, pydantic.Field(gt=0, le=1e4)] | None = None  # m
    orthographic: Annotated[float, pydantic.Field(ge=0, le=1e4)] | None = None  # m
    count: Annotated[int, pydantic.Field(ge=1, le=MAX_RAYS)] = 360  # rays
    first: Annotated[float, pydantic.Field(ge=-360, le=360)] = 0.0  # degrees
    span: Annotated[float, pydantic.Field(gt=0, le=360)] = 360.0  # degrees
    elevations: Annotated[
        list[Annotated[float, pydantic.Field(gt=-90, lt=90)]], pydantic.Field(max_length=MAX_RINGS)
    ] = []  # degrees
    errors: ErrorSettings | None = None


CAMERA_KEYS = ("mount", "width", "height", "fovy", "orthographic")
LIDAR_KEYS = ("count", "first", "span", "elevations")
MOUNTS = {"depth": "depth", "color": "first_person"}


def as_sensor(value: SensorLike, robot: RobotModel) -> Sensor:
    """The ``Sensor`` of a ``Sensor``, of a name in ``SENSORS``, or of a YAML file with the keys of ``SensorSettings``.

    Raises:
        InputError: there is no sensor of that name, the file cannot be used, or the robot has no such mount.
    """
    if isinstance(value, Sensor):
        return value
    check_sensor(value)
    if isinstance(value, str) and value in SENSORS:
        return SENSORS[value](robot)
    path = Path(value)
    return _from_settings(files.load(path, SensorSettings, _problems), robot)


def check_sensor(value: SensorLike) -> None:
    """Refuse a value that is no sensor, as far as can be decided without a robot.

    Raises:
        InputError: there is no sensor of that name, or it is no name, path or ``Sensor``.
    """
    names = ", ".join(SENSORS)
    if not isinstance(value, str | Path | Sensor):
        name = getattr(value, "__name__", None) or repr(value)
        raise InputError(f"sensors: {name:.60} is no Sensor; give one of {names} or the path of a .yaml file.")
    if isinstance(value, Sensor) or value in SENSORS or Path(value).suffix in (".yaml", ".yml"):
        return
    suggestion = files.suggest(str(value), SENSORS)
    if suggestion:
        raise InputError(f"sensors: '{value}' is no sensor{suggestion}")
    raise InputError(f"sensors: '{value}' is no sensor; give one of {names} or the path of a .yaml file.")


def as_sensors(values: Iterable[SensorLike], robot: RobotModel) -> tuple[Sensor, ...]:
    """The sensors of several values, for ``Scenario.sensors``.

    Raises:
        InputError: one of them is refused by ``as_sensor``, or two have one name.
    """
    sensors = tuple(as_sensor(value, robot) for value in values)
    names = [sensor.name for sensor in sensors]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"sensors: {names.count(name)} have the name '{name}'; give each a name of its own.")
    return sensors


def _problems(settings: SensorSettings) -> list[files.Problem]:
    problems: list[files.Problem] = []
    for key in CAMERA_KEYS if settings.kind == "lidar" else LIDAR_KEYS:
        if key in settings.model_fields_set:
            problems.append(((key,), f"is no key of the kind '{settings.kind}'; remove it"))
    if any(below >= above for below, above in itertools.pairwise(settings.elevations)):
        problems.append((("elevations",), "do not ascend; begin with the lowest ring"))
    if settings.count * len(settings.elevations) > MAX_RAYS:
        problems.append((("elevations",), f"and count give more than {MAX_RAYS:,} rays; give fewer"))
    if settings.kind == "color" and settings.errors is not None:
        problems.append((("errors",), "are errors of distances, which the kind 'color' does not measure; remove them"))
    return problems


def _from_settings(settings: SensorSettings, robot: RobotModel) -> Sensor:
    errors = None if settings.errors is None else distance_errors(**settings.errors.model_dump())
    without = {"kind", "name", "mount", "errors"}
    arguments: dict[str, Any] = settings.model_dump(exclude=without, exclude_unset=True, exclude_none=True)
    if settings.kind == "lidar":
        for key in ("first", "span"):
            if key in arguments:
                arguments[key] = math.radians(arguments[key])
        arguments["elevations"] = [math.radians(angle) for angle in settings.elevations]
        return lidar_sensor(lidar(robot, **arguments), errors, settings.name or "lidar")

    device = camera(robot, settings.mount or MOUNTS[settings.kind], **arguments)
    if settings.kind == "depth":
        return depth_sensor(device, errors, settings.name)
    return color_sensor(device, settings.name)
