"""A trained network as a driver: it sees, plans and drives inside the simulator, under ``jit`` and ``vmap``.

Its memory holds what the depth camera saw in the last four seconds, as the network's own encodings, of which it looks
at those that are 0 to 4 s old: just what an example has. The latest decision is in it as well, so that after each step
``state.driver.decision`` tells the local plan and where the attention lay, as SEAN shows them.
"""

import functools
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from sean_jax import files, navigation, sensors
from sean_jax.base import Array, Driver, Scenario, State
from sean_jax.learning.examples import SECONDS
from sean_jax.learning.manifests import CONFIG, read_trained
from sean_jax.learning.network import Decision, Network
from sean_jax.learning.options import Refused
from sean_jax.learning.rows import depth_image, plan_ahead


@struct.dataclass
class Weights:
    """What was learned."""

    parameters: Any  # of the network
    scale: Array  # (2,) m/s, rad/s: the network's command of 1


@struct.dataclass
class Brain:
    """A driver's data."""

    weights: Weights
    network: Network = struct.field(pytree_node=False)
    eye: sensors.Camera = struct.field(pytree_node=False)


@struct.dataclass
class Memory:
    """A driver's memory of its episode."""

    seen: Array  # (L, F) what each of the last images showed, the newest first, one a step of control
    last: Array  # (V,) int32, ``navigation.bend_to_goal``
    decision: Decision  # the latest; zeros before the first step


def driver(network: Network, weights: Weights, scenario: Scenario, name: str = "learned") -> Driver:
    """A driver for the robot of that scenario: hand it to ``rollout`` as a policy."""
    height, width = network.image
    eye = sensors.camera(scenario, "depth", width=width, height=height)
    return Driver(data=Brain(weights, network, eye), name=name, start=start, drive=drive)


def start(scenario: Scenario, data: Brain, state: State) -> Memory:
    """The memory of who has only seen what is there now."""
    seen = _see(scenario, data, state)
    ticks = round(1.0 / scenario.time_step)
    network = data.network
    none = Decision(
        local_plan=jnp.zeros((SECONDS, 2), jnp.float32),
        command=jnp.zeros(2, jnp.float32),
        planner_attention=jnp.zeros(len(network.planner_sources), jnp.float32),
        controller_attention=jnp.zeros(len(network.controller_sources), jnp.float32),
    )
    return Memory(
        seen=jnp.broadcast_to(seen[None], ((SECONDS - 1) * ticks + 1, *seen.shape)),
        last=navigation.bend_to_goal(scenario.navigation, state.task.goal),
        decision=none,
    )


def drive(scenario: Scenario, data: Brain, state: State, key: Array) -> tuple[Array, Memory]:
    """A trained network: the command, and what it looked at."""
    memory: Memory = state.driver
    seen = jnp.concatenate([_see(scenario, data, state)[None], memory.seen[:-1]])
    each_second = seen[:: round(1.0 / scenario.time_step)][::-1]
    plan = plan_ahead(scenario, state, memory.last).astype(jnp.float32)  # as networks are, whatever drives people
    weights = data.weights
    inputs = each_second, plan, state.situations
    answer: Any = data.network.apply(weights.parameters, *inputs, method="decide")
    decision = in_units(answer, weights.scale)
    return decision.command, Memory(seen, memory.last, decision)


def in_units(decision: Decision, scale: Array) -> Decision:
    """The network's decision, with the command in m/s and rad/s."""
    return replace(decision, command=decision.command * scale)


def _see(scenario: Scenario, data: Brain, state: State) -> Any:
    """(F,) what the network makes of the depth image of now."""
    return data.network.apply(data.weights.parameters, depth_image(scenario, state, data.eye), method="see")


def load(folder: Path | str, scenario: Scenario) -> Driver:
    """The driver that a training in that folder has made: the best so far, by its loss in validation.

    Raises Refused if there is none, or if it was made for other situations or another rate than the scenario's.
    """
    from sean_jax.learning.checkpoints import Checkpoints

    folder = Path(folder)
    network, situations = trained(folder, [name for name, _ in scenario.situations])
    abstract = jax.eval_shape(functools.partial(initial, network, situations), jax.random.key(0))
    weights = Checkpoints(folder).best_weights(abstract)
    return driver(network, weights, scenario, name=folder.name)


def trained(folder: Path, situations: list[str]) -> tuple[Network, int]:
    """The network that was trained in that folder, and the number of situations that it was trained with.

    Raises Refused if there is none, or if it is told of other situations than these.
    """
    if not os.path.lexists(folder / CONFIG):
        raise Refused(f"{folder} has no trained network; make one with `sean train imitation`.")
    try:
        config = read_trained(folder / CONFIG)
    except files.FileError as error:
        raise Refused(str(error)) from None
    network = Network(config.width, config.flags, config.image)
    if network.flags and situations != config.situations:
        here = ", ".join(situations)
        raise Refused(f"the network of {folder} knows other situations than {here}; give make the same situations.")
    return network, len(config.situations)


def initial(network: Network, situations: int, key: Array) -> Weights:
    """Weights before training; the scale of the command is 1."""
    shapes = ((SECONDS, *network.image), jnp.uint16), ((10, 2), jnp.float32), ((situations,), bool)
    parameters = network.init(key, *(jnp.zeros(*shape) for shape in shapes))
    return Weights(parameters, jnp.ones(2, jnp.float32))
