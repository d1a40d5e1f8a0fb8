"""Agents of reinforcement learning as small folders: ``config.json`` and ``weights.npz``, read without other packages.

``sean export agent`` packs the best agent of a training into such a folder. Those that come with the package lie beside
this file, and their names stand wherever that of a policy can (``sean run --policy ppo``). Weights are kept in 16 bits,
which changes a command by about a thousandth; the statistics of the observation, whose range is wider, in 32.
"""

import io
import json
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from sean_jax import components, files, registry, writing
from sean_jax.base import Scenario
from sean_jax.config import METHODS, ReinforcementConfig, present_names, validate
from sean_jax.errors import InputError
from sean_jax.learning.actor_critic import ActorCritic, Agent, init_agent
from sean_jax.learning.manifests import CONFIG, read_method
from sean_jax.mdp import observations
from sean_jax.mdp.spaces import Dict
from sean_jax.scenario import reset

WEIGHTS = "weights.npz"
STATISTICS = "statistics/"  # names of arrays that are kept in 32 bits begin so
MAX_BYTES = 100_000_000  # of the weights

AGENTS: dict[str, Path] = {
    folder.name: folder for folder in sorted(Path(__file__).parent.iterdir()) if (folder / WEIGHTS).is_file()
}
"""name -> folder of the agents that come with the package"""


def is_packed(folder: Path) -> bool:
    """Whether a folder holds a packed agent, and no training.

    Returns:
        True or False.
    """
    return (folder / WEIGHTS).is_file()


def read_options(folder: Path) -> ReinforcementConfig:
    """What the agent in a folder was trained as.

    Args:
        folder: of a training, or of a packed agent.

    Raises:
        InputError: there is none, or this version does not know it.
    """
    if not (folder / CONFIG).is_file():
        raise InputError(f"{folder} has no trained agent; make one with `sean train ppo --out {folder}`.")
    saved, model = files.read_json(folder / CONFIG), METHODS[read_method(folder)]
    if not issubclass(model, ReinforcementConfig):
        raise InputError(f"{folder} has a network that imitates, and no agent; train one with `sean train ppo`.")
    told = {name: value for name, value in present_names(saved).items() if name in model.model_fields}
    told = components.recorded(folder / CONFIG, told, saved.get("parts"), "parts")
    try:
        return validate(model, told, source=folder / CONFIG)
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from None


def terms(options: ReinforcementConfig) -> tuple[observations.Terms, observations.Terms]:
    """What an agent sees.

    Returns:
        The terms that the actor sees, and those that the critic sees besides.

    Raises:
        InputError: there is no term of a name, or the critic's are images or the actor's.
    """
    seen = registry.observation_terms(options.observations)
    private = registry.observation_terms(options.critic, "critic")
    for name, term in private:
        if term.image or name in dict(seen):
            why = "is an image" if term.image else "is what the actor sees already"
            raise InputError(f"critic: {name} {why}; choose another term.")
    return seen, private


def network(options: ReinforcementConfig, space: Dict) -> ActorCritic:
    """The network of a description."""
    seen, private = terms(options)
    images = tuple(name for name, term in seen if term.image)
    hidden = sum(math.prod(dict(space.items())[name].shape) for name, _ in private)
    return ActorCritic(
        options.width, options.layers, images, options.recurrent, hidden, options.bfloat16, options.careful
    )


def outline(options: ReinforcementConfig, scenario: Scenario) -> tuple[ActorCritic, Agent, observations.Terms]:
    """The agent of a description, without its numbers.

    Returns:
        The network, shapes and types of the agent, and the terms that the actor sees.

    Raises:
        InputError: the scenario lacks something that the agent sees.
    """
    seen, private = terms(options)
    everything = (*seen, *private)
    shapes = jax.eval_shape(lambda scenario: reset(scenario, jax.random.key(0)), scenario)
    space = observations.space(everything, scenario, shapes)
    actor_critic = network(options, space)
    return actor_critic, jax.eval_shape(lambda: init_agent(actor_critic, everything, space, jax.random.key(0))), seen


def check_sizes(folder: Path, options: ReinforcementConfig, saved: PyTree, expected: Agent) -> None:
    """Refuse an agent that sees something else than a scenario shows.

    Args:
        saved: name -> shape of each of its arrays, as of ``shapes``.
        expected: as of ``outline``.

    Raises:
        InputError: the shapes differ.
    """
    wanted = shapes(expected)
    if saved == wanted:
        return
    mean = f"{STATISTICS}mean"
    seen, shown = (name.get(mean, (0,))[0] for name in (saved, wanted))
    what = f"{seen} numbers, and this scenario shows {shown}"
    if seen == shown:
        what = "images of another size than this scenario's"
    named = ", ".join(part.kind for part in options.observations)
    raise InputError(
        f"{folder}: its agent sees {what} ({named}); make the scenario with what it was trained in (its {CONFIG})."
    )


def shapes(agent: PyTree) -> dict[str, tuple[int, ...]]:
    """The shapes of an agent.

    Args:
        agent: its arrays, or what stands for them.

    Returns:
        Name of an array, such as statistics/mean, to its shape.
    """
    return {name: tuple(leaf.shape) for name, leaf in _named(agent).items()}


def save(folder: Path, agent: Agent, config: dict[str, Any]) -> None:
    """Write an agent into a folder that is there.

    Args:
        config: of its training, and whatever else shall be known of it, as JSON can hold.

    Raises:
        InputError: a number is not finite, or too large for 16 bits.
    """
    packed = {}
    for name, leaf in _named(agent).items():
        kind = np.float32 if name.startswith(STATISTICS) else np.float16
        if not (np.abs(leaf) <= np.finfo(kind).max).all():
            raise InputError(f"{name} of the agent has a number that 16 bits cannot hold; train it anew.")
        packed[name] = np.asarray(leaf, kind)
    stream = io.BytesIO()
    np.savez_compressed(stream, **packed)
    writing.write(folder / WEIGHTS, stream.getvalue())
    writing.write(folder / CONFIG, json.dumps(config, indent=1) + "\n")


def load(folder: Path, scenario: Scenario) -> tuple[ActorCritic, Agent, observations.Terms]:
    """A packed agent.

    Args:
        folder: as ``save`` wrote it.

    Returns:
        The network, the agent, and the terms of its observation.

    Raises:
        InputError: its observations are not of the sizes of the scenario's, or a file cannot be read.
    """
    options = read_options(folder)
    try:
        actor_critic, expected, seen = outline(options, scenario)
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from None
    return actor_critic, restore(folder, options, expected), seen


def restore(folder: Path, options: ReinforcementConfig, expected: Agent) -> Agent:
    """The numbers of a packed agent.

    Args:
        folder: as ``save`` wrote it.
        expected: an agent of the shapes that it must have.

    Returns:
        The agent, in 32 bits.

    Raises:
        InputError: it has other shapes, or cannot be read.
    """
    found = files.read_arrays(folder / WEIGHTS, MAX_BYTES, "get the file anew")
    for name, value in found.items():
        if value.dtype.kind != "f" or not np.isfinite(value).all():
            raise InputError(f"{folder / WEIGHTS}: {name[:60]} has what is no finite number; pack the agent anew.")
    check_sizes(folder, options, {name: value.shape for name, value in found.items()}, expected)
    leaves = [jnp.asarray(found[name], jnp.float32) for name in _named(expected)]
    return jax.tree.unflatten(jax.tree.structure(expected), leaves)


def described(folder: Path) -> str:
    """A packed agent in a sentence.

    Args:
        folder: as ``save`` wrote it.

    Returns:
        What it sees, and where and how long it was trained.
    """
    options, saved = read_options(folder), files.read_json(folder / CONFIG)
    sees, steps = ", ".join(part.kind for part in options.observations), saved.get("agent", {}).get("steps")
    trained = f" on {steps:,} steps" if isinstance(steps, int) else ""
    return f"Agent of reinforcement learning, trained{trained} in {', '.join(options.environments)}; it sees {sees}."


def _named(agent: PyTree) -> dict[str, Any]:
    """The leaves by their paths."""
    leaves, _ = jax.tree.flatten_with_path(agent)
    return {jax.tree_util.keystr(path, simple=True, separator="/"): leaf for path, leaf in leaves}
