"""Sensors as values (section IV-F), and the readings of all of them at once.

A ``data_types.Sensor`` is a pure function with its parameters. ``SENSORS`` are every robot's. ``depth_sensor``,
``color_sensor`` and ``lidar_sensor`` make others from a camera or a lidar; ``sensor_settings.as_sensor`` also reads
YAML files.
"""

import dataclasses
import zlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from sean_jax.core import user_calls
from sean_jax.core.data_types import Array, RobotModel, Scenario, Sensor, State
from sean_jax.sensors.cameras import Camera, camera, depth
from sean_jax.sensors.lidars import VLP16, VLP16_DEVIATION, Lidar, lidar, scan
from sean_jax.sensors.pictures import render
from sean_jax.sensors.sensor_noise import DistanceErrors, distance_errors, drop_outs, noise


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
        for array in jax.tree.leaves(reading) or [None]:
            user_calls.check_array("sensors", sensor.read, array, None, None, "give the reading")
        readings[sensor.name] = reading
    return readings
