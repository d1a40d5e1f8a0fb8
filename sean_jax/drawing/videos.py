"""Videos of a camera of the robot along an episode, as looping GIFs (section IV-F).

The sensors' own rays draw them on any machine. MuJoCo draws them with OpenGL, which needs a graphics driver and has
smooth shadows. Both show the same bodies from the same place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import files
from sean_jax.base import Array, Pedestrians, Robot, Scenario, State, Trajectory
from sean_jax.drawing import gifs, gl_scene, parts
from sean_jax.errors import InputError
from sean_jax.sensors import Camera, camera, depth, render

SUPERSAMPLING = 2  # times as many pixels each way are drawn and averaged, for smooth edges
WIDTH, HEIGHT = 320, 240  # pixels, of a camera that is given by its name


def video(
    frames: Trajectory,
    scenario: Scenario,
    path: gifs.Target,
    *,
    view: str | Camera = "first_person",
    renderer: str = "rays",
    rate: float = 5.0,
    speed: float = 4.0,
) -> None:
    """Write what a camera sees along one episode as a GIF.

    Args:
        frames: (T, ...) of one episode.
        path: where to write, a path or a binary file.
        view: name of a camera, for pictures of 320 x 240 pixels, or a camera of ``sensors.camera``. Depth is shown
            in colors, blue near and red far.
        renderer: ``rays`` or ``mujoco``, see ``RENDERERS``.
        rate: pictures a second.

    Raises:
        InputError: frames with a batch axis, an unknown camera or renderer, no OpenGL for MuJoCo, or a path that
            cannot be written.
    """
    from PIL import Image

    gifs.check(path)
    eye = camera(scenario, view, width=WIDTH, height=HEIGHT) if isinstance(view, str) else view
    check_renderer(renderer)
    if not (rate > 0 and speed > 0):
        raise InputError(f"rate, speed: {rate:g} pictures a second, {speed:g} times as fast, show nothing; give more.")
    frames = parts.one_episode(frames)
    every = max(1, round(speed / rate / scenario.time_step))
    steps = [*range(0, len(frames.active) - 1, every), len(frames.active) - 1]
    each = RENDERERS[renderer](jax.tree.map(lambda leaf: leaf[steps], frames), scenario, eye)
    pictures = [Image.fromarray(picture) for picture in each]
    gifs.save(path, len(pictures), pictures.__getitem__, every * scenario.time_step / speed)


def by_rays(frames: Trajectory, scenario: Scenario, eye: Camera) -> Iterator[np.ndarray]:
    """Draw frames by the sensors' rays.

    Args:
        frames: (T, ...) of one episode.

    Yields:
        (H, W, 3) uint8 for each frame.
    """
    fine = eye.resized(SUPERSAMPLING * eye.width, SUPERSAMPLING * eye.height)

    @jax.jit
    def picture(frame: Trajectory) -> Array:
        state = _state(frame)
        if eye.name == "depth":
            return depth(scenario, state, eye)
        rgb = render(scenario, state, fine).rgb
        return rgb.reshape(eye.height, SUPERSAMPLING, eye.width, SUPERSAMPLING, 3).mean((1, 3))

    for t in range(len(frames.active)):
        image = np.asarray(picture(jax.tree.map(lambda leaf, t=t: jnp.asarray(leaf[t]), frames)))
        yield depth_colors(image, eye.far) if eye.name == "depth" else (255 * image + 0.5).astype(np.uint8)


def by_mujoco(frames: Trajectory, scenario: Scenario, eye: Camera) -> Iterator[np.ndarray]:
    """Draw frames by MuJoCo with OpenGL.

    Args:
        frames: (T, ...) of one episode.

    Returns:
        An iterator of (H, W, 3) uint8 for each frame.
    """
    if eye.name == "depth":
        return (depth_colors(image, eye.far) for image in gl_scene.depths(frames, scenario, eye))
    return gl_scene.images(frames, scenario, eye)


RENDERERS: dict[str, Callable[[Trajectory, Scenario, Camera], Iterator[np.ndarray]]] = {
    "rays": by_rays,
    "mujoco": by_mujoco,
}


def check_renderer(renderer: str) -> None:
    """Check that a renderer works here; for ``mujoco`` that takes a moment.

    Raises:
        InputError: there is no such renderer, or no OpenGL for ``mujoco``.
    """
    if renderer not in RENDERERS:
        raise InputError(files.unknown_name("renderer", renderer, RENDERERS))
    if renderer == "mujoco":
        gl_scene.check()


def depth_colors(image: np.ndarray, far: float) -> np.ndarray:
    """Depths as colors: blue near, red far, dark grey where nothing is nearer than ``far``.

    Args:
        image: (H, W) m.
        far: m.

    Returns:
        (H, W, 3) uint8.
    """
    from matplotlib import colormaps

    shades = colormaps["turbo"](np.sqrt(np.clip(image / far, 0.0, 1.0)))[..., :3]
    return (255 * np.where(image[..., None] < far, shades, 0.2) + 0.5).astype(np.uint8)


def _state(frame: Trajectory) -> State:
    """The parts of a state that a camera needs."""
    nothing: Any = None
    people = Pedestrians(
        position=frame.people,
        velocity=frame.people_velocity,
        heading=frame.people_heading,
        desired_velocity=frame.people_velocity,
        group=frame.group,
        walking_group=nothing,
        present=frame.present,
        preferred_speed=nothing,
        robot_distance=nothing,
    )
    robot = Robot(frame.position, frame.heading, nothing, nothing, nothing)
    return State(
        streams=nothing,
        tick=nothing,
        pedestrians=people,
        groups=nothing,
        robot=robot,
        task=nothing,
        memory=nothing,
        situations=frame.situations,
        metrics=nothing,
        ticks_at_goal=nothing,
        completed=nothing,
        timed_out=nothing,
    )
