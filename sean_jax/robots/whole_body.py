"""Bodies with arms, legs or wheels of their own: an MJCF file stepped whole by MJX, under a controller of the user.

The body stands on its ground plane, with the contacts of its feet or wheels. Obstacles and people touch its disc, as
that of the kinematic robot.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax.core import bounds, user_calls
from sean_jax.core.data_types import Array, Lateral, Robot, RobotModel, Scenario, State
from sean_jax.core.errors import FileError, InputError
from sean_jax.core.geometry import rotate, unit_vectors
from sean_jax.io.files import mjcf
from sean_jax.robots import description, drive
from sean_jax.robots.dynamics import Way, kinematic_move, mjx

WHOLE = 1e-6  # s, maximum deviation of a period from a multiple of the physics step


class BodyState(NamedTuple):
    """``Robot.drive_state``: the body's state besides pose and speeds on the floor, which ``Robot`` has."""

    physics: dict[str, Array]  # the changing fields of ``mjx.Data``: qpos, qvel, act, qacc_warmstart, sensordata, time
    memory: PyTree  # of the controller
    command: Float[Array, "command"]  # m/s and rad/s, the last finite command
    age: Int[Array, ""]  # control steps since that command
    target: Float[Array, "command"]  # m/s and rad/s, the command within the limits, which the controller follows
    fallen: Bool[Array, ""]  # the body lies where it fell


@struct.dataclass
class ArticulatedBody:
    """``RobotModel.data`` of an articulated body."""

    model: PyTree  # mjx.Model
    home: Float[Array, "nq"]  # qpos of the posture at the start, at the origin, ahead along x
    memory: PyTree  # of the controller, at the start
    min_height: Float[Array, ""]  # m, of the base
    max_tilt: Float[Array, ""]  # rad
    controller: Callable = struct.field(pytree_node=False)
    steps: int = struct.field(pytree_node=False)  # physics steps in a period of the controller


def articulated(
    file: str | Path,
    controller: Callable,
    *,
    radius: float,
    max_speed: float,
    max_turn_rate: float,
    max_lateral_speed: float | None = None,
    max_acceleration: float = 2.0,
    max_turn_acceleration: float = 4.0,
    command_timeout: float = 0.25,
    control_period: float = 0.02,
    memory: PyTree = (),
    min_height: float | None = None,
    max_tilt: float = 1.0,
) -> RobotModel:
    """A robot of an MJCF file whose base has a freejoint, with all of its joints and contacts, by MJX.

    Args:
        file: a horizontal plane at height 0 is its ground; one is added if it has none. Its posture at the start is
            the keyframe "home", else the first, else that of the file. Meshes without contacts are left out.
        controller: ``(command, data, memory) -> (ctrl, memory)``, with the command (2,), m/s ahead and rad/s, or (3,)
            with m/s to the left between the two, and ``mjx.Data`` as MuJoCo's control callback has it.
        radius: m, of the disc that obstacles and people touch.
        max_speed: m/s, ahead and backward.
        max_turn_rate: rad/s.
        max_lateral_speed: m/s; with it, the drive is omnidirectional and commands are (3,), else differential.
        max_acceleration: m/s2, of the command that the controller follows.
        max_turn_acceleration: rad/s2, likewise.
        command_timeout: s, until the command is a stop if no finite command follows.
        control_period: s between two calls of the controller, a multiple of the file's timestep.
        memory: of the controller at the start.
        min_height: m; a base below it has fallen; None: half of its height at the start.
        max_tilt: rad between the base's z and the vertical, beyond which it has fallen.

    Raises:
        InputError: a number is out of range, the controller gives another array, or the file is no such body.
    """
    # Limits have the same ranges as those of wheeled robots, since policies and tasks read them alike.
    path = Path(file)
    limits = {
        "radius": radius,
        "max_speed": max_speed,
        "max_turn_rate": max_turn_rate,
        "max_acceleration": max_acceleration,
        "max_turn_acceleration": max_turn_acceleration,
        "command_timeout": command_timeout,
    }
    for key, value in limits.items():
        bounds.check_number(key, value, *description.RANGES[key])
    if max_lateral_speed is not None:
        bounds.check_number("max_lateral_speed", max_lateral_speed, *description.RANGES["max_lateral_speed"])

    # The posture at the start is at the origin, ahead along x: episodes move it from there.
    model = mjcf.read(path, _prepare)
    _check_body(path, model)
    data = _at_home(model)
    home = data.qpos.copy()

    # Bodies differ in height: without a limit of its own, one has fallen at half its height at the start.
    steps = _steps_of_period(path, model, control_period)
    if min_height is None:
        min_height = home[2] / 2
    else:
        min_height = bounds.check_number("min_height", min_height, 0.0, 10.0, "m")

    # Leaves have JAX's default precision, or a step would return other types than it takes.
    array = functools.partial(jnp.asarray, dtype=jnp.result_type(float))
    body = ArticulatedBody(
        model=_to_mjx(path, model),
        home=array(home),
        memory=jax.tree.map(_strong, memory),
        min_height=array(min_height),
        max_tilt=array(bounds.check_number("max_tilt", max_tilt, 0.01, 3.0, "rad")),
        controller=controller,
        steps=steps,
    )

    # What only the physics of a wheeled base read is 0.
    absent = "wheel_radius", "wheel_inertia", "track", "friction", "servo_gain", "servo_torque"
    fields: dict[str, Any] = {key: array(value) for key, value in (limits | dict.fromkeys(absent, 0.0)).items()}

    # A robot with a lateral speed counts as omnidirectional; its turn servo is 0, as the controller drives the joints.
    lateral = None
    if max_lateral_speed is not None:
        lateral = Lateral(array(max_lateral_speed), array(max_acceleration), array(0.0), array(0.0))

    # The time step is the controller's period: control steps of a scenario are multiples of it.
    robot_model = RobotModel(
        mass=array(model.body_subtreemass[model.jnt_bodyid[0]]),
        inertia=array(_inertia(model, data)),
        **fields,
        data=body,
        solids=description.solids(model, data),
        mounts=description.mounts(model, data),
        name=path.stem,
        time_step=control_period,
        place=place_body,
        drive=drive_body,
        lateral=lateral,
    )

    # Trace one period: a controller that gives another array is refused here.
    start = place_body(robot_model, jnp.zeros(2, float), jnp.asarray([1.0, 0.0], float)).drive_state
    jax.eval_shape(functools.partial(_simulate, robot_model, 1), start.physics, start.memory, start.target)
    return robot_model


def _steps_of_period(path: Path, model: Any, control_period: float) -> int:
    """Physics steps in a period of the controller [s]."""
    timestep = model.opt.timestep
    steps = round(control_period / timestep)
    if steps < 1 or abs(steps * timestep - control_period) > WHOLE:
        raise InputError(
            f"control_period: {control_period:g} s is no multiple of the timestep of {path}, {timestep:g} s; give one."
        )
    return steps


# --- its file ---


def _prepare(spec: Any) -> None:
    """Leave out meshes that only look, which no ray sees, and add a ground if there is none."""
    geom_type = mujoco.mjtGeom
    for geom in list(spec.geoms):
        touches = geom.contype or geom.conaffinity
        if geom.type == geom_type.mjGEOM_MESH and not touches and geom.parent.explicitinertial:
            spec.delete(geom)
    mesh_names = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in mesh_names:
            spec.delete(mesh)
    if not any(geom.type == geom_type.mjGEOM_PLANE for geom in spec.worldbody.geoms):
        spec.worldbody.add_geom(type=geom_type.mjGEOM_PLANE, size=[0.0, 0.0, 0.01])


def _check_body(path: Path, model: Any) -> None:
    """FileError unless the file is one body with a freejoint, driven joints, and contacts with a ground."""
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    if list(model.jnt_type).count(free) != 1 or model.jnt_type[0] != free:
        raise FileError(
            f"{path}: a body with a controller must have one freejoint, its first joint; give its base one."
        )
    base = int(model.jnt_bodyid[0])
    if model.body_parentid[base] != 0 or (model.body_rootid[1:] != base).any():
        raise FileError(f"{path}: all bodies must hang on the one with the freejoint; leave the others out.")
    if not model.nu:
        raise FileError(f"{path}: it has no actuator for the controller; give each driven joint one.")
    if model.opt.integrator not in (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST):
        raise FileError(f"{path}: the integrator of its <option> must be Euler or implicitfast; choose one of the two.")
    _check_ground(path, model)


def _check_ground(path: Path, model: Any) -> None:
    """FileError unless one horizontal plane is the ground, and something of the body touches it."""
    contype = model.geom_contype
    conaffinity = model.geom_conaffinity
    in_world = (model.geom_bodyid == 0) & ((contype > 0) | (conaffinity > 0))
    ground = np.flatnonzero(in_world)
    is_level = (model.geom_pos[ground, 2] == 0.0) & ~model.geom_quat[ground, 1:3].any(1)
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    if len(ground) != 1 or model.geom_type[ground[0]] != plane or not is_level[0]:
        raise FileError(f"{path}: the ground must be one horizontal plane at height 0; leave all other things out.")

    # MuJoCo's rule for a contact of two geoms.
    touches = (contype & conaffinity[ground[0]]) | (conaffinity & contype[ground[0]])
    if not touches[model.geom_bodyid > 0].any() and not model.npair:
        raise FileError(
            f"{path}: nothing of the body touches the ground; give its feet or wheels contype and conaffinity."
        )


def _at_home(model: Any) -> Any:
    """``mujoco.MjData`` in the posture at the start, at the origin and ahead along x."""
    data = mujoco.MjData(model)
    keys = [model.key(index).name for index in range(model.nkey)]
    if keys:
        mujoco.mj_resetDataKeyframe(model, data, keys.index("home") if "home" in keys else 0)

    # Turn the base back by its yaw.
    rotation = data.qpos[3:7]
    w, x, y, z = rotation / np.linalg.norm(rotation)
    half_yaw = 0.5 * math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turn_back = np.array([math.cos(half_yaw), 0.0, 0.0, -math.sin(half_yaw)])
    ahead = np.zeros(4)
    mujoco.mju_mulQuat(ahead, turn_back, np.array([w, x, y, z]))
    data.qpos[:2] = 0.0
    data.qpos[3:7] = ahead
    mujoco.mj_forward(model, data)
    return data


def _to_mjx(path: Path, model: Any) -> Any:
    try:
        return mjx().put_model(model, impl="jax")
    except NotImplementedError as error:
        raise FileError(f"{path}: MJX cannot step it: {error}; leave that out.") from None


def _inertia(model: Any, data: Any) -> float:
    """kg m2 about the vertical through the center of mass."""
    center = data.subtree_com[model.jnt_bodyid[0]]
    inertia = 0.0
    for body in range(1, model.nbody):
        axes = data.ximat[body].reshape(3, 3)
        offset = (data.xipos[body] - center)[:2]
        inertia += axes[2] ** 2 @ model.body_inertia[body] + model.body_mass[body] * offset @ offset
    return inertia


def _strong(value: Any) -> Array:
    """A number of Python as an array whose type does not depend on the context: else a second step is traced again."""
    return jnp.asarray(value, jnp.result_type(value))


# --- how it moves ---


def place_body(model: RobotModel, position: Float[Array, "2"], heading: Float[Array, "2"]) -> Robot:
    """The body at rest in its posture at the start, at a position [m]; a zero heading counts as the x axis."""
    heading = unit_vectors(heading, jnp.asarray([1.0, 0.0], heading.dtype))
    zero = jnp.zeros((), position.dtype)
    stop = jnp.zeros(drive.command_size(model), position.dtype)
    at_rest = mjx().make_data(model.data.model, impl="jax")
    physics = {"qpos": model.data.home}
    for name in ("qvel", "act", "qacc_warmstart", "sensordata", "time"):
        physics[name] = jnp.asarray(getattr(at_rest, name))
    state = BodyState(
        physics=physics,
        memory=model.data.memory,
        command=stop,
        age=jnp.zeros((), jnp.int32),
        target=stop,
        fallen=jnp.zeros((), bool),
    )
    robot = Robot(position, heading, zero, zero, state, None if model.lateral is None else zero)
    return replace(robot, drive_state=state._replace(physics=_on_floor(robot)))


def drive_body(scenario: Scenario, state: State, action: Float[Array, "command"]) -> Robot:
    """The body one control step later; a body that has fallen stays where it lies.

    MJX moves it as if it were alone. Then obstacles and people stop its disc on the straight way of this step, as in
    ``drive_kinematic``, and shift the whole body. Derivatives of the way by MJX are zero.

    Args:
        action: m/s and rad/s. If it is not finite, the last command holds until ``command_timeout``, then a stop.

    Raises:
        InputError: the control step is no multiple of the controller's period.
    """
    # As in other drives, a lost command holds and then stops, and limits apply before the controller.
    model = scenario.robot
    robot = state.robot
    step = scenario.time_step
    before = robot.drive_state
    law = drive.LAWS[model.drive_type]
    command, age = drive.active_command(model, before, action, step)
    target = jnp.stack(law.limit(model, tuple(before.target), tuple(command), step))

    # MJX sees the ground alone; a simulation whose numbers are not finite counts as a fall.
    steps = drive.physics_steps(model, step)
    physics, memory, finite = _simulate_alone(model, robot, steps, target)
    rotation = _rotation(physics["qpos"][3:7])  # (3, 3)
    down = ~finite | _is_down(model.data, physics["qpos"], rotation)

    # Obstacles and people act on the way of this step, and its velocity changes by what they shift.
    qpos = physics["qpos"]
    qvel = physics["qvel"]
    way = _way_among_others(scenario, state, steps, qpos)
    shift = (way.position - qpos[:2]) / step  # m/s that contacts take or give

    # The heading is the base's x axis on the floor, since the body may pitch and roll.
    cosine, sine = _ahead(rotation)
    speed, sideways = rotate(qvel[0] + shift[0], qvel[1] + shift[1], cosine, -sine)
    physics = {**physics, "qvel": qvel.at[:2].add(shift)}

    moved = Robot(
        position=way.position,
        heading=jnp.stack([cosine, sine]),
        speed=jnp.where(down, 0.0, speed),
        # MuJoCo has the angular velocity of a freejoint in the body's frame: this is its vertical part.
        turn_rate=jnp.where(down, 0.0, rotation[2] @ qvel[3:6]),
        drive_state=BodyState(physics, memory, command, age, target, before.fallen | down),
        sideways=None if robot.sideways is None else jnp.where(down, 0.0, sideways),
    )

    # A body that fell in an earlier step keeps all of its state.
    lying = replace(robot, drive_state=before)
    return jax.tree.map(lambda lying, moved: jnp.where(before.fallen, lying, moved), lying, moved)


def _simulate_alone(
    model: RobotModel, robot: Robot, steps: int, target: Array
) -> tuple[dict[str, Array], PyTree, Array]:
    """Physics and memory after a control step without obstacles and people, and whether they are finite numbers.

    If they are not, they are those of before.
    """
    before = robot.drive_state
    fixed = jax.lax.stop_gradient((model, _on_floor(robot), before.memory, target))
    after = _simulate(fixed[0], steps, *fixed[1:])
    finite = jnp.stack([jnp.isfinite(value).all() for value in after[0].values()]).all()
    last = before.physics, before.memory
    physics, memory = jax.tree.map(lambda old, new: jnp.where(finite, new, old), last, after)
    return physics, memory, finite


def _is_down(body: ArticulatedBody, qpos: Array, rotation: Array) -> Array:
    """() bool, whether the base is too low or too far from upright."""
    return (qpos[2] < body.min_height) | (rotation[2, 2] < jnp.cos(body.max_tilt))


def _way_among_others(scenario: Scenario, state: State, steps: int, qpos: Array) -> Way:
    """The straight way of a control step, as obstacles and people let the body's disc go it."""
    model = scenario.robot
    robot = state.robot
    heading = unit_vectors(robot.heading, jnp.asarray([1.0, 0.0], qpos.dtype))
    velocity = (qpos[:2] - jax.lax.stop_gradient(robot.position)) / scenario.time_step
    ahead, left = rotate(velocity[0], velocity[1], heading[0], -heading[1])
    surroundings = drive.surroundings_of(scenario, state)
    return kinematic_move(steps, model, surroundings, robot.position, heading, ahead, jnp.zeros_like(ahead), left)


def _simulate(
    model: RobotModel, periods: int, physics: dict[str, Array], memory: PyTree, command: Array
) -> tuple[dict[str, Array], PyTree]:
    """The changing fields of ``mjx.Data`` and the controller's memory after that many periods.

    Stages and order are those of MuJoCo's mj_step, in which the control callback precedes the actuators.
    """
    body = model.data
    is_euler = body.model.opt.integrator == mjx().IntegratorType.EULER
    integrate = mjx().euler if is_euler else mjx().implicit
    control = functools.partial(_control, body, command)

    def step(carry: tuple, index: Array) -> tuple[tuple, None]:
        physics, ctrl, memory = carry
        data = mjx().make_data(body.model, impl="jax").replace(**physics)
        for stage in ("fwd_position", "sensor_pos", "fwd_velocity", "sensor_vel"):
            data = getattr(mjx(), stage)(body.model, data)

        period_begins = index % body.steps == 0
        ctrl, memory = jax.lax.cond(period_begins, control, lambda data, memory: (ctrl, memory), data, memory)
        data = data.replace(ctrl=ctrl)
        for stage in ("fwd_actuation", "fwd_acceleration", "solve", "sensor_acc"):
            data = getattr(mjx(), stage)(body.model, data)
        data = integrate(body.model, data)
        return ({name: getattr(data, name) for name in physics}, ctrl, memory), None

    # MJX mixes ranks and dtypes on purpose; a caller may have forbidden that for its own code.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        ctrl = jnp.zeros(body.model.nu, physics["qpos"].dtype)
        steps = jnp.arange(periods * body.steps)
        (physics, _, memory), _ = jax.lax.scan(step, (physics, ctrl, memory), steps)
    return physics, memory


def _control(body: ArticulatedBody, command: Array, data: Any, memory: PyTree) -> tuple[Array, PyTree]:
    """Control and memory of the user's controller, checked."""
    controller = body.controller
    result = user_calls.call("controller", controller, "command, data, memory", command, data, memory)
    if not isinstance(result, tuple) or len(result) != 2:
        expected = "a control and a memory"
        cure = "return both, and () as the memory if there is none"
        raise user_calls.wrong("controller", controller, user_calls.describe(result), expected, cure)
    ctrl, new_memory = result
    user_calls.check_array("controller", controller, ctrl, float, (body.model.nu,), "give a number for each actuator")
    user_calls.check_like("controller", controller, new_memory, memory, "a memory that is")
    return ctrl.astype(data.ctrl.dtype), jax.tree.map(_strong, new_memory)


def _on_floor(robot: Robot) -> dict[str, Array]:
    """The fields of ``mjx.Data`` with the pose and the speeds on the floor that ``Robot`` has."""
    physics = robot.drive_state.physics
    qpos = physics["qpos"]
    qvel = physics["qvel"]
    rotation = _rotation(qpos[3:7])
    old_heading = _ahead(rotation)
    heading = unit_vectors(robot.heading, jnp.asarray([1.0, 0.0], qpos.dtype))
    quaternion = _turn_quaternion(qpos[3:7], old_heading, heading)

    # The velocity in the world, and the angular velocity in the body's frame about the vertical.
    sideways = robot.sideways
    if sideways is None:
        _, sideways = rotate(qvel[0], qvel[1], old_heading[0], -old_heading[1])
    velocity = jnp.stack(rotate(robot.speed, sideways, heading[0], heading[1]))
    vertical = rotation[2]
    angular = qvel[3:6] + vertical * (robot.turn_rate - vertical @ qvel[3:6])

    qpos = jnp.concatenate([robot.position, qpos[2:3], quaternion, qpos[7:]])
    qvel = jnp.concatenate([velocity, qvel[2:3], angular, qvel[6:]])
    return {**physics, "qpos": qpos, "qvel": qvel}


def _turn_quaternion(quaternion: Array, old_heading: Array, heading: Array) -> Array:
    """The quaternion (w, x, y, z) after a turn about the vertical from one heading (2,) to another."""
    cross = old_heading[0] * heading[1] - old_heading[1] * heading[0]
    dot = old_heading[0] * heading[0] + old_heading[1] * heading[1]
    half = 0.5 * jnp.arctan2(cross, dot)
    cosine = jnp.cos(half)
    sine = jnp.sin(half)
    w, x, y, z = quaternion
    return jnp.stack([cosine * w - sine * z, cosine * x - sine * y, cosine * y + sine * x, cosine * z + sine * w])


def _ahead(rotation: Float[Array, "3 3"]) -> Float[Array, "2"]:
    """The direction of the base's x axis on the floor."""
    return unit_vectors(rotation[:2, 0], jnp.asarray([1.0, 0.0], rotation.dtype))


def _rotation(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """The rotation matrix of a quaternion (w, x, y, z)."""
    w, x, y, z = quaternion / jnp.linalg.norm(quaternion)
    return jnp.stack([
        jnp.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)]),
        jnp.stack([2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)]),
        jnp.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)]),
    ])  # fmt: skip
