"""Robots of other projects, from MJCF with a freejoint or URDF: a planar base, its wheels, limits and mounts.

Wheels are hinges about a horizontal axis with something round on them that touches the floor. From their places
follows the drive. All other links are part of the base as they are at rest. The result is a robot file of this package
(``robots.description``).
"""

import dataclasses
import re
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.sax.saxutils import quoteattr

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import robots
from sean_jax.core.data_types import Obstacles
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.messages import suggest
from sean_jax.io import writing
from sean_jax.io.files import read_text, short_name
from sean_jax.io.files.meshes import MAX_MESH
from sean_jax.robots import foreign_links, urdf_reading
from sean_jax.robots.foreign_links import Body, Link, Shape

STEP = 0.02  # s, of the physics
FRICTION = 0.8  # rubber on an indoor floor
GRIP = FRICTION * 9.81  # m/s2, the most acceleration that tyres give
TIMEOUT = 0.25  # s, after which a robot without a new command stops
RESERVE = 1.15  # force of the servos over that of the greatest acceleration
RESPONSE = 0.06  # s, in which the servos of an omnidirectional base change its speed
LEVEL = 0.1  # maximum vertical component of a wheel's axis
PARALLEL = 0.95  # cosine
ON_FLOOR = 0.01  # m, or this share of the radius: how far above the lowest wheel others may begin
ROUND_SHARE = 0.15
LIDAR, CAMERA = (
    re.compile(r"lidar|laser|scan|velodyne|hokuyo|\blds|sick_?lms", re.I),
    re.compile(r"camera|kinect|realsense|depth", re.I),
)
CASTER, ROLLER, OMNI = re.compile(r"cast[eo]r", re.I), re.compile(r"roller", re.I), re.compile(r"mecanum|omni", re.I)
AHEAD = 0.7  # cosine: a camera with a smaller one looks elsewhere
SPARE = re.compile(r"steering_?wheel$", re.I)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Numbers that a file lacks, or in place of those that it has. None: of the file."""

    drive: str | None = None
    wheels: tuple[str, ...] = ()  # joints, left and right
    wheel_radius: float | None = None  # m
    wheel_separation: float | None = None  # m
    mass: float | None = None  # kg
    radius: float | None = None  # m
    max_speed: float | None = None  # m/s
    max_turn_rate: float | None = None  # rad/s
    max_acceleration: float | None = None  # m/s2


@dataclasses.dataclass
class Wheel:
    """A wheel on the floor."""

    link: int
    name: str  # of its joint
    place: np.ndarray  # (3,) m, its middle
    axis: np.ndarray  # (3,)
    radius: float | None  # m; None: it has no shape
    width: float  # m, half of it
    steered: int | None  # the link above it that turns about the vertical


@dataclasses.dataclass
class Result:
    """An imported robot."""

    path: Path
    drive: str
    numbers: list[tuple[str, str, str]]  # name, value with unit, and where it is from
    shapes: list[Shape]  # in the robot's frame: x ahead, from the floor
    radius: float  # m
    notes: list[str]
    gap: float  # m, between MJX and its closed form at the end of a short drive
    lag: float  # m, to the same drive without inertia


def import_robot(file: Path, out: Path, settings: Settings = Settings()) -> Result:
    """Write a robot file for ``robots.load`` from the MJCF or URDF file of another project.

    Raises:
        InputError: the file is no robot with wheels, or lacks numbers; the sentence names the options that give them.
    """
    body = _read(file)
    base = _Base(file, body, settings)
    text = base.mjcf(out.stem)
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / out.name
        trial.write_text(text, encoding="utf-8")
        try:
            gap, lag = drive_briefly(trial, base.drive)
        except FileError as error:
            text = str(error).replace(str(trial), str(file)).replace(short_name(trial), short_name(file))
            raise FileError(text) from None
    with writing.atomic_file(out) as stream:
        stream.write(text.encode())
    return Result(out, base.drive, base.numbers, base.shapes, base.radius, base.notes, gap, lag)


def _read(file: Path) -> Body:
    """The links of a file, by its root element."""
    start = read_text(file, MAX_MESH)
    return (
        foreign_links.from_mjcf(file)
        if re.search(r"<mujoco[\s>]", start) and "<robot" not in start
        else urdf_reading.read(file)
    )


def drive_briefly(path: Path, drive: str) -> tuple[float, float]:
    """Drive a robot for 3 s, ahead and then in a curve, on an empty floor.

    Returns:
        m, how far MJX ends from the closed form, and from the robot without inertia.
    """
    models = [robots.load(path, dynamics) for dynamics in ("mjx", "twin", "kinematic")]
    real = jnp.result_type(float)
    pairs, numbers = jnp.zeros((0, 2), real), jnp.zeros(0, real)
    nobody = SimpleNamespace(position=pairs, velocity=pairs, present=jnp.zeros(0, bool))
    ends = []
    for model in models:
        speed, turn = 0.5 * model.max_speed, 0.25 * model.max_turn_rate
        still = jnp.zeros_like(speed)
        aside = [still] if drive == "omnidirectional" else []  # of a command ahead, to the left, turn rate
        straight, curve = jnp.stack([speed, *aside, still]), jnp.stack([speed, *aside, turn])
        commands = jnp.stack([straight] * 15 + [curve] * 15)
        scenario: Any = SimpleNamespace(
            environment=SimpleNamespace(obstacles=Obstacles(pairs, pairs, numbers, numbers)),
            robot=model,
            time_step=0.1,
            forces=SimpleNamespace(walking=SimpleNamespace(radius=jnp.asarray(0.3, real))),
        )

        def advance(robot: Any, command: Any, scenario: Any = scenario, model: Any = model) -> tuple[Any, None]:
            state: Any = SimpleNamespace(robot=robot, pedestrians=nobody)
            return model.drive(scenario, state, command), None

        start = model.place(model, jnp.zeros(2, real), jnp.asarray([1.0, 0.0], real))
        end = jax.jit(lambda start, commands, advance=advance: jax.lax.scan(advance, start, commands)[0])(
            start, commands
        )
        ends.append(np.asarray(end.position, float))
    return float(np.linalg.norm(ends[0] - ends[1])), float(np.linalg.norm(ends[0] - ends[2]))


# --- wheels ---


def find_wheels(file: Path, body: Body, settings: Settings) -> list[Wheel]:
    """The wheels of a robot that may be driven, without casters and rollers.

    Raises:
        InputError: a joint of ``settings.wheels`` does not exist.
    """
    wheels = [wheel for index in range(len(body.links)) if (wheel := _wheel(body, index)) is not None]
    if settings.wheels:
        joints = {link.joint: index for index, link in enumerate(body.links) if link.kind == "hinge"}
        for name in settings.wheels:
            if name not in joints:
                cure = suggest(name, joints) or f"; its hinges are {', '.join(joints) or 'none'}."
                raise InputError(f"--wheels: {file} has no hinge '{name}'{cure}")
        return [_as_wheel(body, joints[name]) for name in settings.wheels]
    bottoms = [wheel.place[2] - wheel.radius for wheel in wheels if wheel.radius is not None]
    floor = min(bottoms, default=0.0)
    wheels = [
        wheel
        for wheel in wheels
        if wheel.radius is None or wheel.place[2] - wheel.radius <= floor + max(ON_FLOOR, ROUND_SHARE * wheel.radius)
    ]
    if any(body.links[wheel.link].driven for wheel in wheels):
        wheels = [wheel for wheel in wheels if body.links[wheel.link].driven]
    return wheels


def _wheel(body: Body, index: int) -> Wheel | None:
    """The wheel of a link, if it looks like one."""
    link = body.links[index]
    if link.kind != "hinge" or abs(link.axis[2]) > LEVEL or SPARE.search(link.joint):
        return None
    names = [
        name
        for number in [index, *_above(body, index)][:-1]
        for name in (body.links[number].name, body.links[number].joint)
    ]
    if any(CASTER.search(name) or ROLLER.search(name) for name in names):
        return None
    wheel = _as_wheel(body, index)
    named = "wheel" in (link.name + link.joint).lower()
    return wheel if named or wheel.radius is not None else None


def _as_wheel(body: Body, index: int) -> Wheel:
    link = body.links[index]
    radius, width, middle = None, 0.02, link.place
    for shape in _rigid_shapes(body, index):
        size = _round(shape, link)
        if size is not None and (radius is None or size[0] > radius):
            radius, width, middle = *size, shape.place
    along = float((middle - link.place) @ link.axis)
    steered = next(
        (n for n in _above(body, index) if body.links[n].kind == "hinge" and abs(body.links[n].axis[2]) > 0.9), None
    )
    return Wheel(index, link.joint, link.place + along * link.axis, link.axis, radius, width, steered)


def _above(body: Body, index: int) -> list[int]:
    """The links above a link, up to the root."""
    chain = []
    while (index := body.links[index].parent) >= 0:
        chain.append(index)
    return chain


def _rigid_shapes(body: Body, index: int) -> list[Shape]:
    """The shapes of a link and of all links that are fixed to it."""
    below = [n for n, link in enumerate(body.links) if link.parent == index and link.kind == "fixed"]
    return body.links[index].shapes + [shape for n in below for shape in _rigid_shapes(body, n)]


def _round(shape: Shape, link: Link) -> tuple[float, float] | None:
    """Radius and half the width [m] of a shape that is round about the axis of a link."""
    offset = shape.place - link.place
    aside = float(np.linalg.norm(offset - (offset @ link.axis) * link.axis))
    if shape.kind == "sphere":
        radius = width = float(shape.size[0])
    elif shape.kind == "cylinder" and abs(shape.turn[:, 2] @ link.axis) > PARALLEL:
        radius, width = map(float, shape.size)
    elif shape.kind == "box":
        axis = int(np.argmax(np.abs(shape.turn.T @ link.axis)))
        others = np.delete(shape.size, axis)
        radius, width = float(others.max()), float(shape.size[axis])
        if others.min() < (1.0 - ROUND_SHARE) * radius or abs(shape.turn[:, axis] @ link.axis) < PARALLEL:
            return None
    else:
        return None
    return (radius, width) if aside <= ROUND_SHARE * radius else None


def drive_of(file: Path, body: Body, wheels: list[Wheel], settings: Settings) -> str:
    """The drive by the wheels: ``differential``, ``omnidirectional`` or ``ackermann``.

    Raises:
        FileError: no drive has such wheels.
    """
    if settings.drive is not None:
        return settings.drive
    fixed = [wheel for wheel in wheels if wheel.steered is None]
    steered = [wheel for wheel in wheels if wheel.steered is not None]
    parallel = all(abs(wheel.axis @ fixed[0].axis) > PARALLEL for wheel in fixed)
    rollers = any(ROLLER.search(link.name + link.joint) for link in body.links)
    names = [body.name, *(wheel.name for wheel in wheels)]
    if wheels and (
        rollers or not parallel or any(OMNI.search(name) for name in names) or (len(steered) > 1 and not fixed)
    ):
        return "omnidirectional"
    if len(fixed) >= 2 and steered:
        return "ackermann"
    if len(fixed) >= 2:
        return "differential"
    what = f"only '{wheels[0].name}' of its hinges looks" if wheels else "none of its hinges looks"
    cure = "name the hinges of the left and the right wheel by --wheels, or give --drive omnidirectional"
    raise FileError(f"{file}: {what} like a wheel on the floor; {cure}.")


# --- the base: one rigid body with wheels ---


class _Base:
    """The planar base of a robot: its shapes, numbers and file."""

    def __init__(self, file: Path, body: Body, settings: Settings):
        self.file, self.body, self.settings = file, body, settings
        self.wheels = find_wheels(file, body, settings)
        self.drive = drive_of(file, body, self.wheels, settings)
        self.numbers: list[tuple[str, str, str]] = []
        self.notes: list[str] = []
        self.missing: list[str] = []
        self.fixed = [wheel for wheel in self.wheels if wheel.steered is None]
        self._place()
        self._measure()
        if self.missing:
            options = _listed(sorted(self.missing))
            raise FileError(f"{file}: it does not say all that a robot needs; give {options}.")
        if body.missing:
            self.notes.append(
                f"without the shapes of meshes that are missing or cannot be read: {', '.join(body.missing)}"
            )

    def _place(self) -> None:
        """Find the robot's frame, and transform all links to it."""
        body, settings = self.body, self.settings
        shapes = [shape for link in body.links for shape in link.shapes]
        radii = [wheel.radius for wheel in self.fixed or self.wheels if wheel.radius is not None]
        self.wheel_radius = settings.wheel_radius or (float(np.mean(radii)) if radii else None)
        if self.wheels and self.wheel_radius is None:
            self.missing.append("--wheel-radius")
        ahead = np.array([1.0, 0.0, 0.0])
        if self.drive != "omnidirectional":
            x, y, _ = self.fixed[0].axis if self.fixed else (0.0, 1.0, 0.0)
            ahead = np.array([y, -x, 0.0]) / np.hypot(x, y)
            ahead = ahead if ahead[0] > 1e-6 or (abs(ahead[0]) <= 1e-6 and ahead[1] > 0.0) else -ahead
        turn = np.stack([ahead, [-ahead[1], ahead[0], 0.0], [0.0, 0.0, 1.0]])  # from the root link to the robot
        origin = np.mean([wheel.place for wheel in self.fixed or self.wheels], 0) if self.wheels else np.zeros(3)
        if self.wheels:
            origin = origin - [0.0, 0.0, self.wheel_radius or 0.0]
        elif shapes:
            origin = np.array([0.0, 0.0, min(outline(shape)[:, 2].min() for shape in shapes)])
        for link in body.links:
            link.place, link.center = turn @ (link.place - origin), turn @ (link.center - origin)
            link.turn, link.axis, link.inertia = turn @ link.turn, turn @ link.axis, turn @ link.inertia @ turn.T
        for shape in shapes:
            shape.place, shape.turn = turn @ (shape.place - origin), turn @ shape.turn
        for wheel in self.wheels:
            wheel.place, wheel.axis = turn @ (wheel.place - origin), turn @ wheel.axis
        for mounts in (body.cameras, body.frames):
            mounts[:] = [(name, turn @ (place - origin), turn @ axes) for name, place, axes in mounts]
        if self.drive == "differential":
            sides = [
                np.mean([w.place for w in self.fixed if s * w.place[1] > 0.0] or [[np.nan] * 3], 0) for s in (1, -1)
            ]
            if not np.isfinite(sides).all():
                joints = _listed([wheel.name for wheel in self.fixed])
                raise FileError(
                    f"{self.file}: all wheels ({joints}) are on one side; name a left and a right one by --wheels."
                )

    def _shift(self, ahead: float) -> None:
        """Move the robot's origin ahead [m]."""
        by = np.array([ahead, 0.0, 0.0])
        for link in self.body.links:
            link.place, link.center = link.place - by, link.center - by
            for shape in link.shapes:
                shape.place = shape.place - by
        for wheel in self.wheels:
            wheel.place = wheel.place - by
        for mounts in (self.body.cameras, self.body.frames):
            mounts[:] = [(name, place - by, axes) for name, place, axes in mounts]

    def _measure(self) -> None:
        """Compute the numbers of the robot, from the file or the options."""
        body, settings = self.body, self.settings
        self._add(
            "drive", self.drive, "--drive" if settings.drive else f"wheels {_listed([w.name for w in self.wheels])}"
        )
        mass = sum(link.mass for link in body.links)
        self.mass = self._number("mass", settings.mass, mass, "kg", "inertials", "--mass")
        center = sum((link.mass * link.center for link in body.links), np.zeros(3)) / (mass or 1.0)
        self.center_height = float(np.clip(center[2], 0.01, 10.0)) if mass else 0.1
        if self.drive == "ackermann":
            self._axles(float(center[0]))
            center[0] = 0.0
        if mass and np.hypot(*center[:2]) > 0.01:
            x, y = center[:2]
            self.notes.append(
                f"the center of mass lies {x:+.3f} m ahead and {y:+.3f} m left of the origin and is taken as above it"
            )
        self.shapes = [upright(shape) for link in body.links for shape in link.shapes]
        points = np.concatenate([outline(shape) for shape in self.shapes] or [np.zeros((0, 3))])
        far = float(np.hypot(points[:, 0], points[:, 1]).max()) if len(points) else 0.0
        rigid = [shape for index in (0, *(wheel.link for wheel in self.wheels)) for shape in _rigid_shapes(body, index)]
        corners = np.concatenate([outline(shape) for shape in rigid] or [points])
        reach = float(np.hypot(corners[:, 0], corners[:, 1]).max()) if len(corners) else 0.0
        if far > reach + 0.01 and settings.radius is None:
            self.notes.append(f"links that move reach {far:.3g} m from the origin, beyond the radius")
        self.top = float(corners[:, 2].max()) if len(corners) else 0.3
        self.front = float(corners[:, 0].max()) if len(corners) else 0.1
        self.radius = self._number("radius", settings.radius, reach, "m", "outline of base and wheels", "--radius")
        own = sum(
            (link.inertia[2, 2] + link.mass * float(link.center[:2] @ link.center[:2]) for link in body.links), 0.0
        )
        scale = self.mass / mass if mass else 0.0
        self.inertia = own * scale or 0.5 * self.mass * self.radius**2
        if self.wheels:
            radius = self.wheel_radius or 0.0
            self._add("wheel radius", f"{radius:.4g} m", "--wheel-radius" if settings.wheel_radius else "shapes")
        self._limits()

    def _axles(self, center: float) -> None:
        """Wheelbase, place of the rear axle and steering of a car, whose origin moves to the center of mass."""
        steered = [wheel for wheel in self.wheels if wheel.steered is not None]
        if not steered or not self.fixed:
            what = "a car has steered and other wheels, and this robot lacks one kind"
            raise FileError(f"{self.file}: {what}; choose another --drive.")
        self.wheelbase = float(np.mean([wheel.place[0] for wheel in steered]))
        if self.wheelbase <= 0.0:
            raise FileError(f"{self.file}: its steered wheels lie behind the others; a car steers at its front axle.")
        joints = [self.body.links[wheel.steered] for wheel in steered if wheel.steered is not None]
        angles, rates = ([getattr(joint, key) for joint in joints] for key in ("max_angle", "max_rate"))
        for values, key in ((angles, "range (lower and upper)"), (rates, "greatest velocity")):
            if any(value is None for value in values):
                raise FileError(
                    f"{self.file}: joint '{joints[0].joint}' steers, but has no {key}; add it to its <limit>."
                )
        self.max_angle, self.max_rate = min(min(angles), 1.5), min(min(rates), 100.0)
        self._shift(float(np.clip(center, 0.0, 0.9 * self.wheelbase)))
        self._add("wheelbase", f"{self.wheelbase:.4g} m", "joints")
        self._add(
            "steering", f"{np.rad2deg(self.max_angle):.3g} degrees, {self.max_rate:.3g} rad/s", "limit of the joint"
        )

    def _limits(self) -> None:
        """Speeds and accelerations."""
        settings, body = self.settings, self.body
        radius = self.wheel_radius or (1.0 if self.wheels else 0.0)  # one that is missing is refused later
        driven = [body.links[wheel.link] for wheel in self.fixed or self.wheels]
        rates = [link.max_rate for link in driven if link.max_rate is not None]
        torques = [link.max_torque for link in driven if link.max_torque is not None]
        rim = min(rates) * radius if rates else 0.0
        self.max_speed = self._number(
            "max speed", settings.max_speed, rim, "m/s", "velocity of the wheels", "--max-speed"
        )
        self.armature = 0.5 * self.mass * radius**2
        force = sum(torques) / radius if radius else 0.0
        self.max_acceleration = self._number(
            "max acceleration", settings.max_acceleration, min(force / (self.mass or 1.0), GRIP), "m/s2",
            "effort of the wheels, at most the grip", "--max-acceleration"
        )  # fmt: skip
        rim = rim or self.max_speed
        if self.drive == "differential":
            left, right = (np.mean([w.place[1] for w in self.fixed if s * w.place[1] > 0.0]) for s in (1, -1))
            self.track = self.settings.wheel_separation or float(left - right)
            source = "--wheel-separation" if self.settings.wheel_separation else "joints"
            self._add("wheel separation", f"{self.track:.4g} m", source)
            lever = self.track / 2
        else:
            places = [np.hypot(*wheel.place[:2]) for wheel in self.wheels]
            lever = float(np.mean(places)) if places else 0.0
        if self.drive != "ackermann" and (self.max_speed or not lever):
            turn = rim / lever if lever else 0.0
            source = "of the wheels at their distance" if lever else "at the radius"
            self.max_turn_rate = self._number(
                "max turn rate", settings.max_turn_rate, min(turn, 100.0), "rad/s", f"speed {source}", "--max-turn-rate"
            )
            self.max_turn_acceleration = min(self.max_acceleration / (lever or self.radius or 1.0), 1e4)
            self._add(
                "max turn acceleration",
                f"{self.max_turn_acceleration:.4g} rad/s2",
                f"acceleration {source}",
            )

    def _number(self, name: str, given: float | None, own: float, unit: str, source: str, option: str) -> float:
        value = given if given is not None else own
        if not value > 0.0:
            self.missing.append(option)
            return 0.0
        self._add(name, f"{value:.4g} {unit}", option if given is not None else source)
        return float(value)

    def _add(self, name: str, value: str, source: str) -> None:
        self.numbers.append((name, value, source))

    # --- the file ---

    def mjcf(self, name: str) -> str:
        """The robot file."""
        numerics = {"max_speed": self.max_speed, "max_acceleration": self.max_acceleration}
        if self.drive == "omnidirectional":
            numerics |= {"max_lateral_speed": self.max_speed, "max_lateral_acceleration": self.max_acceleration}
        if self.drive == "ackermann":
            numerics |= {
                "wheelbase": self.wheelbase,
                "max_steering_angle": self.max_angle,
                "max_steering_rate": self.max_rate,
            }
        else:
            numerics |= {"max_turn_rate": self.max_turn_rate, "max_turn_acceleration": self.max_turn_acceleration}
        numerics |= {"command_timeout": TIMEOUT, "radius": self.radius, "friction": FRICTION}
        parts = [f'    <text name="drive" data="{self.drive}"/>'] if self.drive != "differential" else []
        parts += [f'    <numeric name="{key}" data="{value:.6g}"/>' for key, value in numerics.items()]
        wheels, servos = {"differential": self._pair, "ackermann": self._rear, "omnidirectional": self._push}[
            self.drive
        ]()
        source = self.file.name.replace("--", "- -")
        lines = [
            f"<!-- Imported from {source} by sean import-robot: shapes at rest, in m, s, kg, N and rad.",
            f"     {'; '.join(f'{key}: {where}' for key, _, where in self.numbers).replace('--', '')}. -->",
            f"<mujoco model={quoteattr(name)}>",
            '  <compiler angle="radian" inertiafromgeom="auto"/>',
            f'  <option timestep="{STEP}" integrator="Euler"/>',
            "  <custom>",
            *parts,
            "  </custom>",
            '  <default><geom contype="0" conaffinity="0"/></default>',
            "  <worldbody>",
            '    <light pos="0 0 3" dir="0 0 -1"/>',
            '    <body name="base">',
            '      <joint name="x" type="slide" axis="1 0 0"/>',
            '      <joint name="y" type="slide" axis="0 1 0"/>',
            '      <joint name="yaw" type="hinge" axis="0 0 1"/>',
            *self._geoms(),
            *self._mounts(),
            *wheels,
            "    </body>",
            "  </worldbody>",
            "  <actuator>",
            *servos,
            "  </actuator>",
            "</mujoco>",
        ]
        return "\n".join(lines) + "\n"

    def _inertial(self, ahead: float, mass: float, inertia: float) -> str:
        inertia = max(inertia, 0.05 * self.inertia)
        about = _row([inertia, inertia, inertia])
        return f'      <inertial pos="{ahead:.6g} 0 {self.center_height:.6g}" mass="{mass:.6g}" diaginertia="{about}"/>'

    def _wheel_mass(self, wheels: list[Wheel]) -> float:
        own = sum(self.body.links[wheel.link].mass for wheel in wheels)
        return float(np.clip(own, 0.005 * self.mass, 0.2 * self.mass))

    def _servo(self, inertia: float, share: float) -> str:
        """The servo of a wheel with an inertia [kg m2], which moves a share of the mass.

        Its gain is the greatest that is stable at the step of the physics (envs/robots/kuri.xml).
        """
        radius = self.wheel_radius or 0.0
        torque = RESERVE * self.max_acceleration * (self.mass * radius * share + inertia / radius)
        return f'kv="{self.armature / STEP:.6g}" forcerange="{-torque:.6g} {torque:.6g}"'

    def _pair(self) -> tuple[list[str], list[str]]:
        """Two wheels: of a robot with more, each stands for all of its side."""
        left, right = ([w for w in self.fixed if s * w.place[1] > 0.0] for s in (1, -1))
        mass, radius = (self._wheel_mass(left) + self._wheel_mass(right)) / 2, self.wheel_radius or 0.0
        width = float(np.mean([wheel.width for wheel in self.fixed]))
        spin, about = 0.5 * mass * radius**2, mass * (3 * radius**2 + 4 * width**2) / 12
        armature = self.armature
        rest = self.inertia - 2 * (about + mass * (self.track / 2) ** 2)
        servo = self._servo(spin + armature, 0.5)
        alpha = "0.15 0.15 0.16 0"  # transparent: the wheels of the file are drawn
        lines = [self._inertial(0.0, self.mass - 2 * mass, rest)]
        for side, sign in (("left", 1), ("right", -1)):
            lines += [
                f'      <body name="{side}_wheel" pos="0 {sign * self.track / 2:.6g} {radius:.6g}">',
                f'        <joint name="{side}_wheel" type="hinge" axis="0 1 0" armature="{armature:.6g}"/>',
                f'        <geom name="{side}_wheel" type="cylinder" size="{radius:.6g} {width:.6g}" zaxis="0 1 0" '
                f'mass="{mass:.6g}" rgba="{alpha}"/>',
                "      </body>",
            ]
        servos = [f'    <velocity name="{side}_wheel" joint="{side}_wheel" {servo}/>' for side in ("left", "right")]
        return lines, servos

    def _rear(self) -> tuple[list[str], list[str]]:
        """The rear axle of a car."""
        mass, radius = self._wheel_mass(self.fixed), self.wheel_radius or 0.0
        behind = max(0.0, -float(np.mean([wheel.place[0] for wheel in self.fixed])))
        spin = 0.5 * mass * radius**2
        servo = self._servo(spin + self.armature, 1.0)
        base = self.mass - mass
        ahead = mass * behind / base
        rest = self.inertia - mass * behind**2 - spin - base * ahead**2
        width = float(np.mean([wheel.width for wheel in self.fixed]))
        lines = [
            self._inertial(ahead, base, rest),
            f'      <body name="rear_wheels" pos="{-behind:.6g} 0 {radius:.6g}">',
            f'        <joint name="rear_wheels" type="hinge" axis="0 1 0" armature="{self.armature:.6g}"/>',
            f'        <inertial pos="0 0 0" mass="{mass:.6g}" diaginertia="{_row([spin] * 3)}"/>',
            f'        <geom name="rear_wheels" type="cylinder" size="{radius:.6g} {width:.6g}" zaxis="0 1 0" '
            'rgba="0.15 0.15 0.16 0"/>',
            "      </body>",
        ]
        return lines, [f'    <velocity name="rear_wheels" joint="rear_wheels" {servo}/>']

    def _push(self) -> tuple[list[str], list[str]]:
        """Three servos that push an omnidirectional base."""
        lines = [self._inertial(0.0, self.mass, self.inertia), '      <site name="drive" pos="0 0 0.05" size="0.01"/>']
        servos = []
        for name, gear, moved, top in (
            ("ahead", "1 0 0 0 0 0", self.mass, self.max_acceleration),
            ("left", "0 1 0 0 0 0", self.mass, self.max_acceleration),
            ("turn", "0 0 0 0 0 1", self.inertia, self.max_turn_acceleration),
        ):
            force = RESERVE * top * moved
            gain = f'kv="{moved / RESPONSE:.6g}" forcerange="{-force:.6g} {force:.6g}"'
            servos.append(f'    <velocity name="{name}" site="drive" gear="{gear}" {gain}/>')
        return lines, servos

    def _geoms(self) -> list[str]:
        lines = []
        for shape in self.shapes:
            color = _row([*shape.color, 1.0])
            size, place = _row(shape.size), _row(shape.place)
            turn = "" if shape.kind == "sphere" else f' zaxis="{_row(shape.turn[:, 2])}"'
            if shape.kind == "box":
                turn = f' euler="0 0 {np.arctan2(shape.turn[1, 0], shape.turn[0, 0]):.6g}"'
            lines.append(f'      <geom type="{shape.kind}" size="{size}" pos="{place}"{turn} mass="0" rgba="{color}"/>')
        return lines

    def _mounts(self) -> list[str]:
        """The lidar and the cameras, where the file has some, else on top."""
        named = [each for each in self.body.frames if LIDAR.search(each[0])]
        place, axes = named[0][1:] if named else (np.array([0.0, 0.0, self.top]), np.eye(3))
        self._add("lidar", f"{place[2]:.3g} m high", named[0][0] if named else "none in the file: on top")
        lines = [
            f'      <site name="lidar" pos="{_row(place)}" xyaxes="{_row(axes[:, 0])} {_row(axes[:, 1])}" size="0.01"/>'
        ]
        eyes = [(name, place, axes[:, 0], axes[:, 1]) for name, place, axes in self.body.cameras] or [
            (name, place, *_view(name, axes)) for name, place, axes in self.body.frames if CAMERA.search(name)
        ]
        eyes.sort(key=lambda each: (np.cross(each[3], each[2])[0] < AHEAD, "optical" in each[0]))
        eye = np.array([self.front, 0.0, 0.9 * self.top]), np.array([0.0, -1.0, 0.0]), np.array([-0.0872, 0.0, 0.9962])
        place, right, up = eyes[0][1:] if eyes else eye
        self._add("camera", f"{place[2]:.3g} m high", eyes[0][0] if eyes else "none in the file: in front")
        for name in ("depth", "first_person"):
            lines.append(
                f'      <camera name="{name}" pos="{_row(place)}" xyaxes="{_row(right)} {_row(up)}" fovy="60"/>'
            )
        behind = _row([-1.15, 0.0, max(1.0, self.top + 0.4)])
        lines.append(f'      <camera name="third_person" pos="{behind}" xyaxes="0 -1 0 0.3420 0 0.9397" fovy="60"/>')
        lines.append('      <camera name="overhead" pos="0 0 3.5" xyaxes="0 -1 0 1 0 0" fovy="81.2"/>')
        return lines


# --- shapes ---


def outline(shape: Shape) -> np.ndarray:
    """Points (n, 3) [m] around a shape; of a round one 32 on each rim."""
    if shape.kind == "box":
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3) * shape.size
        return shape.place + corners @ shape.turn.T
    angle = 2 * np.pi * np.arange(32) / 32
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1) * shape.size[0]
    if shape.kind == "sphere":
        return shape.place + np.concatenate([ring, [[0.0, 0.0, shape.size[0]], [0.0, 0.0, -shape.size[0]]]])
    ends = np.concatenate([ring + [0.0, 0.0, shape.size[1]], ring - [0.0, 0.0, shape.size[1]]])
    return shape.place + ends @ shape.turn.T


def upright(shape: Shape) -> Shape:
    """The shape, or for a tilted box the upright one around it: rays know boxes that are turned about z alone."""
    if shape.kind != "box":
        return shape
    level = np.argmax(np.hypot(shape.turn[0], shape.turn[1]))  # the axis that is most horizontal
    yaw = np.arctan2(shape.turn[1, level], shape.turn[0, level])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    half = np.abs(turn.T @ shape.turn) @ shape.size
    return Shape("box", np.maximum(half, foreign_links.THIN), shape.place, turn, shape.color)


def _view(name: str, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The directions right and up of a camera in a frame of ROS: ahead is x, or z of an optical frame."""
    return (axes[:, 0], -axes[:, 1]) if "optical" in name else (-axes[:, 1], axes[:, 2])


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _row(values: Any) -> str:
    return " ".join(f"{value + 0.0:.6g}" for value in np.round(np.asarray(values, float), 9))
