"""Sensors as values (section IV-F), the readings of all of them at once, and the errors of real sensors.

A ``data_types.Sensor`` is a pure function with its parameters. ``SENSORS`` are every robot's. ``depth_sensor``,
``color_sensor`` and ``lidar_sensor`` make others from a camera or a lidar. ``as_sensor`` also reads YAML files. Noise,
drop-outs, delays and rates are functions of images and scans of any shape.
"""

import dataclasses
import itertools
import math
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from flax import struct
from jaxtyping import Bool, Float, Int, Shaped

from sean_jax.core import clock, user_calls
from sean_jax.core.data_types import Array, RobotModel, Scenario, Sensor, State
from sean_jax.core.devices import to_device
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.sensors.cameras import Camera, camera, depth
from sean_jax.sensors.lidars import VLP16, VLP16_DEVIATION, Lidar, lidar, scan
from sean_jax.sensors.pictures import render

SensorLike = Sensor | str | Path
"""Any form of a sensor: a ``Sensor``, a name in ``SENSORS``, or a YAML file."""

MAX_PIXELS = 8192  # of a side
MAX_RAYS = 100_000
MAX_RINGS = 256


@struct.dataclass
class DistanceErrors:
    """The errors of a sensor that measures distances. All fields are leaves."""

    min_deviation: Float[Array, ""]  # m, of ``sensors.noise``
    growth: Float[Array, ""]  # 1/m, of ``sensors.noise``
    drop_out: Float[Array, ""]  # share of the rays that miss, from 0 to 1


def distance_errors(min_deviation: float = 0.0012, growth: float = 0.0019, drop_out: float = 0.0) -> DistanceErrors:
    """Errors of a depth camera, or with ``growth=0`` of a lidar; the arguments are the fields of ``DistanceErrors``."""
    return DistanceErrors(*to_device((min_deviation, growth, drop_out)))


@dataclasses.dataclass(frozen=True)
class _Distances:
    """``Sensor.read`` of a device that measures distances; equal for equal devices, so nothing is compiled again."""

    device: Camera | Lidar
    measure: Callable[[Scenario, State, Any], Array]

    def __call__(self, scenario: Scenario, params: DistanceErrors | tuple, state: State, key: Array) -> Array:
        distance = self.measure(scenario, state, self.device)
        errors = params if isinstance(params, DistanceErrors) else scenario.sensor_errors
        if errors is None:
            return distance
        noise_key, drop_key = jax.random.split(key)
        far = self.device.far
        distance = noise(noise_key, distance, far=far, min_deviation=errors.min_deviation, growth=errors.growth)
        return drop_outs(drop_key, distance, errors.drop_out, far)


@dataclasses.dataclass(frozen=True)
class _Color:
    """``Sensor.read`` of a color camera; equal for equal cameras."""

    device: Camera

    def __call__(self, scenario: Scenario, params: tuple, state: State, key: Array) -> Array:
        return render(scenario, state, self.device).rgb


def depth_sensor(device: Camera, errors: DistanceErrors | None = None, name: str | None = None) -> Sensor:
    """A depth camera, whose reading is (H, W) m; without errors it has the scenario's, without a name the camera's."""
    return Sensor(() if errors is None else errors, name or device.name, _Distances(device, depth))


def lidar_sensor(device: Lidar, errors: DistanceErrors | None = None, name: str = "lidar") -> Sensor:
    """A lidar, whose reading is that of ``scan``, with the scenario's errors if it has none."""
    return Sensor(() if errors is None else errors, name, _Distances(device, scan))


def color_sensor(device: Camera, name: str | None = None) -> Sensor:
    """A color camera, whose reading is (H, W, 3) from 0 to 1; the reading has the camera's name by default."""
    return Sensor((), name or device.name, _Color(device))


def _depth(robot: RobotModel) -> Sensor:
    """The robot's depth camera."""
    return depth_sensor(camera(robot, "depth"))


def _first_person(robot: RobotModel) -> Sensor:
    """The robot's color camera that looks ahead."""
    return color_sensor(camera(robot, "first_person"))


def _third_person(robot: RobotModel) -> Sensor:
    """The robot's color camera that looks at it from behind."""
    return color_sensor(camera(robot, "third_person"))


def _overhead(robot: RobotModel) -> Sensor:
    """The robot's color camera that looks at it from above."""
    return color_sensor(camera(robot, "overhead"))


def _lidar(robot: RobotModel) -> Sensor:
    """The robot's lidar."""
    return lidar_sensor(lidar(robot))


def _vlp16(robot: RobotModel) -> Sensor:
    """A Velodyne VLP-16, with its noise, in place of the robot's lidar."""
    return lidar_sensor(lidar(robot, **VLP16), distance_errors(VLP16_DEVIATION, growth=0.0), "vlp16")


SENSORS: dict[str, Callable[[RobotModel], Sensor]] = {
    "depth": _depth,
    "first_person": _first_person,
    "third_person": _third_person,
    "overhead": _overhead,
    "lidar": _lidar,
    "vlp16": _vlp16,
}


def sense(scenario: Scenario, state: State) -> dict[str, Any]:
    """The readings of all sensors of a scenario by name.

    Noise depends on the episode, the tick and the name of the sensor alone. So equal states give equal readings, and
    another sensor does not change them.
    """
    key = jax.random.fold_in(state.streams.sensors, state.tick)
    readings = {}
    for sensor in scenario.sensors:
        sensor_key = jax.random.fold_in(key, np.uint32(zlib.crc32(sensor.name.encode())))
        arguments = scenario, sensor.params, state, sensor_key
        reading = user_calls.call("sensors", sensor.read, "scenario, params, state, key", *arguments)
        for part in jax.tree.leaves(reading) or [None]:
            user_calls.check_array("sensors", sensor.read, part, None, None, "give the reading")
        readings[sensor.name] = reading
    return readings


class Errors(pydantic.BaseModel):
    """Errors of distances in a sensor's file; they have the fields of ``DistanceErrors``."""

    model_config = pydantic.ConfigDict(extra="forbid", allow_inf_nan=False)

    min_deviation: Annotated[float, pydantic.Field(ge=0, le=10)] = 0.0012  # m
    growth: Annotated[float, pydantic.Field(ge=0, le=10)] = 0.0019  # 1/m
    drop_out: Annotated[float, pydantic.Field(ge=0, le=1)] = 0.0


class Settings(pydantic.BaseModel):
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
    errors: Errors | None = None


CAMERA_KEYS = ("mount", "width", "height", "fovy", "orthographic")
LIDAR_KEYS = ("count", "first", "span", "elevations")
MOUNTS = {"depth": "depth", "color": "first_person"}


def as_sensor(value: SensorLike, robot: RobotModel) -> Sensor:
    """The ``Sensor`` of a ``Sensor``, of a name in ``SENSORS``, or of a YAML file with the keys of ``Settings``.

    Raises:
        InputError: there is no sensor of that name, the file cannot be used, or the robot has no such mount.
    """
    if isinstance(value, Sensor):
        return value
    check_sensor(value)
    if isinstance(value, str) and value in SENSORS:
        return SENSORS[value](robot)
    path = Path(value)
    return _from_settings(files.load(path, Settings, _problems), robot)


def check_sensor(value: SensorLike) -> None:
    """Refuse a value that is no sensor, as far as can be decided without a robot.

    Raises:
        InputError: there is no sensor of that name, or it is no name, path or ``Sensor``.
    """
    cure = f"; give one of {', '.join(SENSORS)} or the path of a .yaml file."
    if not isinstance(value, str | Path | Sensor):
        raise InputError(f"sensors: {getattr(value, '__name__', None) or repr(value):.60} is no Sensor{cure}")
    if isinstance(value, str | Path) and value not in SENSORS and Path(value).suffix not in (".yaml", ".yml"):
        raise InputError(f"sensors: '{value}' is no sensor{files.suggest(str(value), SENSORS) or cure}")


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


def _problems(settings: Settings) -> list[files.Problem]:
    foreign = CAMERA_KEYS if settings.kind == "lidar" else LIDAR_KEYS
    keys = settings.model_fields_set
    problems: list[files.Problem] = [
        ((key,), f"is no key of the kind '{settings.kind}'; remove it") for key in foreign if key in keys
    ]
    if any(below >= above for below, above in itertools.pairwise(settings.elevations)):
        problems.append((("elevations",), "do not ascend; begin with the lowest ring"))
    if settings.count * len(settings.elevations) > MAX_RAYS:
        problems.append((("elevations",), f"and count give more than {MAX_RAYS:,} rays; give fewer"))
    if settings.kind == "color" and settings.errors is not None:
        problems.append((("errors",), "are errors of distances, which the kind 'color' does not measure; remove them"))
    return problems


def _from_settings(settings: Settings, robot: RobotModel) -> Sensor:
    errors = None if settings.errors is None else distance_errors(**settings.errors.model_dump())
    others = {"kind", "name", "mount", "errors"}
    fields: dict[str, Any] = settings.model_dump(exclude=others, exclude_unset=True, exclude_none=True)
    if settings.kind == "lidar":
        fields |= {key: math.radians(fields[key]) for key in ("first", "span") if key in fields}
        fields["elevations"] = [math.radians(angle) for angle in settings.elevations]
        return lidar_sensor(lidar(robot, **fields), errors, settings.name or "lidar")
    device = camera(robot, settings.mount or MOUNTS[settings.kind], **fields)
    if settings.kind == "depth":
        return depth_sensor(device, errors, settings.name)
    return color_sensor(device, settings.name)


# --- errors of real sensors ---


def noise(
    key: Array,
    distance: Float[Array, "*shape"],
    *,
    far: Float[Array, ""] | float,
    min_deviation: Float[Array, ""] | float = 0.0012,
    growth: Float[Array, ""] | float = 0.0019,
    start: Float[Array, ""] | float = 0.4,
) -> Float[Array, "*shape"]:
    """Add normal noise whose standard deviation is min_deviation + growth (distance - start)².

    The result is clipped to 0 and ``far``.

    Args:
        far: m, the range of the sensor. Values at or beyond it are misses and stay as they are.
        min_deviation: m, standard deviation at ``start``.
        growth: 1/m; 0 suits a lidar.
        start: m, where the growth begins.

    Source:
        C. V. Nguyen, S. Izadi & D. Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking",
        3DIMPVT 2012; the defaults are theirs, for a depth camera.
    """
    deviation = min_deviation + growth * jnp.square(distance - start)
    noisy = distance + deviation * jax.random.normal(key, distance.shape, distance.dtype)
    return jnp.where(distance < far, jnp.clip(noisy, 0.0, far), distance)


def drop_outs(
    key: Array,
    distance: Float[Array, "*shape"],
    share: Float[Array, ""] | float,
    replacement: Float[Array, ""] | float,
) -> Float[Array, "*shape"]:
    """Set a random share of the distances to a replacement [m], such as the sensor's ``far``: these rays miss."""
    return jnp.where(jax.random.uniform(key, distance.shape) < share, replacement, distance)


@struct.dataclass
class Delay:
    """The last images of a sensor, the newest first. Callers carry it beside the state."""

    images: Shaped[Array, "L *shape"]  # the robot has received the last one


def delay(image: Shaped[Array, "*shape"], steps: int) -> Delay:
    """A delay line of some control steps, filled with the first image.

    Raises:
        InputError: ``steps`` is negative.
    """
    if steps < 0:
        raise InputError(f"delay: {steps} steps would show the future; give 0 or more.")
    return Delay(jnp.broadcast_to(image[None], (steps + 1, *image.shape)))


def push(line: Delay, image: Shaped[Array, "*shape"]) -> tuple[Delay, Shaped[Array, "*shape"]]:
    """Put the newest image into a delay line; the new line and the image that leaves it."""
    images = jnp.concatenate([image[None], line.images[:-1]])
    return Delay(images), images[-1]


def due(tick: Int[Array, ""], time_step: float, rate: float) -> Bool[Array, ""]:
    """Whether a sensor with a rate [1/s] takes an image at a tick of control of ``time_step`` [s].

    The first tick is 0. An image that is due between two ticks is taken at the second. A sensor that is faster than
    control, such as one of 15 Hz with steps of 0.1 s, takes one image at each tick.

    Raises:
        InputError: the rate is too low to be counted in ticks.
    """
    over, under = clock.events_per_tick(time_step, rate)
    now = tick % under  # the pattern repeats after that many ticks
    return (tick == 0) | (now * over // under > (now - 1) * over // under)
