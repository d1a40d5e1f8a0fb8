"""Sensors (section IV-F): depth, color from three views, and a lidar, on every robot, all from the same rays."""

from sean_jax.sensors.cameras import Camera, camera, focal_length
from sean_jax.sensors.depth_images import depth
from sean_jax.sensors.imperfections import Delay, delay, drop_outs, due, noise, push
from sean_jax.sensors.lidars import Lidar, lidar, scan
from sean_jax.sensors.pictures import CLASSES, Picture, render
from sean_jax.sensors.suite import (
    SENSORS,
    DistanceErrors,
    SensorLike,
    as_sensor,
    as_sensors,
    check_sensor,
    color_sensor,
    depth_sensor,
    distance_errors,
    lidar_sensor,
    sense,
)
from sean_jax.sensors.visibility import pixels_of_people

CAMERAS = ("depth", "first_person", "third_person", "overhead")
"""The cameras that every robot has."""

__all__ = [
    "CAMERAS",
    "CLASSES",
    "SENSORS",
    "Camera",
    "Delay",
    "DistanceErrors",
    "Lidar",
    "Picture",
    "SensorLike",
    "as_sensor",
    "as_sensors",
    "check_sensor",
    "camera",
    "color_sensor",
    "delay",
    "depth",
    "depth_sensor",
    "distance_errors",
    "drop_outs",
    "due",
    "focal_length",
    "lidar",
    "lidar_sensor",
    "noise",
    "pixels_of_people",
    "push",
    "render",
    "scan",
    "sense",
]
