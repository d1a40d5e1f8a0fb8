"""Policies by a name, a folder, FILE.py:NAME, or as a value; trained networks and agents that drive.

Packed agents are small folders, ``config.json`` and ``weights.npz``, read with flax and numpy alone: ``sean export
agent`` writes them, and the package's agents are in ``agents/``, with names that work like names of policies.
Weights are stored in 16 bits, which changes a command by about a thousandth; the statistics of the observation, whose
range is wider, in 32. All policies run under ``jit`` and ``vmap``.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax import struct
from jaxtyping import Float, Int, PyTree

from sean_jax import sensors
from sean_jax.classifiers import SITUATION_SETS
from sean_jax.config import (
    METHODS,
    Component,
    Named,
    ReinforcementConfig,
    RunConfig,
    ScenarioConfig,
    outside,
    user_parts,
    validate,
)
from sean_jax.core import user_calls
from sean_jax.core.data_types import SENSING, Array, Policy, PolicyLike, Scenario, State, as_policy
from sean_jax.core.errors import InputError
from sean_jax.io import files, writing
from sean_jax.io.versions import versions
from sean_jax.io.writing import check_new_folder
from sean_jax.learning import networks
from sean_jax.learning.examples import SECONDS, depth_image, plan_ahead
from sean_jax.learning.networks import CONFIG, ActorCritic, Agent, ConvEncoder, Decision, Network, Weights
from sean_jax.mdp import observations, registry, to_command
from sean_jax.mdp.spaces import Box
from sean_jax.policies import POLICIES
from sean_jax.robots.drive import require
from sean_jax.simulation import episodes, team
from sean_jax.simulation.scenario import reset
from sean_jax.world import navigation


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
    if not is_packed(folder) and networks.read_method(folder) in ("imitation", "dagger"):
        return load_imitation(folder, scenario)
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
            networks.read_network(folder, list(SITUATION_SETS[sets[0]]))


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
            both = f"'{name}' is an agent of the package and a folder here"
            raise InputError(f"{option}: {both}; write ./{name} for the folder, {AGENTS[name]} for the other.")
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
    saved, model = files.read_json(folder / CONFIG), METHODS[networks.read_method(folder)]
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
        if term.image or name in dict(actor_terms):
            why = "is an image" if term.image else "is already an observation of the actor"
            raise InputError(f"critic: {name} {why}; choose another term.")
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
    value, name = user_parts.resolve(options.network, networks.NETWORKS, "network"), options.network.label
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
        text = f"network: {name} is {user_calls.describe(value)}, not a module of flax.linen"
        raise InputError(f"{text}; give a class, such as class Net(nn.Module).")
    try:
        hash(value)
    except TypeError as error:
        raise InputError(f"network: {name} has a field that cannot be hashed; give a tuple for a list.") from error
    return value


def load_agent(folder: Path, scenario: Scenario) -> tuple[ActorCritic, Agent, observations.Terms]:
    """The best agent of a training, or a packed agent: the network, the agent, and the terms of its observation.

    Raises:
        InputError: there is no agent, a file cannot be read, the robot is no differential drive, or the scenario lacks
            something that the agent sees.
        IncompleteError: the checkpoint cannot be read.
    """
    require(scenario.robot, ("differential",), f"{folder}: agents drive")
    options = read_options(folder)
    shapes = jax.eval_shape(lambda scenario: reset(scenario, jax.random.key(0)), scenario)
    try:
        actor_terms, private = agent_terms(options)
        terms = (*actor_terms, *private)
        space = observations.space(terms, scenario, shapes)
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from None
    network = agent_network(options, space)
    outline = jax.eval_shape(lambda: networks.init_agent(network, terms, space, jax.random.key(0)))
    read = _read_packed if is_packed(folder) else _read_best
    return network, read(folder, options, outline), actor_terms


def _read_packed(folder: Path, options: ReinforcementConfig, outline: Agent) -> Agent:
    """The agent of weights.npz in 32 bits."""
    arrays = files.read_arrays(folder / WEIGHTS, MAX_WEIGHTS_BYTES, "get the file again")
    for name, value in arrays.items():
        if value.dtype.kind != "f" or not np.isfinite(value).all():
            raise InputError(f"{folder / WEIGHTS}: {name[:60]} has a number that is not finite; pack the agent anew.")
    _check_sizes(folder, options, {name: value.shape for name, value in arrays.items()}, outline)
    leaves = [jnp.asarray(arrays[name], jnp.float32) for name in networks.named_leaves(outline)]
    return jax.tree.unflatten(jax.tree.structure(outline), leaves)


def _read_best(folder: Path, options: ReinforcementConfig, outline: Agent) -> Agent:
    """The best agent of the checkpoints of a training."""
    from sean_jax.learning.checkpoints import Checkpoints  # which needs the extra "learning"

    checkpoints = Checkpoints(folder)
    saved = {name: shape for name, shape in checkpoints.shapes("best").items() if name.startswith("agent/")}
    _check_sizes(folder, options, {name[6:]: shape[1:] for name, shape in saved.items()}, outline)
    count, shape = len(options.agents), jax.ShapeDtypeStruct
    agents = jax.tree.map(lambda leaf: shape((count, *leaf.shape), leaf.dtype), outline)
    best = checkpoints.best("best", Best(agents, shape((count,), jnp.float32), shape((count,), jnp.int32)))  # pyright: ignore
    chosen = int(np.argmax(best.value))
    return jax.tree.map(lambda part: part[chosen], best.agent)


def _check_sizes(folder: Path, options: ReinforcementConfig, saved: dict[str, tuple], outline: Agent) -> None:
    """Refuse arrays, name -> shape, of other sizes than a scenario's observations need."""
    shapes = {name: tuple(leaf.shape) for name, leaf in networks.named_leaves(outline).items()}
    if saved == shapes:
        return
    mean = f"{STATISTICS}mean"
    learned, present = (name.get(mean, (0,))[0] for name in (saved, shapes))
    what = f"{learned} numbers, and this scenario shows {present}"
    if learned == present and options.network.kind != "mlp":
        cure = f"restore the network of its training (its {CONFIG})"
        raise InputError(f"{folder}: its weights are not those of the network {options.network.label}; {cure}.")
    if learned == present:
        what = "images of another size than this scenario's"
    terms = ", ".join(part.kind for part in options.observations)
    raise InputError(
        f"{folder}: its agent sees {what} ({terms}); make the scenario with the options of its training (its {CONFIG})."
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
    options, saved = read_options(folder), files.read_json(folder / CONFIG)
    sees, steps = ", ".join(part.kind for part in options.observations), saved.get("agent", {}).get("steps")
    trained = f" on {steps:,} steps" if isinstance(steps, int) else ""
    return f"Agent of reinforcement learning, trained{trained} in {', '.join(options.environments)}; it sees {sees}."


@struct.dataclass
class Best:
    """The agents that did best in an evaluation so far."""

    agent: Agent  # (A, ...)
    value: Float[Array, "A"]  # return in that evaluation
    update: Int[Array, "A"]  # after which it was


def pack(folder: Path | str, out: Path | str) -> Path:
    """Write the best agent of a training into a new or empty folder ``out``.

    The user's files in the training's options, and the modules that they import, are copied into its ``parts``.

    Raises:
        InputError: there is no agent.
        WriteError: the folder cannot be written.
        IncompleteError: the checkpoint cannot be read.
    """
    folder, out = Path(folder), Path(out)
    check_new_folder(out)
    options = read_options(folder)
    if is_packed(folder):
        raise InputError(f"{folder} is packed already; copy it.")
    user_parts.check_trust(options)
    _, agent, _ = load_agent(folder, registry.build(options.per_environment[0], limit=1).member.scenario)
    facts = {**_best_evaluation(folder), "weights": "float16", "packed_with": versions()}
    with writing.atomic_folder(out) as target:
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


# ------------------------------------------------------------------ networks that imitate


@struct.dataclass
class PolicyParams:
    """Parameters of the policy: the weights are leaves, so ``grad`` and ``vmap`` reach them."""

    weights: Weights
    network: Network = struct.field(pytree_node=False)
    camera: sensors.Camera = struct.field(pytree_node=False)


@struct.dataclass
class PolicyState:
    """The memory of the policy."""

    encodings: Array  # (L, F) of the images of the last 4 s, newest first, one for each control step
    last_arc: Array  # (V,) int32, ``navigation.last_arc_to_goal``
    decision: Decision  # the latest; zeros before the first step


def network_policy(network: Network, weights: Weights, scenario: Scenario, name: str = "learned") -> Policy:
    """A policy of a network that imitates, for the robot of a scenario.

    The policy state holds the encodings of the depth images of the last four seconds. The network receives the
    encodings that are 4, 3, 2, 1 and 0 s old, as in an example. After each step ``state.policy_state.decision`` has the
    local plan and the attention, which SEAN displays too.

    Raises:
        InputError: the robot has no depth camera or is no differential drive.
    """
    require(scenario.robot, ("differential",), f"{name}: networks drive")
    height, width = network.image
    camera = sensors.camera(scenario, "depth", width=width, height=height)
    sensing = "all-knowing" if network.flags else "raw"  # flags are of all people
    params = PolicyParams(weights, network, camera)
    return Policy(params=params, name=name, init=_init_network, apply=_apply_network, sensing=sensing)


def load_imitation(folder: Path | str, scenario: Scenario) -> Policy:
    """The policy with the lowest validation loss so far; in a training in rounds, the policy of the last round.

    Raises:
        InputError: the folder has no trained network, or one that receives the flags of other social situations.
        IncompleteError: the checkpoint cannot be read.
    """
    from sean_jax.learning.checkpoints import Checkpoints  # which needs the extra "learning"

    name, folder = Path(folder).name, _last_round(Path(folder))
    network, situations = networks.read_network(folder, [each for each, _ in scenario.situations])
    shapes = jax.eval_shape(functools.partial(networks.init_weights, network, situations), jax.random.key(0))
    weights = Checkpoints(folder).best("weights", shapes)
    return network_policy(network, weights, scenario, name=name)


def _last_round(folder: Path) -> Path:
    """The last network that ``sean train dagger`` has made in a folder; other folders as they are."""
    if networks.read_method(folder) != "dagger":
        return folder
    rounds = [each for each in folder.glob("round-*") if (each / "checkpoints").is_dir()]
    if not rounds:
        raise InputError(f"{folder} has no trained network yet; resume it by `sean train dagger`.")
    return max(rounds, key=lambda each: int(each.name.rpartition("-")[2]))


def _init_network(scenario: Scenario, params: PolicyParams, state: State) -> PolicyState:
    """Begin an episode: earlier images are replaced by the present image."""
    encoding = _encode_image(scenario, params, state)
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


def _apply_network(
    scenario: Scenario, params: PolicyParams, state: State, key: Array
) -> tuple[Float[Array, "2"], PolicyState]:
    """The command (2,) [m/s, rad/s] of a control step, and the new policy state."""
    before: PolicyState = state.policy_state
    encodings = jnp.concatenate([_encode_image(scenario, params, state)[None], before.encodings[:-1]])
    each_second = encodings[:: round(1.0 / scenario.time_step)][::-1]
    plan = plan_ahead(scenario, state, before.last_arc).astype(jnp.float32)  # networks are in 32 bits
    weights = params.weights
    inputs = each_second, plan, state.situations
    output = cast(Decision, params.network.apply(weights.parameters, *inputs, method="act"))
    decision = replace(output, command=output.command * weights.scale)
    return decision.command, PolicyState(encodings, before.last_arc, decision)


def _encode_image(scenario: Scenario, params: PolicyParams, state: State) -> Array:
    """(F,) encoding of the present depth image."""
    image = depth_image(scenario, state, params.camera)
    return cast(Array, params.network.apply(params.weights.parameters, image, method="encode"))


# ------------------------------------------------------------------ agents of reinforcement learning


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


def agent_policy(network: ActorCritic, agent: Agent, terms: observations.Terms, name: str = "agent") -> Policy:
    """A policy of an agent of reinforcement learning: the mean of its actions.

    Its state holds the memory of the observation, so that delays and stacks are as in training, and the network's.
    """
    params, sensing = AgentParams(agent, network, terms), observations.sensing(terms)
    return Policy(params=params, name=name, init=_init_agent, apply=_apply_agent, sensing=sensing)


def _init_agent(scenario: Scenario, params: AgentParams, state: State) -> AgentState:
    """Begin an episode."""
    key = jax.random.fold_in(state.streams.policy, 2**31 - 1)  # above any tick
    _, observed = observations.begin(params.terms, scenario, state, key)
    return AgentState(observed, jnp.zeros(params.network.memory_size, jnp.float32), jnp.ones((), bool))


def _apply_agent(
    scenario: Scenario, params: AgentParams, state: State, key: Array
) -> tuple[Float[Array, "2"], AgentState]:
    """The command (2,) [m/s, rad/s] of a control step, and the new policy state; the key is not used."""
    before: AgentState = state.policy_state
    shown, observed = observations.observe(params.terms, scenario, state, before.observed)
    vector = observations.flatten(params.terms, shown).astype(jnp.float32)
    vector = jnp.pad(vector, (0, params.network.private))  # the critic's, which is not used
    images = {name: shown[name].astype(params.network.image_dtype) for name in params.network.images}
    output = networks.apply(params.network, params.agent, vector, images, before.memory, before.start)
    after = AgentState(observed, output.memory, jnp.zeros((), bool))
    return to_command(scenario.robot, output.mean.astype(state.robot.position.dtype)), after


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
    (driver, deviation, labeller), memory = params, state.policy_state
    other_key = jax.random.fold_in(key, 1)
    command, driving = episodes.command(scenario, driver, replace(state, policy_state=memory.driver), key)
    label, labelling, noise = command, None, memory.noise
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
