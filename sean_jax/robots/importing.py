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
from typing import Any, NamedTuple
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
from sean_jax.robots.foreign_links import ForeignBody, Link, LinkShape

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
LIDAR = re.compile(r"lidar|laser|scan|velodyne|hokuyo|\blds|sick_?lms", re.I)
CAMERA = re.compile(r"camera|kinect|realsense|depth", re.I)
CASTER = re.compile(r"cast[eo]r", re.I)
ROLLER = re.compile(r"roller", re.I)
OMNI = re.compile(r"mecanum|omni", re.I)
AHEAD = 0.7  # cosine: a camera with a smaller one looks elsewhere
SPARE = re.compile(r"steering_?wheel$", re.I)


@dataclasses.dataclass(frozen=True)
class ImportSettings:
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
class ImportedRobot:
    """An imported robot."""

    path: Path
    drive: str
    numbers: list[tuple[str, str, str]]  # name, value with unit, and where it is from
    shapes: list[LinkShape]  # in the robot's frame: x ahead, from the floor
    radius: float  # m
    notes: list[str]
    gap: float  # m, between MJX and its closed form at the end of a short drive
    lag: float  # m, to the same drive without inertia


def import_robot(file: Path, out: Path, settings: ImportSettings = ImportSettings()) -> ImportedRobot:
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
    return ImportedRobot(out, base.drive, base.numbers, base.shapes, base.radius, base.notes, gap, lag)


def _read(file: Path) -> ForeignBody:
    """The links of a file, by its root element."""
    text = read_text(file, MAX_MESH)
    is_mjcf = re.search(r"<mujoco[\s>]", text) and "<robot" not in text
    if is_mjcf:
        return foreign_links.from_mjcf(file)
    return urdf_reading.read_urdf(file)


def drive_briefly(path: Path, drive: str) -> tuple[float, float]:
    """Drive a robot for 3 s, ahead and then in a curve, on an empty floor.

    Returns:
        m, how far MJX ends from the closed form, and from the robot without inertia.
    """
    in_mjx, twin, kinematic = (_end_of_drive(path, drive, dynamics) for dynamics in ("mjx", "twin", "kinematic"))
    return float(np.linalg.norm(in_mjx - twin)), float(np.linalg.norm(in_mjx - kinematic))


def _end_of_drive(path: Path, drive: str, dynamics: str) -> np.ndarray:
    """(2,) m, where the drive of ``drive_briefly`` ends."""
    model = robots.load(path, dynamics)
    dtype = jnp.result_type(float)
    no_vectors = jnp.zeros((0, 2), dtype)
    no_numbers = jnp.zeros(0, dtype)

    # A drive reads only these fields of a scenario and a state.
    nobody = SimpleNamespace(position=no_vectors, velocity=no_vectors, present=jnp.zeros(0, bool))
    obstacles = Obstacles(no_vectors, no_vectors, no_numbers, no_numbers)
    scenario: Any = SimpleNamespace(
        environment=SimpleNamespace(obstacles=obstacles),
        robot=model,
        time_step=0.1,
        forces=SimpleNamespace(walking=SimpleNamespace(radius=jnp.asarray(0.3, dtype))),
    )

    def advance(robot: Any, command: Any) -> tuple[Any, None]:
        state: Any = SimpleNamespace(robot=robot, pedestrians=nobody)
        return model.drive(scenario, state, command), None

    @jax.jit
    def run(start: Any, commands: Any) -> Any:
        return jax.lax.scan(advance, start, commands)[0]

    speed = 0.5 * model.max_speed
    turn_rate = 0.25 * model.max_turn_rate
    zero = jnp.zeros_like(speed)
    left = [zero] if drive == "omnidirectional" else []  # of a command ahead, to the left, turn rate
    straight = jnp.stack([speed, *left, zero])
    curve = jnp.stack([speed, *left, turn_rate])
    start = model.place(model, jnp.zeros(2, dtype), jnp.asarray([1.0, 0.0], dtype))
    end = run(start, jnp.stack([straight] * 15 + [curve] * 15))
    return np.asarray(end.position, float)


# --- wheels ---


def find_wheels(file: Path, body: ForeignBody, settings: ImportSettings) -> list[Wheel]:
    """The wheels of a robot that may be driven, without casters and rollers.

    Raises:
        InputError: a joint of ``settings.wheels`` does not exist.
    """
    if settings.wheels:
        return _named_wheels(file, body, settings.wheels)
    wheels = [wheel for index in range(len(body.links)) if (wheel := _wheel(body, index)) is not None]
    bottoms = [wheel.place[2] - wheel.radius for wheel in wheels if wheel.radius is not None]
    floor = min(bottoms, default=0.0)
    wheels = [wheel for wheel in wheels if _reaches_floor(wheel, floor)]
    driven = [wheel for wheel in wheels if body.links[wheel.link].driven]
    return driven or wheels


def _named_wheels(file: Path, body: ForeignBody, names: tuple[str, ...]) -> list[Wheel]:
    """The wheels of hinges."""
    hinges = {link.joint: index for index, link in enumerate(body.links) if link.kind == "hinge"}
    for name in names:
        if name not in hinges:
            suggestion = suggest(name, hinges) or f"; its hinges are {', '.join(hinges) or 'none'}."
            raise InputError(f"--wheels: {file} has no hinge '{name}'{suggestion}")
    return [_as_wheel(body, hinges[name]) for name in names]


def _reaches_floor(wheel: Wheel, floor: float) -> bool:
    """Whether a wheel begins hardly above the height [m] of the floor, or has no shape."""
    if wheel.radius is None:
        return True
    return wheel.place[2] - wheel.radius <= floor + max(ON_FLOOR, ROUND_SHARE * wheel.radius)


def _wheel(body: ForeignBody, index: int) -> Wheel | None:
    """The wheel of a link, if it looks like one."""
    link = body.links[index]
    if link.kind != "hinge" or abs(link.axis[2]) > LEVEL or SPARE.search(link.joint):
        return None
    for above_root in [index, *_above(body, index)][:-1]:
        for name in (body.links[above_root].name, body.links[above_root].joint):
            if CASTER.search(name) or ROLLER.search(name):
                return None
    wheel = _as_wheel(body, index)
    is_named_wheel = "wheel" in (link.name + link.joint).lower()
    if is_named_wheel or wheel.radius is not None:
        return wheel
    return None


def _as_wheel(body: ForeignBody, index: int) -> Wheel:
    link = body.links[index]

    # The largest round shape about the hinge is the wheel.
    radius = None
    width = 0.02
    middle = link.place
    for shape in _rigid_shapes(body, index):
        size = _round(shape, link)
        if size is not None and (radius is None or size[0] > radius):
            radius, width = size
            middle = shape.place
    along = float((middle - link.place) @ link.axis)
    place = link.place + along * link.axis
    return Wheel(index, link.joint, place, link.axis, radius, width, _steering_link(body, index))


def _steering_link(body: ForeignBody, index: int) -> int | None:
    """The first link above a link that turns about the vertical."""
    for above in _above(body, index):
        link = body.links[above]
        if link.kind == "hinge" and abs(link.axis[2]) > 0.9:
            return above
    return None


def _above(body: ForeignBody, index: int) -> list[int]:
    """The links above a link, up to the root."""
    chain = []
    while (index := body.links[index].parent) >= 0:
        chain.append(index)
    return chain


def _rigid_shapes(body: ForeignBody, index: int) -> list[LinkShape]:
    """The shapes of a link and of all links that are fixed to it."""
    shapes = [*body.links[index].shapes]
    for below, link in enumerate(body.links):
        if link.parent == index and link.kind == "fixed":
            shapes += _rigid_shapes(body, below)
    return shapes


def _round(shape: LinkShape, link: Link) -> tuple[float, float] | None:
    """Radius and half the width [m] of a shape that is round about the axis of a link."""
    offset = shape.place - link.place
    from_axis = float(np.linalg.norm(offset - (offset @ link.axis) * link.axis))
    if shape.kind == "sphere":
        radius = width = float(shape.size[0])
    elif shape.kind == "cylinder" and abs(shape.turn[:, 2] @ link.axis) > PARALLEL:
        radius, width = map(float, shape.size)
    elif shape.kind == "box":
        axis = int(np.argmax(np.abs(shape.turn.T @ link.axis)))
        across = np.delete(shape.size, axis)
        radius = float(across.max())
        width = float(shape.size[axis])
        is_square = across.min() >= (1.0 - ROUND_SHARE) * radius
        if not is_square or abs(shape.turn[:, axis] @ link.axis) < PARALLEL:
            return None
    else:
        return None
    if from_axis <= ROUND_SHARE * radius:
        return (radius, width)
    return None


def drive_of(file: Path, body: ForeignBody, wheels: list[Wheel], settings: ImportSettings) -> str:
    """The drive by the wheels: ``differential``, ``omnidirectional`` or ``ackermann``.

    Raises:
        FileError: no drive has such wheels.
    """
    if settings.drive is not None:
        return settings.drive
    fixed = [wheel for wheel in wheels if wheel.steered is None]
    steered = [wheel for wheel in wheels if wheel.steered is not None]
    all_parallel = all(abs(wheel.axis @ fixed[0].axis) > PARALLEL for wheel in fixed)
    all_steered = len(steered) > 1 and not fixed
    has_rollers = any(ROLLER.search(link.name + link.joint) for link in body.links)
    has_name = any(OMNI.search(name) for name in (body.name, *(wheel.name for wheel in wheels)))
    if wheels and (has_rollers or not all_parallel or has_name or all_steered):
        return "omnidirectional"
    if len(fixed) >= 2:
        return "ackermann" if steered else "differential"
    if wheels:
        raise FileError(
            f"{file}: only '{wheels[0].name}' of its hinges looks like a wheel on the floor; name the hinges of the "
            "left and the right wheel by --wheels, or give --drive omnidirectional."
        )
    raise FileError(
        f"{file}: none of its hinges looks like a wheel on the floor; name the hinges of the left and the right wheel "
        "by --wheels, or give --drive omnidirectional."
    )


# --- the base: one rigid body with wheels ---


class _Base:
    """The planar base of a robot: its shapes, numbers and file."""

    def __init__(self, file: Path, body: ForeignBody, settings: ImportSettings):
        self.file = file
        self.body = body
        self.settings = settings
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
            meshes = ", ".join(body.missing)
            self.notes.append(f"without the shapes of meshes that are missing or cannot be read: {meshes}")

    def _place(self) -> None:
        """Find the robot's frame, and transform all links to it."""
        radii = [wheel.radius for wheel in self.fixed or self.wheels if wheel.radius is not None]
        self.wheel_radius = self.settings.wheel_radius or (float(np.mean(radii)) if radii else None)
        if self.wheels and self.wheel_radius is None:
            self.missing.append("--wheel-radius")
        self._transform(self._rotation(), self._origin())
        if self.drive == "differential" and not (self._on_side(1) and self._on_side(-1)):
            joints = _listed([wheel.name for wheel in self.fixed])
            raise FileError(
                f"{self.file}: all wheels ({joints}) are on one side; name a left and a right one by --wheels."
            )

    def _on_side(self, sign: int) -> list[Wheel]:
        """The fixed wheels on the left (1) or on the right (-1)."""
        return [wheel for wheel in self.fixed if sign * wheel.place[1] > 0.0]

    def _rotation(self) -> np.ndarray:
        """(3, 3) from the root link to the robot: x across the axles, toward the root's x or else its y."""
        ahead = np.array([1.0, 0.0, 0.0])
        if self.drive != "omnidirectional":
            x, y, _ = self.fixed[0].axis if self.fixed else (0.0, 1.0, 0.0)
            ahead = np.array([y, -x, 0.0]) / np.hypot(x, y)
            is_forward = ahead[0] > 1e-6 or (abs(ahead[0]) <= 1e-6 and ahead[1] > 0.0)
            ahead = ahead if is_forward else -ahead
        return np.stack([ahead, [-ahead[1], ahead[0], 0.0], [0.0, 0.0, 1.0]])

    def _origin(self) -> np.ndarray:
        """(3,) m, the place on the floor between the wheels, or below the root link."""
        if self.wheels:
            middle = np.mean([wheel.place for wheel in self.fixed or self.wheels], 0)
            return middle - [0.0, 0.0, self.wheel_radius or 0.0]
        bottoms = [outline(shape)[:, 2].min() for link in self.body.links for shape in link.shapes]
        if bottoms:
            return np.array([0.0, 0.0, min(bottoms)])
        return np.zeros(3)

    def _transform(self, turn: np.ndarray, origin: np.ndarray) -> None:
        """Move links, wheels and mounts to a frame with an origin [m], turned by a rotation (3, 3)."""
        for link in self.body.links:
            link.place = turn @ (link.place - origin)
            link.center = turn @ (link.center - origin)
            link.turn = turn @ link.turn
            link.axis = turn @ link.axis
            link.inertia = turn @ link.inertia @ turn.T
            for shape in link.shapes:
                shape.place = turn @ (shape.place - origin)
                shape.turn = turn @ shape.turn
        for wheel in self.wheels:
            wheel.place = turn @ (wheel.place - origin)
            wheel.axis = turn @ wheel.axis
        for mounts in (self.body.cameras, self.body.frames):
            mounts[:] = [(name, turn @ (place - origin), turn @ axes) for name, place, axes in mounts]

    def _shift(self, ahead: float) -> None:
        """Move the robot's origin ahead [m]."""
        offset = np.array([ahead, 0.0, 0.0])
        for link in self.body.links:
            link.place = link.place - offset
            link.center = link.center - offset
            for shape in link.shapes:
                shape.place = shape.place - offset
        for wheel in self.wheels:
            wheel.place = wheel.place - offset
        for mounts in (self.body.cameras, self.body.frames):
            mounts[:] = [(name, place - offset, axes) for name, place, axes in mounts]

    def _measure(self) -> None:
        """Compute the numbers of the robot, from the file or the options."""
        settings = self.settings
        wheels = f"wheels {_listed([wheel.name for wheel in self.wheels])}"
        self._add("drive", self.drive, "--drive" if settings.drive else wheels)
        links_mass = sum(link.mass for link in self.body.links)
        self.mass = self._number("mass", settings.mass, links_mass, "kg", "inertials", "--mass")
        self._center(links_mass)
        self.shapes = [upright(shape) for link in self.body.links for shape in link.shapes]
        reach = self._extent()
        self.radius = self._number("radius", settings.radius, reach, "m", "outline of base and wheels", "--radius")
        self.inertia = self._inertia(links_mass)
        if self.wheels:
            source = "--wheel-radius" if settings.wheel_radius else "shapes"
            self._add("wheel radius", f"{self.wheel_radius or 0.0:.4g} m", source)
        self._limits()

    def _center(self, mass: float) -> None:
        """The height of the center of the links' mass [kg]; it is taken as above the origin."""
        moment = sum((link.mass * link.center for link in self.body.links), np.zeros(3))
        center = moment / (mass or 1.0)
        self.center_height = float(np.clip(center[2], 0.01, 10.0)) if mass else 0.1
        if self.drive == "ackermann":
            self._axles(float(center[0]))
            center[0] = 0.0
        if mass and np.hypot(*center[:2]) > 0.01:
            x, y = center[:2]
            self.notes.append(
                f"the center of mass lies {x:+.3f} m ahead and {y:+.3f} m left of the origin and is taken as above it"
            )

    def _extent(self) -> float:
        """m, how far base and wheels reach from the origin; also their top and front [m]."""
        all_points = _outlines(self.shapes)
        rigid_links = (0, *(wheel.link for wheel in self.wheels))
        rigid_shapes = [shape for link in rigid_links for shape in _rigid_shapes(self.body, link)]
        points = _outlines(rigid_shapes) if rigid_shapes else all_points
        farthest = _distance(all_points)
        reach = _distance(points)
        if farthest > reach + 0.01 and self.settings.radius is None:
            self.notes.append(f"links that move reach {farthest:.3g} m from the origin, beyond the radius")
        self.top = float(points[:, 2].max()) if len(points) else 0.3
        self.front = float(points[:, 0].max()) if len(points) else 0.1
        return reach

    def _inertia(self, links_mass: float) -> float:
        """kg m2 about the vertical: of the links, scaled to the mass; of a disc if they have none."""
        inertia = 0.0
        for link in self.body.links:
            offset = link.center[:2]
            inertia += link.inertia[2, 2] + link.mass * float(offset @ offset)
        scale = self.mass / links_mass if links_mass else 0.0
        return inertia * scale or 0.5 * self.mass * self.radius**2

    def _axles(self, center: float) -> None:
        """Wheelbase, place of the rear axle and steering of a car, whose origin moves to the center of mass."""
        steered = [wheel for wheel in self.wheels if wheel.steered is not None]
        if not steered or not self.fixed:
            raise FileError(
                f"{self.file}: a car has steered and other wheels, and this robot lacks one kind; "
                "choose another --drive."
            )
        self.wheelbase = float(np.mean([wheel.place[0] for wheel in steered]))
        if self.wheelbase <= 0.0:
            raise FileError(f"{self.file}: its steered wheels lie behind the others; a car steers at its front axle.")
        joints = [self.body.links[wheel.steered] for wheel in steered if wheel.steered is not None]
        angles = [joint.max_angle for joint in joints if joint.max_angle is not None]
        rates = [joint.max_rate for joint in joints if joint.max_rate is not None]
        for values, key in ((angles, "range (lower and upper)"), (rates, "greatest velocity")):
            if len(values) < len(joints):
                raise FileError(
                    f"{self.file}: joint '{joints[0].joint}' steers, but has no {key}; add it to its <limit>."
                )
        self.max_angle = min(min(angles), 1.5)
        self.max_rate = min(min(rates), 100.0)
        self._shift(float(np.clip(center, 0.0, 0.9 * self.wheelbase)))
        self._add("wheelbase", f"{self.wheelbase:.4g} m", "joints")
        steering = f"{np.rad2deg(self.max_angle):.3g} degrees, {self.max_rate:.3g} rad/s"
        self._add("steering", steering, "limit of the joint")

    def _limits(self) -> None:
        """Speeds and accelerations."""
        settings = self.settings
        radius = self.wheel_radius or (1.0 if self.wheels else 0.0)  # one that is missing is refused later
        driven = [self.body.links[wheel.link] for wheel in self.fixed or self.wheels]
        rates = [link.max_rate for link in driven if link.max_rate is not None]
        torques = [link.max_torque for link in driven if link.max_torque is not None]

        wheel_speed = min(rates) * radius if rates else 0.0
        self.max_speed = self._number(
            "max speed", settings.max_speed, wheel_speed, "m/s", "velocity of the wheels", "--max-speed"
        )
        self.armature = 0.5 * self.mass * radius**2
        force = sum(torques) / radius if radius else 0.0
        acceleration = min(force / (self.mass or 1.0), GRIP)
        self.max_acceleration = self._number(
            "max acceleration", settings.max_acceleration, acceleration, "m/s2",
            "effort of the wheels, at most the grip", "--max-acceleration"
        )  # fmt: skip
        lever = self._lever()
        if self.drive != "ackermann" and (self.max_speed or not lever):
            self._turn_limits(wheel_speed or self.max_speed, lever)

    def _lever(self) -> float:
        """m, from the origin to the wheels that turn the robot; 0 without wheels."""
        if self.drive != "differential":
            distances = [np.hypot(*wheel.place[:2]) for wheel in self.wheels]
            if distances:
                return float(np.mean(distances))
            return 0.0
        left, right = (np.mean([wheel.place[1] for wheel in self._on_side(sign)]) for sign in (1, -1))
        self.track = self.settings.wheel_separation or float(left - right)
        source = "--wheel-separation" if self.settings.wheel_separation else "joints"
        self._add("wheel separation", f"{self.track:.4g} m", source)
        return self.track / 2

    def _turn_limits(self, wheel_speed: float, lever: float) -> None:
        """Turn rate and its change, by the speed [m/s] of wheels at a distance [m]."""
        turn_rate = min(wheel_speed / lever if lever else 0.0, 100.0)
        source = "of the wheels at their distance" if lever else "at the radius"
        self.max_turn_rate = self._number(
            "max turn rate", self.settings.max_turn_rate, turn_rate, "rad/s", f"speed {source}", "--max-turn-rate"
        )
        self.max_turn_acceleration = min(self.max_acceleration / (lever or self.radius or 1.0), 1e4)
        value = f"{self.max_turn_acceleration:.4g} rad/s2"
        self._add("max turn acceleration", value, f"acceleration {source}")

    def _number(self, name: str, setting: float | None, of_file: float, unit: str, source: str, option: str) -> float:
        value = setting if setting is not None else of_file
        if not value > 0.0:
            self.missing.append(option)
            return 0.0
        self._add(name, f"{value:.4g} {unit}", option if setting is not None else source)
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
        custom = [f'    <numeric name="{key}" data="{value:.6g}"/>' for key, value in numerics.items()]
        if self.drive != "differential":
            custom.insert(0, f'    <text name="drive" data="{self.drive}"/>')
        propulsion = {"differential": self._pair, "ackermann": self._rear, "omnidirectional": self._push}
        wheels, servos = propulsion[self.drive]()
        file = self.file.name.replace("--", "- -")  # not allowed in comments
        sources = "; ".join(f"{key}: {source}" for key, _, source in self.numbers).replace("--", "")
        lines = [
            f"<!-- Imported from {file} by sean import-robot: shapes at rest, in m, s, kg, N and rad.",
            f"     {sources}. -->",
            f"<mujoco model={quoteattr(name)}>",
            '  <compiler angle="radian" inertiafromgeom="auto"/>',
            f'  <option timestep="{STEP}" integrator="Euler"/>',
            "  <custom>",
            *custom,
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
        diagonal = _row([inertia, inertia, inertia])
        place = f"{ahead:.6g} 0 {self.center_height:.6g}"
        return f'      <inertial pos="{place}" mass="{mass:.6g}" diaginertia="{diagonal}"/>'

    def _wheel_mass(self, wheels: list[Wheel]) -> float:
        mass = sum(self.body.links[wheel.link].mass for wheel in wheels)
        return float(np.clip(mass, 0.005 * self.mass, 0.2 * self.mass))

    def _servo(self, inertia: float, share: float) -> str:
        """The servo of a wheel with an inertia [kg m2], which moves a share of the mass.

        Its gain is the greatest that is stable at the step of the physics (envs/robots/kuri.xml).
        """
        radius = self.wheel_radius or 0.0
        torque = RESERVE * self.max_acceleration * (self.mass * radius * share + inertia / radius)
        return f'kv="{self.armature / STEP:.6g}" forcerange="{-torque:.6g} {torque:.6g}"'

    def _pair(self) -> tuple[list[str], list[str]]:
        """Two wheels: of a robot with more, each stands for all of its side."""
        mass = (self._wheel_mass(self._on_side(1)) + self._wheel_mass(self._on_side(-1))) / 2
        radius = self.wheel_radius or 0.0
        width = float(np.mean([wheel.width for wheel in self.fixed]))
        spin_inertia = 0.5 * mass * radius**2
        upright_inertia = mass * (3 * radius**2 + 4 * width**2) / 12
        armature = self.armature
        base_inertia = self.inertia - 2 * (upright_inertia + mass * (self.track / 2) ** 2)
        servo = self._servo(spin_inertia + armature, 0.5)
        alpha = "0.15 0.15 0.16 0"  # transparent: the wheels of the file are drawn
        lines = [self._inertial(0.0, self.mass - 2 * mass, base_inertia)]
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
        mass = self._wheel_mass(self.fixed)
        radius = self.wheel_radius or 0.0
        behind = max(0.0, -float(np.mean([wheel.place[0] for wheel in self.fixed])))
        spin = 0.5 * mass * radius**2
        servo = self._servo(spin + self.armature, 1.0)
        width = float(np.mean([wheel.width for wheel in self.fixed]))

        # The rest of the mass lies ahead of the center.
        base_mass = self.mass - mass
        ahead = mass * behind / base_mass
        base_inertia = self.inertia - mass * behind**2 - spin - base_mass * ahead**2
        lines = [
            self._inertial(ahead, base_mass, base_inertia),
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
        for name, gear, mass, acceleration in (
            ("ahead", "1 0 0 0 0 0", self.mass, self.max_acceleration),
            ("left", "0 1 0 0 0 0", self.mass, self.max_acceleration),
            ("turn", "0 0 0 0 0 1", self.inertia, self.max_turn_acceleration),
        ):
            force = RESERVE * acceleration * mass
            gain = f'kv="{mass / RESPONSE:.6g}" forcerange="{-force:.6g} {force:.6g}"'
            servos.append(f'    <velocity name="{name}" site="drive" gear="{gear}" {gain}/>')
        return lines, servos

    def _geoms(self) -> list[str]:
        lines = []
        for shape in self.shapes:
            color = _row([*shape.color, 1.0])
            size = _row(shape.size)
            place = _row(shape.place)
            turn = "" if shape.kind == "sphere" else f' zaxis="{_row(shape.turn[:, 2])}"'
            if shape.kind == "box":
                turn = f' euler="0 0 {np.arctan2(shape.turn[1, 0], shape.turn[0, 0]):.6g}"'
            lines.append(f'      <geom type="{shape.kind}" size="{size}" pos="{place}"{turn} mass="0" rgba="{color}"/>')
        return lines

    def _mounts(self) -> list[str]:
        """The lidar and the cameras, where the file has some, else on top."""
        source, place, axes = self._lidar()
        self._add("lidar", f"{place[2]:.3g} m high", source)
        directions = f"{_row(axes[:, 0])} {_row(axes[:, 1])}"
        lines = [f'      <site name="lidar" pos="{_row(place)}" xyaxes="{directions}" size="0.01"/>']

        camera = self._camera()
        self._add("camera", f"{camera.place[2]:.3g} m high", camera.name)
        directions = f"{_row(camera.right)} {_row(camera.up)}"
        for name in ("depth", "first_person"):
            lines.append(f'      <camera name="{name}" pos="{_row(camera.place)}" xyaxes="{directions}" fovy="60"/>')

        behind = _row([-1.15, 0.0, max(1.0, self.top + 0.4)])
        lines.append(f'      <camera name="third_person" pos="{behind}" xyaxes="0 -1 0 0.3420 0 0.9397" fovy="60"/>')
        lines.append('      <camera name="overhead" pos="0 0 3.5" xyaxes="0 -1 0 1 0 0" fovy="81.2"/>')
        return lines

    def _lidar(self) -> tuple[str, np.ndarray, np.ndarray]:
        """Name, place [m] and axes (3, 3) of the first frame that is named like a lidar, else of one on top."""
        for name, place, axes in self.body.frames:
            if LIDAR.search(name):
                return name, place, axes
        return "none in the file: on top", np.array([0.0, 0.0, self.top]), np.eye(3)

    def _camera(self) -> "_ForeignCamera":
        """The camera of the file that looks ahead the most plainly, else one in front."""
        cameras = [_ForeignCamera(name, place, axes[:, 0], axes[:, 1]) for name, place, axes in self.body.cameras]
        if not cameras:
            frames = [frame for frame in self.body.frames if CAMERA.search(frame[0])]
            cameras = [_ForeignCamera(name, place, *_view(name, axes)) for name, place, axes in frames]
        if not cameras:
            place = np.array([self.front, 0.0, 0.9 * self.top])
            right = np.array([0.0, -1.0, 0.0])
            up = np.array([-0.0872, 0.0, 0.9962])
            return _ForeignCamera("none in the file: in front", place, right, up)
        return min(cameras, key=lambda camera: (not camera.looks_ahead, "optical" in camera.name))


class _ForeignCamera(NamedTuple):
    """A camera of the file, or a frame that is named like one."""

    name: str
    place: np.ndarray  # (3,) m
    right: np.ndarray  # (3,) unit vectors
    up: np.ndarray

    @property
    def looks_ahead(self) -> bool:
        return bool(np.cross(self.up, self.right)[0] >= AHEAD)


# --- shapes ---


def _outlines(shapes: list[LinkShape]) -> np.ndarray:
    """Points (n, 3) [m] around shapes."""
    return np.concatenate([outline(shape) for shape in shapes] or [np.zeros((0, 3))])


def _distance(points: np.ndarray) -> float:
    """The horizontal distance [m] of the farthest point from the origin; 0 without points."""
    if len(points):
        return float(np.hypot(points[:, 0], points[:, 1]).max())
    return 0.0


def outline(shape: LinkShape) -> np.ndarray:
    """Points (n, 3) [m] around a shape; of a round one 32 on each rim."""
    if shape.kind == "box":
        corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3) * shape.size
        return shape.place + corners @ shape.turn.T
    angle = 2 * np.pi * np.arange(32) / 32
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1) * shape.size[0]
    if shape.kind == "sphere":
        top = np.array([0.0, 0.0, shape.size[0]])
        return shape.place + np.concatenate([ring, [top, -top]])
    to_rim = np.array([0.0, 0.0, shape.size[1]])
    rims = np.concatenate([ring + to_rim, ring - to_rim])
    return shape.place + rims @ shape.turn.T


def upright(shape: LinkShape) -> LinkShape:
    """The shape, or for a tilted box the upright one around it: rays know boxes that are turned about z alone."""
    if shape.kind != "box":
        return shape
    level = np.argmax(np.hypot(shape.turn[0], shape.turn[1]))  # the axis that is most horizontal
    yaw = np.arctan2(shape.turn[1, level], shape.turn[0, level])
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    half = np.abs(turn.T @ shape.turn) @ shape.size
    return LinkShape("box", np.maximum(half, foreign_links.THIN), shape.place, turn, shape.color)


def _view(name: str, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The directions right and up of a camera in a frame of ROS: ahead is x, or z of an optical frame."""
    x, y, z = axes.T
    if "optical" in name:
        return x, -y
    return -y, z


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _row(values: Any) -> str:
    return " ".join(f"{value + 0.0:.6g}" for value in np.round(np.asarray(values, float), 9))
