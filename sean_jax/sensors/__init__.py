"""Sensors (section IV-F): depth, color from three views, and a lidar, on every robot, all from the same rays."""

from sean_jax.sensors.cameras import Camera, camera, focal_length
from sean_jax.sensors.depths import depth
from sean_jax.sensors.imperfections import Delay, delay, drop_outs, due, noise, push
from sean_jax.sensors.lidars import Lidar, lidar, scan
from sean_jax.sensors.pictures import CLASSES, Picture, render

CAMERAS = ("depth", "first_person", "third_person", "overhead")
"""the cameras that every robot has"""

__all__ = [
    "CAMERAS", "CLASSES", "Camera", "Delay", "Lidar", "Picture", "camera", "delay", "depth", "drop_outs", "due",
    "focal_length", "lidar", "noise", "push", "render", "scan",
]  # fmt: skip
