"""Policies by a name, a folder, FILE.py:NAME, or as a value; trained networks and agents that drive.

Packed agents are small folders, ``config.json`` and ``weights.npz``, read with flax and numpy alone: ``sean export
agent`` writes them, and the package's agents are in ``agents/``, with names that work like names of policies.
Weights are stored in 16 bits, which changes a command by about a thousandth; the statistics of the observation, whose
range is wider, in 32. All policies run under ``jit`` and ``vmap``.
"""

import math
import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax import struct
from jaxtyping import Float, PyTree

from sean_jax import sensors
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.config import (
    METHODS,
    CollectConfig,
    Component,
    Named,
    ReinforcementConfig,
    RunConfig,
    ScenarioConfig,
    flags,
    outside,
    user_parts,
    validate,
)
from sean_jax.core import user_calls
from sean_jax.core.data_types import SENSING, Array, Policy, PolicyLike, RobotModel, Scenario, State, as_policy
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.io.versions import versions
from sean_jax.io.writing import check_new_folder
from sean_jax.learning import networks
from sean_jax.learning.networks import CONFIG, ActorCritic, Agent, AgentDescription, Best, ConvEncoder, NetworkOutput
from sean_jax.mdp import observations, registry, to_command
from sean_jax.mdp.spaces import Box
from sean_jax.policies import POLICIES
from sean_jax.robots.drive import require
from sean_jax.simulation import episodes, making, team
from sean_jax.simulation.scenario import reset


def load_policy(
    value: PolicyLike | Component | str, scenario: Scenario, option: str = "policy", *, typed: bool = False
) -> Policy:
    """The policy of a value.

    Args:
        value: a policy, a function, a name of ``POLICIES`` or ``AGENTS``, the folder of a training or a packed agent,
            FILE.py:NAME, or a description of these.
        typed: whether the user typed a value that is text, as of ``validate``.

    Raises:
        InputError: there is none of that name, or it does not fit the scenario.
        PartError: a policy of the user's own fails, as ``episodes.check_policy`` finds.
    """
    description = _description(value, typed=typed)
    if isinstance(description, Named) and description.kind not in POLICIES:
        return load(agent_folder(description.kind, option), scenario)
    part = user_parts.resolve(description, POLICIES, option)
    try:
        policy = as_policy(part)
    except TypeError as error:
        raise InputError(str(error)) from error
    if not isinstance(description, Named):
        if policy.sensing not in SENSING:
            raise InputError(
                f"{option}: sensing of {policy.name}, {policy.sensing!r:.40}, is not one of {', '.join(SENSING)}."
            )
        episodes.check_policy(scenario, policy)
    return policy


def load_policies(values: Sequence[PolicyLike | Component | str], scenario: Scenario) -> Policy:
    """The policy of one value; of several, the policy of a team of which each robot has its own (``load_policy``)."""
    policies = [load_policy(value, scenario) for value in values]
    return policies[0] if len(policies) == 1 else team.one_each(policies)


def load(folder: Path | str, scenario: Scenario) -> Policy:
    """The best policy of a training so far, a packed agent, or one that comes with the package.

    Args:
        folder: that ``sean train`` or ``sean export agent`` has written, or is writing; as text also a name of
            ``AGENTS``, unless an agent's folder of that name is here, too.

    Raises:
        InputError: the folder has no trained network, or one that does not fit the scenario.
        IncompleteError: the checkpoint cannot be read.
    """
    if isinstance(folder, str) and folder in AGENTS:
        folder = agent_folder(folder, "folder")
    folder = Path(folder)
    return agent_policy(*load_agent(folder, scenario), name=folder.name)


def check_policy(
    value: PolicyLike | Component | str, config: ScenarioConfig, option: str = "policy", *, typed: bool = False
) -> None:
    """Refuse what ``load_policy`` refuses, as far as no scenario is needed to know it.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    description = _description(value, typed=typed)
    if not isinstance(description, Named):
        part = user_parts.resolve(description, {}, option)
        if not (isinstance(part, Policy) or callable(part)):
            raise InputError(f"{option}: {description.kind} must be a Policy or a function (scenario, state, key).")
    elif description.kind not in POLICIES:
        folder = agent_folder(description.kind, option)
        method = networks.read_method(folder)
        if issubclass(METHODS[method], ReinforcementConfig):
            agent_terms(read_options(folder))
        if method != "imitation":
            return
        sets = [part.kind for part in config.situations if isinstance(part, Named)]
        if len(sets) == len(config.situations) == 1 and sets[0] in SITUATION_SETS:
            imitation_config(folder, list(SITUATION_SETS[sets[0]]))


def _description(value: Any, *, typed: bool) -> Component:
    return value if isinstance(value, Component) else validate(RunConfig, {"policy": value}, typed=typed).policy


def agent_folder(name: str, option: str) -> Path:
    """The folder of an agent of the package, or of one's own; a name that may mean both is refused."""
    if outside(Named(kind=name)):
        raise InputError(
            f"{option}: {name} is a controller outside of this program; sean run and sean benchmark take it."
        )
    path = Path(name)
    if name in AGENTS:
        if (path / CONFIG).is_file():
            raise InputError(
                f"{option}: '{name}' is an agent of the package and a folder here; write ./{name} for the folder, "
                f"{AGENTS[name]} for the other."
            )
        return AGENTS[name]
    if not path.is_dir():
        known = [*POLICIES, *AGENTS]
        cure = files.suggest(name, known) or ", nor is it a folder that `sean train` has written."
        raise InputError(f"{option}: '{name}' is not one of {', '.join(known)}{cure}")
    return path


# ------------------------------------------------------------------ agents, packed and in trainings

WEIGHTS = "weights.npz"
STATISTICS = "statistics/"  # prefix of names of arrays in 32 bits
MAX_WEIGHTS_BYTES = 100_000_000  # of the weights

AGENTS: dict[str, Path] = {
    file.parent.name: file.parent for file in sorted((Path(__file__).parent / "agents").glob(f"*/{WEIGHTS}"))
}
"""name -> folder of the agents that come with the package"""


def is_packed(folder: Path) -> bool:
    """Whether a folder holds a packed agent, and no training."""
    return (folder / WEIGHTS).is_file()


def read_options(folder: Path) -> ReinforcementConfig:
    """The options with which the agent in a folder was trained, of a training or packed.

    Raises:
        InputError: there is none, or this version does not know it.
    """
    if not (folder / CONFIG).is_file():
        raise InputError(f"{folder} has no trained agent; make one with `sean train ppo --out {folder}`.")
    saved = files.read_json(folder / CONFIG)
    model = METHODS[networks.read_method(folder)]
    if not issubclass(model, ReinforcementConfig):
        raise InputError(f"{folder} has a network that imitates, and no agent; train one with `sean train ppo`.")
    options = {name: value for name, value in saved.items() if name in model.model_fields}
    options = user_parts.recorded(folder / CONFIG, options, saved.get("parts"), "parts")
    try:
        return validate(model, options, source=folder / CONFIG)
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from None


def agent_terms(options: ReinforcementConfig) -> tuple[observations.Terms, observations.Terms]:
    """The observation terms of the actor, and the critic's further ones.

    Raises:
        InputError: there is no term of a name, the critic's are images or the actor's, or the network is none for them.
    """
    actor_terms = registry.observation_terms(options.observations)
    private = registry.observation_terms(options.critic, "critic")
    for name, term in private:
        if term.image:
            raise InputError(f"critic: {name} is an image; choose another term.")
        if name in dict(actor_terms):
            raise InputError(f"critic: {name} is already an observation of the actor; choose another term.")
    _encoder(options, actor_terms)
    return actor_terms, private


def agent_network(options: ReinforcementConfig, space: dict[str, Box]) -> ActorCritic:
    """The network of a description.

    Raises:
        InputError: there is none of that name, or it does not fit the observations.
        PartError: a network of the user's own does not take them, or gives no features.
    """
    actor_terms, private = agent_terms(options)
    images = tuple(name for name, term in actor_terms if term.image)
    parts = tuple((name, space[name].shape) for name, term in actor_terms if not term.image)
    people = tuple(name for name, term in actor_terms if term.people and not term.image)
    network = ActorCritic(
        width=options.width,
        layers=options.layers,
        images=images,
        recurrent=options.recurrent,
        private=sum(math.prod(space[name].shape) for name, _ in private),
        bfloat16=options.bfloat16,
        squashed=options.distribution == "squashed",
    )
    encoder = _encoder(options, actor_terms)
    if encoder is None:
        return network
    if isinstance(encoder, nn.Module):
        networks.check_encoder(encoder, {**dict(parts), **{name: space[name].shape for name in images}})
    else:
        encoder = encoder(options.width, images, people, network.image_dtype)
    return network.clone(encoder=encoder, parts=parts, raw=() if isinstance(encoder, ConvEncoder) else people)


def _encoder(options: ReinforcementConfig, terms: observations.Terms) -> Any:
    """A value of ``NETWORKS``, or the user's flax module, made without arguments if it is a class.

    Raises:
        InputError: there is none, it is no module, or it does not fit the observations.
    """
    value = user_parts.resolve(options.network, networks.NETWORKS, "network")
    name = options.network.label
    if isinstance(options.network, Named):
        if name == "conv" and not any(term.image for _, term in terms):
            raise InputError("network: conv is for images, and none is observed; add one, such as depth, or take mlp.")
        crowds = [term.people for _, term in terms if not term.image]
        if name == "attention" and (not any(crowds) or all(crowds)):
            raise InputError("network: attention needs observations of people and others; add people or goal.")
        return value
    if isinstance(value, type) and issubclass(value, nn.Module):
        try:
            value = value()
        except TypeError as error:
            raise InputError(f"network: {name} cannot be made: {error}; give its fields defaults.") from error
    if not isinstance(value, nn.Module):
        raise InputError(
            f"network: {name} is {user_calls.describe(value)}, not a module of flax.linen; give a class, such as "
            "class Net(nn.Module)."
        )
    try:
        hash(value)
    except TypeError as error:
        raise InputError(f"network: {name} has a field that cannot be hashed; give a tuple for a list.") from error
    return value


def describe(folder: Path, scenario: Scenario) -> AgentDescription:
    """The network of a folder and what it observes of a scenario.

    Raises:
        InputError: there is no agent, the config.json cannot be read, or the scenario lacks something that it sees.
    """
    if is_imitation(folder):
        config = imitation_config(folder, [name for name, _ in scenario.situations])
        height, width = config.image
        sensors.camera(scenario, "depth", width=width, height=height)  # refuses a robot without one
        return networks.describe_imitation(config, scenario.time_step)

    options = read_options(folder)
    shapes = jax.eval_shape(lambda scenario: reset(scenario, jax.random.key(0)), scenario)
    try:
        actor_terms, private = agent_terms(options)
        space = observations.space((*actor_terms, *private), scenario, shapes)
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from None
    return AgentDescription(agent_network(options, space), actor_terms, private, space)


def is_imitation(folder: Path) -> bool:
    """Whether a folder has an agent that imitates demonstrations, and none that learned from rewards."""
    return not issubclass(METHODS[networks.read_method(folder)], ReinforcementConfig)


def imitation_config(folder: Path, situations: list[str]) -> networks.NetworkConfig:
    """The configuration of a network that imitates.

    Raises:
        InputError: there is none, or its input is the flags of other situations than these.
    """
    if not os.path.lexists(folder / CONFIG):
        raise InputError(f"{folder} has no trained network; make one with `sean train imitation`.")
    config = networks.read_network_config(folder / CONFIG)
    if config.flags and situations != config.situations:
        here = ", ".join(situations)
        raise InputError(f"the network of {folder} knows other situations than {here}; give make the same situations.")
    return config


def training_scenario(folder: Path) -> Scenario:
    """The scenario of a training or of its demonstrations, on its first floor and with its first robot.

    Raises:
        InputError: there is no agent, or its demonstrations are of another program.
    """
    if (folder / CONFIG).is_file() and is_imitation(folder):
        return making.build(making.plan_scenario(demonstration_config(folder)), 1)[0].member
    options = read_options(folder)
    user_parts.check_trust(options)
    return registry.build(options.per_environment[0], limit=1).member.scenario


def demonstration_config(folder: Path) -> CollectConfig:
    """The options of ``sean collect`` that made the demonstrations of an agent that imitates.

    Raises:
        InputError: another program made them.
    """
    content = files.read_json(folder / CONFIG)
    dataset = content.get("dataset", {}) if isinstance(content, dict) else {}
    words = shlex.split(str(dataset.get("command", "")))
    if words[:2] != ["sean", "collect"]:
        raise InputError(
            f"{folder / CONFIG}: its demonstrations were not made by `sean collect`; use `sean run` for it."
        )
    config = flags.read(CollectConfig, flags.parse("collect", CollectConfig, words[2:]))
    return validate(CollectConfig, config.model_dump(mode="json"), source=folder / CONFIG)


def load_agent(folder: Path, scenario: Scenario) -> tuple[ActorCritic, Agent, observations.Terms]:
    """The best agent of a training, or a packed agent: the network, the agent, and the terms of its observation.

    Raises:
        InputError: there is no agent, a file cannot be read, the robot is no differential drive, or the scenario lacks
            something that the agent sees.
        IncompleteError: the checkpoint cannot be read.
    """
    drivers = f"{folder.name}: networks" if is_imitation(folder) else f"{folder}: agents"
    require(scenario.robot, ("differential",), f"{drivers} drive")
    folder = last_round(folder)
    description = describe(folder, scenario)
    return description.network, read_agent(folder, description), description.terms


def last_round(folder: Path) -> Path:
    """The last network that ``sean train dagger`` has made in a folder; other folders as they are."""
    if is_packed(folder) or networks.read_method(folder) != "dagger":
        return folder
    rounds = [path for path in folder.glob("round-*") if (path / "checkpoints").is_dir()]
    if not rounds:
        raise InputError(f"{folder} has no trained network yet; resume it by `sean train dagger`.")
    return max(rounds, key=lambda path: int(path.name.rpartition("-")[2]))


def read_agent(folder: Path, description: AgentDescription) -> Agent:
    """The best agent of a training, or a packed agent, in 32 bits.

    Raises:
        InputError: it is not of this description, or has numbers that are not finite.
        IncompleteError: the checkpoint cannot be read.
    """
    outline = jax.eval_shape(description.init, jax.random.key(0))
    return (_read_packed if is_packed(folder) else _read_best)(folder, outline)


def _read_packed(folder: Path, outline: Agent) -> Agent:
    """The agent of weights.npz."""
    arrays = files.read_arrays(folder / WEIGHTS, MAX_WEIGHTS_BYTES, "get the file again")
    for name, value in arrays.items():
        if value.dtype.kind != "f" or not np.isfinite(value).all():
            raise InputError(f"{folder / WEIGHTS}: {name[:60]} has a number that is not finite; pack the agent anew.")
    _check_sizes(folder, {name: value.shape for name, value in arrays.items()}, outline)
    leaves = [jnp.asarray(arrays[name], jnp.float32) for name in networks.named_leaves(outline)]
    return jax.tree.unflatten(jax.tree.structure(outline), leaves)


def _read_best(folder: Path, outline: Agent) -> Agent:
    """The best agent of the checkpoints of a training."""
    from sean_jax.learning.checkpoints import Checkpoints  # which needs the extra "learning"

    checkpoints = Checkpoints(folder)
    shapes = checkpoints.shapes("best")
    saved = {}
    for name, shape in shapes.items():
        if name.startswith("agent/"):
            saved[name.removeprefix("agent/")] = shape[1:]
    _check_sizes(folder, saved, outline)

    # Checkpoints have the best of each agent that was trained in parallel.
    count = shapes.get("value", (1,))[0]
    outline = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((count, *leaf.shape), leaf.dtype), outline)
    values = jax.ShapeDtypeStruct((count,), jnp.float32)
    updates = jax.ShapeDtypeStruct((count,), jnp.int32)
    best = checkpoints.best("best", Best(outline, values, updates))  # pyright: ignore
    chosen = int(np.argmax(best.value))
    return jax.tree.map(lambda leaf: leaf[chosen], best.agent)


def _check_sizes(folder: Path, saved: dict[str, tuple], outline: Agent) -> None:
    """Refuse arrays, name -> shape, of other sizes than a scenario's observations need."""
    shapes = {name: tuple(leaf.shape) for name, leaf in networks.named_leaves(outline).items()}
    if saved == shapes:
        return
    if is_imitation(folder):
        raise InputError(f"{folder}: its weights are of another network; restore the {CONFIG} of its training.")
    options = read_options(folder)
    mean = f"{STATISTICS}mean"
    learned, present = (sizes.get(mean, (0,))[0] for sizes in (saved, shapes))
    if learned == present and options.network.kind != "mlp":
        raise InputError(
            f"{folder}: its weights are not those of the network {options.network.label}; restore the network of its "
            f"training (its {CONFIG})."
        )
    terms = ", ".join(part.kind for part in options.observations)
    if learned == present:
        raise InputError(
            f"{folder}: its agent sees images of another size than this scenario's ({terms}); make the scenario with "
            f"the options of its training (its {CONFIG})."
        )
    raise InputError(
        f"{folder}: its agent sees {learned} numbers, and this scenario shows {present} ({terms}); make the scenario "
        f"with the options of its training (its {CONFIG})."
    )


def save_agent(folder: Path, agent: Agent, config: dict[str, Any]) -> None:
    """Write an agent into a folder that exists, with the ``config`` of its training and anything else JSON can hold.

    Raises:
        InputError: a number is not finite, or too large for 16 bits.
    """
    packed = {}
    for name, leaf in networks.named_leaves(agent).items():
        kind = np.float32 if name.startswith(STATISTICS) else np.float16
        if not (np.abs(leaf) <= np.finfo(kind).max).all():
            raise InputError(f"{name} of the agent has a number that 16 bits cannot hold; train it again.")
        packed[name] = np.asarray(leaf, kind)
    writing.write_arrays(folder / WEIGHTS, packed)
    writing.write(folder / CONFIG, config)


def describe_agent(folder: Path) -> str:
    """The observations and the training of a packed agent, in a sentence."""
    saved = files.read_json(folder / CONFIG)
    if is_imitation(folder):
        size = " x ".join(map(str, saved["image"]))
        return f"Network that imitates demonstrations; it sees depth images of {size} pixels and the global plan."
    options = read_options(folder)
    sees = ", ".join(part.kind for part in options.observations)
    steps = saved.get("agent", {}).get("steps")
    trained = f" on {steps:,} steps" if isinstance(steps, int) else ""
    return f"Agent of reinforcement learning, trained{trained} in {', '.join(options.environments)}; it sees {sees}."


def pack(folder: Path | str, out: Path | str) -> Path:
    """Write the best agent of a training into a new or empty folder ``out``.

    The user's files in the training's options, and the modules that they import, are copied into its ``parts``.

    Raises:
        InputError: there is no agent.
        WriteError: the folder cannot be written.
        IncompleteError: the checkpoint cannot be read.
    """
    folder = Path(folder)
    out = Path(out)
    check_new_folder(out)
    if is_packed(folder):
        raise InputError(f"{folder} is packed already; copy it.")
    imitates = is_imitation(folder) and (folder / CONFIG).is_file()
    folder = last_round(folder) if imitates else folder
    options = None if imitates else read_options(folder)
    if imitates:  # its sizes do not depend on a scenario
        description = networks.describe_imitation(networks.read_network_config(folder / CONFIG), time_step=1.0)
    else:
        description = describe(folder, training_scenario(folder))
    agent = read_agent(folder, description)
    facts = {**_best_evaluation(folder), "weights": "float16", "packed_with": versions()}
    with writing.atomic_folder(out) as target:
        own = {}
        if options is not None:
            code = user_parts.input_files(options)
            hashes = code.bundle(target)
            own = code.describe(options.identity()) | {"parts": hashes} if hashes else {}
        save_agent(target, agent, {**files.read_json(folder / CONFIG), **own, "agent": facts})
    return out


def _best_evaluation(folder: Path) -> dict[str, Any]:
    """Number of steps of the best agent, and its evaluation over all situations."""
    from sean_jax.learning.trainer import read_metrics

    evaluations = [
        (part["return"], line, part)
        for line in read_metrics(folder)
        for name, part in line.items()
        if name == "evaluation" or name.startswith("agent ")  # one of several may be better than all on average
    ]
    if not evaluations:
        return {}
    _, best, part = max(evaluations, key=lambda each: (each[0], each[1]["epoch"]))
    figures = {name: value for name, value in part.items() if " in " not in name}
    return {"updates": best["epoch"], "steps": best["steps"], "evaluation": figures}


# ------------------------------------------------------------------ agents that drive


@struct.dataclass
class AgentParams:
    """Parameters of the policy: the agent's are leaves, so ``grad`` and ``vmap`` reach them."""

    agent: Agent
    network: ActorCritic = struct.field(pytree_node=False)
    terms: observations.Terms = struct.field(pytree_node=False)


@struct.dataclass
class AgentState:
    """The memory of the policy."""

    observed: PyTree  # of ``observations.observe``
    memory: Float[Array, "M"]  # of the network
    start: Array  # () bool, before the first step
    auxiliary: dict[str, Array]  # latest further outputs of the network, such as local_plan; zeros before the first


def agent_policy(network: ActorCritic, agent: Agent, terms: observations.Terms, name: str = "agent") -> Policy:
    """A policy of an agent: the mean of its actions.

    Its state holds the memory of the observation, so that delays and stacks are as in training, and the network's.
    After each step ``state.policy_state.auxiliary`` has the local plan and the attention of a network that imitates,
    which SEAN displays too.
    """
    params = AgentParams(agent, network, terms)
    sensing = observations.sensing(terms)
    return Policy(params=params, name=name, init=_init_agent, apply=_apply_agent, sensing=sensing)


def _init_agent(scenario: Scenario, params: AgentParams, state: State) -> AgentState:
    """Begin an episode."""
    key = jax.random.fold_in(state.streams.policy, 2**31 - 1)  # above any tick
    observation, observed = observations.begin(params.terms, scenario, state, key)
    memory = jnp.zeros(params.network.memory_size, jnp.float32)
    start = jnp.ones((), bool)
    output = jax.eval_shape(_forward, params, observation, memory, start)
    auxiliary = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), output.auxiliary)
    return AgentState(observed, memory, start, auxiliary)


def _apply_agent(
    scenario: Scenario, params: AgentParams, state: State, key: Array
) -> tuple[Float[Array, "2"], AgentState]:
    """The command (2,) [m/s, rad/s] of a control step, and the new policy state; the key is not used."""
    before: AgentState = state.policy_state
    observation, observed = observations.observe(params.terms, scenario, state, before.observed)
    output = _forward(params, observation, before.memory, before.start)
    after = AgentState(observed, output.memory, jnp.zeros((), bool), output.auxiliary)
    action = output.mean.astype(state.robot.position.dtype)
    return command_of(scenario.robot, params.agent, action), after


def _forward(params: AgentParams, observation: dict[str, Array], memory: Array, start: Array) -> NetworkOutput:
    """The network's output for one observation."""
    network = params.network
    vector = observations.flatten(params.terms, observation).astype(jnp.float32)
    vector = jnp.pad(vector, (0, network.private))  # the critic's, which is not used
    images = {name: observation[name].astype(network.image_dtype) for name in network.images}
    return networks.apply(network, params.agent, vector, images, memory, start)


def command_of(robot: RobotModel, agent: Agent, action: Float[Array, "2"]) -> Float[Array, "2"]:
    """The command (2,) [m/s, rad/s] of an agent's action."""
    if agent.command_scale is None:
        return to_command(robot, action)
    return action * agent.command_scale.astype(action.dtype)


# ------------------------------------------------------------------ labels


NOISE_TIME = 0.5  # s, for which the noise of commands stays about the same: shorter ones hardly move the robot


@struct.dataclass
class LabelledState:
    """What driver and labeller remember of an episode, the noise, and the latest label."""

    driver: PyTree
    labeller: PyTree  # None without a labeller
    noise: Float[Array, "2"]  # of the robot's limits, in standard deviations
    label: Float[Array, "2"]  # m/s, rad/s


def labelled(driver: PolicyLike, labeller: PolicyLike | None = None, deviation: float | None = None) -> Policy:
    """A policy whose label is recorded instead of its command: the command of another policy, or that without noise.

    Args:
        labeller: whose command is the label; None: the driver, before the noise.
        deviation: of the noise with which commands reach the robot, as a share of the top speed and of the greatest
            turn rate; None: no noise.

    Source: S. Ross et al., "A reduction of imitation learning and structured prediction to no-regret online learning",
    AISTATS 2011; M. Laskey et al., "DART: Noise injection for robust imitation learning", CoRL 2017.
    """
    policy = as_policy(driver)
    noise = None if deviation is None else jnp.asarray(deviation, float)
    params = policy, noise, None if labeller is None else as_policy(labeller)
    return Policy(params=params, name=policy.name, init=_init_labelled, apply=_apply_labelled)


def label(state: State) -> Float[Array, "2"]:
    """The label (2,) [m/s, rad/s] of the step that led to a state, of a ``labelled`` policy."""
    return state.policy_state.label


def _init_labelled(scenario: Scenario, params: tuple, state: State) -> LabelledState:
    driver, _, labeller = params
    memory = None if labeller is None else labeller.init(scenario, labeller.params, state)
    return LabelledState(driver.init(scenario, driver.params, state), memory, jnp.zeros(2, float), jnp.zeros(2, float))


def _apply_labelled(
    scenario: Scenario, params: tuple, state: State, key: Array
) -> tuple[Float[Array, "2"], LabelledState]:
    driver, deviation, labeller = params
    memory = state.policy_state
    other_key = jax.random.fold_in(key, 1)
    command, driving = episodes.command(scenario, driver, replace(state, policy_state=memory.driver), key)
    label = command
    labelling = None
    noise = memory.noise
    if deviation is not None:
        stays = math.exp(-scenario.time_step / NOISE_TIME)
        fresh = jax.random.normal(other_key, (2,), noise.dtype)
        noise = stays * noise + math.sqrt(1.0 - stays * stays) * fresh
        limits = jnp.stack([scenario.robot.max_speed, scenario.robot.max_turn_rate]).astype(command.dtype)
        command = command + deviation * limits * noise
    if labeller is not None:
        labelling_state = replace(state, policy_state=memory.labeller)
        label, labelling = episodes.command(scenario, labeller, labelling_state, other_key)
    return command, LabelledState(driving, labelling, noise, label)
