"""A trained network as a policy that drives in the simulator, under ``jit`` and ``vmap`` (section V-C).

The policy state holds the encodings of the depth images of the last four seconds. The network receives those that are
4, 3, 2, 1 and 0 s old, as in an example. The policy state also holds the latest decision, so after each step
``state.policy_state.decision`` has the local plan and the attention, which SEAN displays too.
"""

import functools
from dataclasses import replace
from pathlib import Path
from typing import cast

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax import navigation, sensors
from sean_jax.base import Array, Policy, Scenario, State
from sean_jax.errors import InputError
from sean_jax.learning.checkpoints import Checkpoints
from sean_jax.learning.examples import SECONDS, depth_image, plan_ahead
from sean_jax.learning.manifests import read_method
from sean_jax.learning.network import Decision, Network, Weights, init_weights, read_network


@struct.dataclass
class PolicyParams:
    """Parameters of the policy: the weights are leaves, so ``grad`` and ``vmap`` reach them."""

    weights: Weights
    network: Network = struct.field(pytree_node=False)
    camera: sensors.Camera = struct.field(pytree_node=False)


@struct.dataclass
class PolicyState:
    """What the policy remembers of an episode."""

    encodings: Array  # (L, F) of the images of the last 4 s, newest first, one for each control step
    last_arc: Array  # (V,) int32, ``navigation.last_arc_to_goal``
    decision: Decision  # the latest; zeros before the first step


def policy(network: Network, weights: Weights, scenario: Scenario, name: str = "learned") -> Policy:
    """Make a policy of a network, for the robot of a scenario.

    Returns:
        A policy for ``rollout``.

    Raises:
        InputError: the robot has no depth camera.
    """
    height, width = network.image
    camera = sensors.camera(scenario, "depth", width=width, height=height)
    return Policy(params=PolicyParams(weights, network, camera), name=name, init=init, apply=apply)


def load(folder: Path | str, scenario: Scenario) -> Policy:
    """Load the policy with the lowest validation loss so far; of a training in rounds, that of the last round.

    Args:
        folder: the folder that ``sean train`` has written, or is writing.

    Raises:
        InputError: the folder has no trained network, or one that receives the flags of other social situations.
        IncompleteError: the checkpoint cannot be read.
    """
    name, folder = Path(folder).name, _last_round(Path(folder))
    network, situations = read_network(folder, [each for each, _ in scenario.situations])
    shapes = jax.eval_shape(functools.partial(init_weights, network, situations), jax.random.key(0))
    weights = Checkpoints(folder).best("weights", shapes)
    return policy(network, weights, scenario, name=name)


def _last_round(folder: Path) -> Path:
    """The last network that ``sean train dagger`` has made in a folder; other folders as they are."""
    if read_method(folder) != "dagger":
        return folder
    rounds = [each for each in folder.glob("round-*") if (each / "checkpoints").is_dir()]
    if not rounds:
        raise InputError(f"{folder} has no trained network yet; go on with `sean train dagger`.")
    return max(rounds, key=lambda each: int(each.name.rpartition("-")[2]))


def init(scenario: Scenario, params: PolicyParams, state: State) -> PolicyState:
    """Begin an episode: the images before it are taken to be that of now."""
    encoding = _encode(scenario, params, state)
    ticks = round(1.0 / scenario.time_step)
    network = params.network
    decision = Decision(
        local_plan=jnp.zeros((SECONDS, 2), jnp.float32),
        command=jnp.zeros(2, jnp.float32),
        planner_attention=jnp.zeros(len(network.planner_sources), jnp.float32),
        controller_attention=jnp.zeros(len(network.controller_sources), jnp.float32),
    )
    return PolicyState(
        encodings=jnp.broadcast_to(encoding[None], ((SECONDS - 1) * ticks + 1, *encoding.shape)),
        last_arc=navigation.last_arc_to_goal(scenario.navigation, state.task.goal),
        decision=decision,
    )


def apply(scenario: Scenario, params: PolicyParams, state: State, key: Array) -> tuple[Float[Array, "2"], PolicyState]:
    """Drive one control step.

    Args:
        state: the state, with the policy state of the step before.

    Returns:
        (2,) m/s, rad/s, the command, and the new policy state.
    """
    before: PolicyState = state.policy_state
    encodings = jnp.concatenate([_encode(scenario, params, state)[None], before.encodings[:-1]])
    each_second = encodings[:: round(1.0 / scenario.time_step)][::-1]
    plan = plan_ahead(scenario, state, before.last_arc).astype(jnp.float32)  # networks are in 32 bits
    weights = params.weights
    inputs = each_second, plan, state.situations
    output = cast(Decision, params.network.apply(weights.parameters, *inputs, method="act"))
    decision = replace(output, command=output.command * weights.scale)
    return decision.command, PolicyState(encodings, before.last_arc, decision)


def _encode(scenario: Scenario, params: PolicyParams, state: State) -> Array:
    """(F,) encoding of the present depth image."""
    image = depth_image(scenario, state, params.camera)
    return cast(Array, params.network.apply(params.weights.parameters, image, method="encode"))
