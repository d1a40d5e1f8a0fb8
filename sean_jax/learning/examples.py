"""Rows and examples of demonstrations (section V-B), and what a network observes of them.

A **row** is recorded once a second, or at a higher rate. An **example** consists of rows one second apart, so that
the store holds a depth image once and not five times.

The paper's example has 5 depth images, a local plan of 5 points of the expert's most recent trajectory, 10 points of
the global plan and a flag for each situation, at 1 Hz. The network of [50] *predicts* the local plan. The most recent
trajectory at the end of five seconds lay ahead at their beginning, so the local planner's target is the places of the
next five seconds, in the robot's present frame. The places of the past five seconds are part of the example as well.
"""

import dataclasses
from types import ModuleType

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int, UInt16

from sean_jax import sensors
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.geometry import rotate
from sean_jax.mdp import observations
from sean_jax.mdp.observations import OBSERVATIONS, UNBOUNDED, ObservationTerm, plan_ahead

SECONDS = 5  # of depth images, and of the local plan
MILLIMETRES = 1000.0  # in a metre
MAX_DEPTH = 65.535  # m, the largest that a depth image holds
DEPTH_IMAGES, PLAN, SITUATIONS = "depth_images", "plan", "situations"  # terms of the network's observation


@struct.dataclass
class DemonstrationRow:
    """One moment of a demonstration. A whole recording has one leading axis, or two."""

    depth: Array  # (H, W) uint16 mm, along the direction of view; the camera's far limit where nothing is visible
    plan: Array  # (10, 2) m, the next points of the shortest path, in the robot's frame
    pose: Array  # (4,) m, m, then the unit vector of the heading
    velocity: Array  # (2,) m/s along the heading, rad/s
    command: Array  # (2,) m/s, rad/s, the command of the policy
    situations: Array  # (S,) bool


@struct.dataclass
class Recording:
    """Demonstrations, one after the other."""

    rows: DemonstrationRow  # (R, ...)
    first: Array  # (R,) int32, the first row of the episode of each row
    end: Array  # (R,) int32, one more than its last row
    rate: int = struct.field(pytree_node=False, default=1)  # rows a second


@struct.dataclass
class Example:
    """Inputs and targets of the network at one row."""

    images: Array  # (5, H, W) uint16 mm, oldest first, present last; before the episode's first row, that row's image
    plan: Array  # (10, 2) m, global plan in the robot's frame
    situations: Array  # (S,) bool
    past: Array  # (5, 2) m, where the robot was 5 to 1 s ago, in its present frame
    future: Array  # (5, 2) m, where it will be in 1 to 5 s: the target of the local planner
    future_valid: Array  # (5,) bool, whether the episode lasted until then
    command: Array  # (2,) m/s, rad/s, the target of the controller


def row(
    scenario: Scenario,
    state: State,
    command: Float[Array, "2"],
    camera: sensors.Camera,
    last_arc: Int[Array, "V"],
) -> DemonstrationRow:
    """The row of a state.

    Args:
        command: (2,) m/s, rad/s, of the policy in that state.
        last_arc: (V,) ``navigation.last_arc_to_goal`` of the goal of the task.
    """
    robot = state.robot
    return DemonstrationRow(
        depth=depth_image(scenario, state, camera),
        plan=plan_ahead(scenario, state, last_arc),
        pose=jnp.concatenate([robot.position, robot.heading]),
        velocity=jnp.stack([robot.speed, robot.turn_rate]),
        command=command,
        situations=state.situations,
    )


def depth_image(scenario: Scenario, state: State, camera: sensors.Camera) -> UInt16[Array, "H W"]:
    """A depth image (H, W) uint16 mm."""
    metres = sensors.depth(scenario, state, camera)
    return jnp.clip(jnp.round(MILLIMETRES * metres), 0.0, 65535.0).astype(jnp.uint16)


def in_metres(image: UInt16[Array, "*batch H W"]) -> Float[Array, "*batch H W"]:
    """Depth images (..., H, W) m in 32 bits, which networks have."""
    return image.astype(jnp.float32) / MILLIMETRES


@dataclasses.dataclass(frozen=True)
class DepthImage:
    """The robot's depth camera in whole millimetres, as demonstrations have it: (height, width) m."""

    height: int
    width: int

    def __call__(self, scenario: Scenario, state: State, prepared: tuple) -> Float[Array, "H W"]:
        """The reading, as ``ObservationTerm.read``."""
        camera = sensors.camera(scenario, "depth", width=self.width, height=self.height)
        return in_metres(depth_image(scenario, state, camera))


def observation_terms(image: tuple[int, int], situations: bool, time_step: float) -> observations.Terms:
    """What a network observes that imitates: five depth images a second apart, the global plan and, if asked for, the
    situations, as examples have them.

    Args:
        image: pixels, height and width of a depth image.
        time_step: s, of a control step.
    """
    images = ObservationTerm(
        DepthImage(*image), 0.0, MAX_DEPTH, stack=SECONDS, every=round(1.0 / time_step), image=True, sensing="raw"
    )
    plan = dataclasses.replace(OBSERVATIONS[PLAN], low=-UNBOUNDED, high=UNBOUNDED)
    terms = (DEPTH_IMAGES, images), (PLAN, plan)
    return (*terms, (SITUATIONS, OBSERVATIONS[SITUATIONS])) if situations else terms


def example(recording: Recording, index: Int[Array, "*batch"], xp: ModuleType = jnp) -> Example:
    """Examples of a recording at rows () or (B,); ``xp`` is ``numpy`` if the recording consists of numpy arrays."""
    rows = recording.rows
    first = recording.first[index][..., None]
    last = recording.end[index][..., None] - 1
    ages = xp.arange(SECONDS, dtype=xp.int32).reshape((1,) * (first.ndim - 1) + (SECONDS,))
    present = index[..., None]
    second = recording.rate  # in rows
    visible = xp.maximum(present + second * (ages - (SECONDS - 1)), first)
    before = xp.maximum(present + second * (ages - SECONDS), first)
    after = present + second * (1 + ages)
    pose = rows.pose[index]
    return Example(
        images=rows.depth[visible],
        plan=rows.plan[index],
        situations=rows.situations[index],
        past=in_frame(pose, rows.pose[before, :2], xp),
        future=in_frame(pose, rows.pose[xp.minimum(after, last), :2], xp),
        future_valid=after <= last,
        command=rows.command[index],
    )


def observation(terms: observations.Terms, examples: Example) -> dict[str, Array]:
    """The observation (B, ...) of examples (B, ...), as the ``observation_terms`` give it."""
    values = {
        DEPTH_IMAGES: in_metres(examples.images[:, ::-1]),  # newest first
        PLAN: examples.plan,
        SITUATIONS: examples.situations.astype(jnp.float32),
    }
    return {name: values[name] for name, _ in terms}


def in_frame(
    pose: Float[Array, "*batch 4"], places: Float[Array, "*batch K 2"], xp: ModuleType = jnp
) -> Float[Array, "*batch K 2"]:
    """Places (..., K, 2) m on the floor in the frame of a robot: x ahead and y to the left.

    Args:
        pose: (..., 4) m, m, and the unit vector of the heading.
        xp: ``numpy`` for numpy arrays.
    """
    dx, dy = places[..., 0] - pose[..., 0:1], places[..., 1] - pose[..., 1:2]
    return xp.stack(rotate(dx, dy, pose[..., 2:3], -pose[..., 3:4]), -1)


FITTING_TURNS = 500


def balanced_probabilities(situations: Bool[np.ndarray, "R S"]) -> Float[np.ndarray, "R"]:
    """Probabilities (R,) float32 under which all social situations (R, S) of examples are equally frequent.

    The paper suggests to train more on situations in which a policy does badly. Situations overlap, so an example
    cannot be drawn for one of them alone: each pass scales the probability of an example by how much its situations are
    short of an equal share. An example in several situations counts for each of them in equal parts. Examples in no
    situation keep their share, and situations that never occur are left out.

    Source: W. E. Deming and F. F. Stephan, "On a least squares adjustment of a sampled frequency table when the
    expected marginal totals are known", 1940.
    """
    flags = np.asarray(situations, np.float64)
    number = flags.sum(1)
    any_flag = number > 0
    if not any_flag.any():
        return np.full(len(flags), 1 / len(flags), np.float32)
    parts = flags[any_flag][:, flags.any(0)] / number[any_flag][:, None]
    fitted = np.ones(len(parts))
    for _ in range(FITTING_TURNS):
        share = fitted @ parts
        fitted = fitted * (parts @ (1.0 / np.maximum(share, 1e-12)))
        fitted = fitted / fitted.sum()
    probabilities = np.full(len(flags), 1.0 / len(flags))
    probabilities[any_flag] = fitted * any_flag.mean()
    return (probabilities / probabilities.sum()).astype(np.float32)
