"""Sensors (section IV-F): depth, color from three views, and lidars, on every robot, all from the same rays."""

from sean_jax.sensors.cameras import Camera, camera, depth, focal_length, pixels_of_people
from sean_jax.sensors.lidars import VLP16, Lidar, lidar, point_cloud, points, scan
from sean_jax.sensors.pictures import CLASSES, Picture, render
from sean_jax.sensors.readings import SENSORS, color_sensor, depth_sensor, lidar_sensor, sense
from sean_jax.sensors.sensor_delays import Delay, delay, due, push
from sean_jax.sensors.sensor_noise import DistanceErrors, distance_errors, drop_outs, noise
from sean_jax.sensors.sensor_settings import SensorLike, as_sensor, as_sensors, check_sensor

CAMERAS = ("depth", "first_person", "third_person", "overhead")
"""The cameras that every robot has."""

__all__ = [
    "CAMERAS",
    "CLASSES",
    "SENSORS",
    "VLP16",
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
    "point_cloud",
    "points",
    "push",
    "render",
    "scan",
    "sense",
]
