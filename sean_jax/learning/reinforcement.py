"""``sean train ppo`` and ``sean train apg``: training from rewards, with evaluations and several agents.

An update is one compiled program: all scenarios take some steps, and the agent learns from them (``ppo``, ``shac``).
Several environments share the scenarios equally, and the agent learns from all of them together. Agents of different
seeds and numbers are trained in parallel, along a leading axis A. All randomness depends on (seed, update) and on the
states of the scenarios, which checkpoints hold, so a training that was stopped is resumed to the same curve. Processes
that ``jax.distributed`` has joined train together: scenarios are spread over the devices of all of them.
"""

import collections
import contextlib
import functools
import itertools
import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax import mdp
from sean_jax.config import ReinforcementConfig, user_parts
from sean_jax.core import devices, random_streams
from sean_jax.core.clock import ceil_ticks
from sean_jax.core.data_types import Array, Policy, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed
from sean_jax.io import writing
from sean_jax.io.progress import Progress, ProgressLike, progress, say
from sean_jax.learning import bc, costs, ppo, processes, rollouts, shac, trainer
from sean_jax.learning import curriculum as curricula
from sean_jax.learning import policy as policies
from sean_jax.learning.curriculum import Curriculum, CurriculumPlan
from sean_jax.learning.networks import ActorCritic, Agent, init_agents, with_noise
from sean_jax.learning.rollouts import EnvBatch, Envs
from sean_jax.learning.trainer import Loop, Report, TrainState, begin_best, check_config, keep_best, method_config
from sean_jax.mdp import observations, registry, rewards
from sean_jax.robots.drive import require
from sean_jax.simulation.episodes import init_policy, policy_step
from sean_jax.simulation.scenario import reset, results
from sean_jax.simulation.scenario_stack import Stack

REWARDS = "rewards."  # prefix of a sweep's numbers that are weights of rewards

EPISODES, SPEEDS = 100, 20  # episodes, at least, and updates of which progress shows the means

CRITIC_UPDATES = 20  # after --imitate, in which the critic alone learns the returns of the imitating agent

METHODS = {"ppo": ppo, "apg": shac}
"""Method -> the module that has its ``init`` and ``update``."""


class Programs(NamedTuple):
    """The compiled functions of a training. Each compiles at its first call."""

    begin: Callable  # (envs, agents) -> TrainState
    update: Callable  # (envs, state) -> (state, numbers for the log, (A, ...)); donates the state
    evaluate: Callable  # (scenarios, envs, starts, agents) -> mean return, (A,), and numbers for the log, (A, ...)
    refill: Callable  # (envs, state) -> state with other starts; donates the state
    keep_best: Callable  # (state, mean return, (A,)) -> state with its best agents


class DeviceLayout(NamedTuple):
    """Where the state of a training lies."""

    mesh: Mesh
    agents: NamedSharding  # of what each agent has, (A, ...)
    rows: NamedSharding  # of its scenarios, (A, B, ...)

    @property
    def shares_agents(self) -> bool:
        """Whether devices share the agents, and not the scenarios of each."""
        return self.rows == self.agents


class Setting(NamedTuple):
    """What agents are trained with: for each environment the scenario of evaluations and its ``Env``; the network."""

    scenarios: tuple[Scenario, ...]
    envs: Envs
    network: ActorCritic


def train(options: ReinforcementConfig, console: ProgressLike = None) -> TrainState:
    """Train agents, or resume their training; the state then. ``learning.load`` reads the best agent from the folder.

    Args:
        console: shows the progress; a function receives the share that is done.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process trains in the folder.
        IncompleteError: a file is damaged or cannot be written. The checkpoints stay.
        FloatingPointError: the loss is not finite. The checkpoints stay.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(user_parts.read_once())
        count = device_layout(len(options.agents)).mesh.size
        config = processes.on_all_processes(lambda: method_config(options, devices=count))
        processes.on_first_process(lambda: check_config(options.folder, config))  # refuses before anything is written
        setting = processes.on_all_processes(lambda: build(options))
        callbacks = processes.on_all_processes(lambda: _callbacks(options))
        agents = processes.on_all_processes(lambda: _first_agents(options, setting))
        processes.on_first_process(lambda: stack.enter_context(writing.folder_lock(options.folder)))
        return _train(options, console, setting, agents, callbacks, config)


def build(options: ReinforcementConfig) -> Setting:
    """The setting of a training, without pools.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    if options.imitate is not None:
        policies.check_policy(options.imitate, options, "imitate")
    if options.pretrained is not None:
        _check_pretrained(options, _agent_folder(options.pretrained))
    plans = registry.plan_envs(options)
    for plan in plans:
        costs.with_costs(tuple(plan.rewards.items()), options.cost_limits)
    _, private = policies.agent_terms(options)

    # The critic's own observations come last, and costs are terms of the reward.
    prepare = functools.partial(_prepare, options, private)
    envs = [registry.build(plan).map_member(prepare) for plan in plans]
    members = [env.member for env in envs]
    rewards.reweighted(members[0].rewards, _weights(options.agents[0]))  # refuses unknown terms
    _check_alike(environment_names(options, [member.scenario for member in members]), members)
    for env in envs:
        _check_floors(options, len(envs), env.size)

    network = policies.agent_network(options, members[0].observation_space)
    measured = tuple(member.scenario for member in members)
    return Setting(measured, tuple(env.map_member(_without_metrics) for env in envs), network)


def _prepare(options: ReinforcementConfig, private: observations.Terms, env: mdp.Env) -> mdp.Env:
    """An environment with all observations, with costs, and with something to vary for the curriculum."""
    require(env.scenario.robot, ("differential",), "agents drive")
    terms = (*env.observations, *private)
    env = replace(env, observations=terms, rewards=costs.with_costs(env.rewards, options.cost_limits))
    return curricula.prepare(env, options.curriculum)


def _without_metrics(env: mdp.Env) -> mdp.Env:
    return replace(env, scenario=replace(env.scenario, metrics=()))


def _check_floors(options: ReinforcementConfig, environments: int, floors: int) -> None:
    """Refuse scenarios that do not divide among the floors of an environment, and a curriculum on several."""
    scenarios = options.scenarios // environments
    curriculum = options.curriculum
    if scenarios % floors:
        raise InputError(
            f"scenarios: {scenarios} do not divide equally among {floors} floors and robots; take a multiple."
        )
    if floors > 1 and curriculum != "none":
        raise InputError(
            f"curriculum: {curriculum} samples the starts of one floor, not of {floors}; choose one of the two."
        )


def _callbacks(options: ReinforcementConfig) -> tuple[Callable, ...]:
    """The functions that receive each line of the log."""
    functions = tuple(user_parts.resolve(part, {}, "callbacks") for part in options.callbacks)
    for part, function in zip(options.callbacks, functions, strict=True):
        if not callable(function):
            raise InputError(f"callbacks: {part.label} is no function; give one that takes a dict.")
    return functions


def environment_names(options: ReinforcementConfig, scenarios: Sequence[Scenario]) -> list[str]:
    """The name of each environment in the log, with the law of its people if there are several."""
    laws = listed(options.laws)
    names = [scenario.environment.name for scenario in scenarios]
    if not laws:
        return names
    return [f"{name}, {law}" for name, law in zip(names, itertools.cycle(laws), strict=False)]


def _check_alike(names: Sequence[str], envs: Sequence[mdp.Env]) -> None:
    """Refuse environments of one name, whose evaluations would mix, and of other observation sizes."""
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"environment: {name} is listed more than once; list each once.")
    first = envs[0].observation_space
    for name, env in zip(names[1:], envs[1:], strict=True):
        for term, box in env.observation_space.items():
            if box.shape != first[term].shape:
                raise InputError(
                    f"observations: {name} shows {term} of the size {box.shape}, and {names[0]} {first[term].shape}; "
                    "leave it out, or train in one of them."
                )


def device_layout(agents: int) -> DeviceLayout:
    """Devices share the agents if there are several, which then exchange nothing, and else the scenarios.

    Agents that do not divide among all devices take as many devices as they divide among: if devices shared the
    scenarios of several agents, each call of a GPU kernel would exchange them. Only one process can hold other agents
    on each of its devices, since all processes of several read the agents.
    """
    if agents == 1 or jax.process_count() > 1:
        mesh = devices.mesh()
        return DeviceLayout(mesh, _sharding(mesh), _sharding(mesh, None, devices.AXIS))
    count = max(count for count in range(1, len(jax.devices()) + 1) if agents % count == 0)
    mesh = devices.mesh(jax.devices()[:count])
    return DeviceLayout(mesh, _sharding(mesh, devices.AXIS), _sharding(mesh, devices.AXIS))


def _sharding(mesh: Mesh, *axes: str | None) -> NamedSharding:
    return NamedSharding(mesh, PartitionSpec(*axes))


def unused_devices(agents: int) -> str | None:
    """A sentence on the devices that a training of that many agents leaves idle; None if it takes all."""
    used = device_layout(agents).mesh.size
    count = len(jax.devices())
    if used == count:
        return None
    return f"{agents} agents divide among {used} of {count} devices; the others are idle. Train a multiple of {count}."


class Context(NamedTuple):
    """What all compiled functions of a training read."""

    options: ReinforcementConfig
    network: ActorCritic
    terms: observations.Terms  # of the actor
    method: Any  # a module of ``METHODS``
    plan: CurriculumPlan | None  # of the curriculum
    keys: Array  # (A,) typed PRNG keys of the agents' updates
    curriculum_keys: Array  # (A,)
    hyperparameters: dict[str, Float[Array, "A"]]  # of each agent


def programs(options: ReinforcementConfig, network: ActorCritic, layout: DeviceLayout) -> Programs:
    """The compiled functions of a training."""
    context = make_context(options, network)
    whole = _sharding(layout.mesh)
    placed = placement(layout)
    return Programs(
        begin=jax.jit(functools.partial(begin, context)),
        update=jax.jit(functools.partial(update, context), donate_argnums=1, out_shardings=(placed, whole)),
        evaluate=jax.jit(functools.partial(evaluate, context), out_shardings=whole),
        refill=jax.jit(functools.partial(refill, context), donate_argnums=1, out_shardings=placed),
        keep_best=jax.jit(keep_best, out_shardings=placed),
    )


def make_context(options: ReinforcementConfig, network: ActorCritic) -> Context:
    """The context of a training."""
    agents = options.agents
    names = [name for name in agents[0] if name != "seed"]
    return Context(
        options=options,
        network=network,
        terms=policies.agent_terms(options)[0],
        method=METHODS[options.method],
        plan=None if options.curriculum == "none" else CurriculumPlan(options.curriculum),
        keys=agent_keys(options, "training"),
        curriculum_keys=agent_keys(options, "curriculum"),
        hyperparameters={name: jnp.asarray([agent[name] for agent in agents], jnp.float32) for name in names},
    )


def agent_keys(options: ReinforcementConfig, use: str) -> Array:
    """The (A,) typed PRNG keys of the agents' seeds for a use, one of ``random_streams.USES``."""
    return jnp.stack([random_streams.key(use, int(agent["seed"])) for agent in options.agents])


def begin(context: Context, envs: Envs, agents: Agent) -> TrainState:
    """The state before the first update."""
    start = functools.partial(begin_agent, context, envs)
    optimizer, rows, curriculum = jax.vmap(start)(agents, context.keys, context.curriculum_keys)
    count = context.keys.shape[0]
    return TrainState(
        agent=agents,
        optimizer=optimizer,
        best=begin_best(agents, (count,)),
        update=jnp.zeros((), jnp.int32),
        rows=rows,
        curriculum=curriculum,
        multipliers=costs.init(envs[0].member.rewards, context.options.cost_limits, count),
    )


def begin_agent(
    context: Context, envs: Envs, agent: Agent, key: Array, curriculum_key: Array
) -> tuple[PyTree, EnvBatch, Curriculum | None]:
    """An agent's optimizer, scenarios and curriculum before the first update."""
    options = context.options
    plan = context.plan
    reset_key, age_key = jax.random.split(jax.random.fold_in(key, 0))
    batch = rollouts.reset_envs(envs, context.network, reset_key, options.scenarios)
    if options.behavior.kind != "playback":  # whose people are where they are by the tick
        batch = stagger(envs, batch, age_key)

    curriculum = None
    if plan is not None:
        policy = policies.agent_policy(context.network, agent, context.terms)
        start_key = jax.random.fold_in(curriculum_key, 0)
        curriculum = curricula.init(envs[0].member, plan, start_key, options.pool, policy)
    return context.method.init(agent), batch, curriculum


def update(context: Context, envs: Envs, state: TrainState) -> tuple[TrainState, dict[str, Any]]:
    """One update of all agents: collect and learn, follow the curriculum, then the multipliers of costs."""
    limits = context.options.cost_limits
    number = state.update + 1
    hyperparameters = scheduled(context, state)
    advance = functools.partial(update_agent, context, envs, number)
    assert state.rows is not None
    inputs = state.agent, state.optimizer, state.rows, state.curriculum, context.keys, hyperparameters
    agent, optimizer, rows, curriculum, metrics = jax.vmap(advance)(*inputs)

    # The multipliers follow the rates of costs that the update measured.
    time_step = envs[0].member.scenario.time_step
    multipliers, cost_metrics = costs.follow(state.multipliers, limits, metrics["rewards"], time_step)

    # Until the first evaluation, the latest agents are the best.
    unknown = state.best.update.max() == 0
    best = jax.tree.map(lambda old, new: jnp.where(unknown, new, old), state.best.agent, agent)
    state = TrainState(
        agent=agent,
        optimizer=optimizer,
        best=replace(state.best, agent=best),
        update=number,
        rows=rows,
        curriculum=curriculum,
        multipliers=multipliers,
    )
    return state, metrics | cost_metrics


def scheduled(context: Context, state: TrainState) -> dict[str, Float[Array, "A"]]:
    """The hyperparameters (A,) of the next update."""
    options = context.options
    hyperparameters = context.hyperparameters
    rate = hyperparameters["learning_rate"]
    if options.learning_rate_schedule == "linear":
        rate = rate * (1.0 - state.update.astype(jnp.float32) / options.updates)

    # After --imitate, the critic first learns the returns of the agent that imitates.
    critic_updates = CRITIC_UPDATES if options.imitate is not None else 0
    actor_rate = jnp.where(state.update + 1 > critic_updates, rate, 0.0)
    weights = costs.weights(state.multipliers, options.cost_limits)
    cost_weights = {REWARDS + name: weight for name, weight in weights.items()}
    return hyperparameters | cost_weights | {"learning_rate": rate, "actor_rate": actor_rate}


def update_agent(
    context: Context,
    envs: Envs,
    number: Int[Array, ""],
    agent: Agent,
    optimizer: PyTree,
    batch: EnvBatch,
    curriculum: Curriculum | None,
    key: Array,
    hyperparameters: dict[str, Float[Array, ""]],
) -> tuple[Agent, PyTree, EnvBatch, Curriculum | None, dict[str, Any]]:
    """One update of an agent in environments with its own starts and weights of rewards."""
    member = envs[0].member
    if curriculum is not None:
        envs = (envs[0].with_fields(pool=curriculum.pool),)
    envs = _reweighted(envs, hyperparameters)

    update_key = jax.random.fold_in(key, number)
    learner = context.network, agent, optimizer, batch
    agent, optimizer, batch, transitions, metrics = context.method.update(
        context.options, hyperparameters, envs, *learner, update_key
    )
    info = transitions.info
    done = transitions.done
    curriculum, curriculum_metrics = curricula.follow(member, context.plan, curriculum, info, done)
    return agent, optimizer, batch, curriculum, metrics | curriculum_metrics


def refill(context: Context, envs: Envs, state: TrainState) -> TrainState:
    """The state with new starts in the places of the least useful ones."""
    assert state.curriculum is not None
    renew = functools.partial(refill_agent, context, envs, state.update)
    return replace(state, curriculum=jax.vmap(renew)(state.agent, state.curriculum, context.curriculum_keys))


def refill_agent(
    context: Context, envs: Envs, number: Int[Array, ""], agent: Agent, curriculum: Curriculum, key: Array
) -> Curriculum:
    """The curriculum of an agent with new starts."""
    assert context.plan is not None
    policy = policies.agent_policy(context.network, agent, context.terms)
    return curricula.refill(envs[0].member, context.plan, curriculum, jax.random.fold_in(key, number), policy)


def evaluate(
    context: Context, scenarios: tuple[Scenario, ...], envs: Envs, starts: tuple[State, ...], agents: Agent
) -> tuple[Float[Array, "A"], list[dict[str, Array]]]:
    """The mean value of each agent over environments, and the means (A, ...) of each environment."""
    measure = functools.partial(evaluate_agent, context, scenarios, envs, starts)
    means = jax.vmap(measure)(agents, context.hyperparameters)
    return jnp.stack([numbers.pop("value") for numbers in means]).mean(0), means


def evaluate_agent(
    context: Context,
    scenarios: tuple[Scenario, ...],
    envs: Envs,
    starts: tuple[State, ...],
    agent: Agent,
    hyperparameters: dict[str, Float[Array, ""]],
) -> list[dict[str, Array]]:
    """The means of an agent in each environment."""
    policy = policies.agent_policy(context.network, agent, context.terms)
    means = []
    for scenario, env, first in zip(scenarios, _reweighted(envs, hyperparameters), starts, strict=True):
        means.append(_evaluate_policy(scenario, env, policy, first, context.options.cost_limits))
    return means


def placement(layout: DeviceLayout) -> Any:
    """The sharding of each field of a ``TrainState``."""
    return TrainState(
        agent=layout.agents,  # pyright: ignore
        optimizer=layout.agents,
        rows=layout.rows,  # pyright: ignore
        best=layout.agents,  # pyright: ignore
        curriculum=layout.agents,  # pyright: ignore
        update=_sharding(layout.mesh),  # pyright: ignore
        multipliers=layout.agents,  # pyright: ignore
    )


def stagger(envs: Envs, batch: EnvBatch, key: Array) -> EnvBatch:
    """Scenarios whose first episodes are at random ages, or else all would reach the time limit in the same step.

    The key is a typed PRNG key ().
    """

    def one(env: Stack[mdp.Env], states: mdp.EnvState, key: Array) -> mdp.EnvState:
        last = ceil_ticks(env.member.scenario.time_limit, env.member.scenario.time_step)
        tick = jax.random.randint(key, states.simulation.tick.shape, 0, last, jnp.int32)
        return replace(states, simulation=replace(states.simulation, tick=tick))

    keys = jax.random.split(key, len(envs))
    return replace(batch, envs=tuple(map(one, envs, batch.envs, keys)))


def _weights(numbers: dict[str, Any]) -> dict[str, Any]:
    """The weights of rewards among an agent's numbers."""
    return {name.removeprefix(REWARDS): value for name, value in numbers.items() if name.startswith(REWARDS)}


def _reweighted(envs: Envs, numbers: dict[str, Any]) -> Envs:
    """The environments with an agent's own weights of rewards."""

    def change(env: mdp.Env) -> mdp.Env:
        return replace(env, rewards=rewards.reweighted(env.rewards, _weights(numbers)))

    return tuple(env.map_member(change) for env in envs)


class EvaluatedEpisode(NamedTuple):
    """An episode of an evaluation so far."""

    state: State
    potentials: dict[str, Float[Array, ""]]  # of the terms of the reward that have one
    episode_return: Float[Array, ""]  # without costs
    costs: dict[str, Float[Array, ""]]  # sum of each
    steps: Int[Array, ""]
    active: Bool[Array, ""]  # whether it has not ended


def _evaluate_policy(
    measured: Scenario, envs: Stack[mdp.Env], policy: Policy, starts: State, limits: dict[str, float]
) -> dict[str, Any]:
    """Means over episodes in which the agent takes the mean of its actions: return without costs, costs a minute, the
    metrics of ``measured``, and the value by which agents are compared.
    """
    floors = np.arange(min(envs.size, len(starts.tick)))
    run = functools.partial(_evaluate_episode, measured, policy, limits)
    episodes, metrics = envs.take(floors).vmap(run)(starts)

    minutes = episodes.steps.sum().astype(float) * (measured.time_step / 60.0)
    weights = {name: term.weight for name, term in envs.member.rewards}
    rates = {name: cost.sum() / weights[name] / minutes for name, cost in episodes.costs.items()}

    mean_return = episodes.episode_return.mean()
    numbers = {"return": mean_return, "completed": episodes.state.completed.mean(dtype=jnp.float32)}
    numbers |= {"value": mean_return - costs.penalty(rates, limits)}
    numbers |= {f"{name} a minute": rate for name, rate in rates.items()}
    return numbers | {name: jnp.nanmean(value, 0) for name, value in metrics.items()}


def _evaluate_episode(
    measured: Scenario, policy: Policy, limits: dict[str, float], env: mdp.Env, start: State
) -> tuple[EvaluatedEpisode, dict[str, Array]]:
    """An episode until its end, and its metrics."""
    scenario = replace(env.scenario, metrics=measured.metrics)
    state = init_policy(scenario, policy, start)
    first = EvaluatedEpisode(
        state=state,
        potentials=rewards.potentials(env.rewards, scenario, state),
        episode_return=jnp.zeros((), float),
        costs={name: jnp.zeros((), float) for name in limits},
        steps=jnp.zeros((), jnp.int32),
        active=jnp.ones((), bool),
    )

    def advance(episode: EvaluatedEpisode, _: None) -> tuple[EvaluatedEpisode, None]:
        return _evaluation_step(scenario, env, policy, episode), None

    length = math.ceil(measured.time_limit / measured.time_step) + 1
    last, _ = jax.lax.scan(advance, first, length=length)
    return last, results(scenario, last.state)


def _evaluation_step(scenario: Scenario, env: mdp.Env, policy: Policy, before: EvaluatedEpisode) -> EvaluatedEpisode:
    """One step of control; an episode that has ended counts no more."""
    active = before.active
    state, _ = policy_step(scenario, policy, before.state)
    potentials = rewards.potentials(env.rewards, scenario, state)
    terms = rewards.of_step(env.rewards, scenario, before.state, state, before.potentials, potentials)

    # Costs are counted by themselves, without the agent's multipliers.
    spent = {name: cost + jnp.where(active, terms.pop(name), 0.0) for name, cost in before.costs.items()}
    gain = jnp.where(active, jnp.stack(list(terms.values())).sum(), 0.0) if terms else 0.0

    ends = jnp.stack([state.completed, state.timed_out, *env.ends(scenario, before.state, state)])
    if env.terminations:  # completed and timed-out episodes are constant anyway
        state = jax.tree.map(lambda old, new: jnp.where(active, new, old), before.state, state)
    return EvaluatedEpisode(
        state=state,
        potentials=potentials,
        episode_return=before.episode_return + gain,
        costs=spent,
        steps=before.steps + active.astype(jnp.int32),
        active=active & ~ends.any(),
    )


# ------------------------------------------------------------------ the training


def draw_starts(
    options: ReinforcementConfig, scenarios: tuple[Scenario, ...], envs: Envs
) -> tuple[Envs, tuple[State, ...]]:
    """The environments with pools, unless a curriculum has its own, and the first states of evaluations."""
    key = random_streams.key("training", options.seed)
    if options.curriculum == "none":
        draw = devices.on_host(jax.jit(lambda env, key: rollouts.draw_pool(env, key, options.pool)))
        keys = [jax.random.fold_in(key, 2**31 - 1 - turn) for turn in range(len(envs))]
        pools = map(draw, envs, keys)
        envs = tuple(env.with_fields(pool=pool) for env, pool in zip(envs, pools, strict=True))
    first = devices.on_host(jax.jit(functools.partial(evaluation_starts, options)))
    return envs, first(scenarios, tuple(env.with_fields(pool=None) for env in envs))


def evaluation_starts(options: ReinforcementConfig, scenarios: tuple[Scenario, ...], envs: Envs) -> tuple[State, ...]:
    """The first states (E, ...) of the episodes of an evaluation in each environment, on its first floors: episode i
    is on floor i modulo their number.
    """
    keys = jax.random.split(random_streams.key("evaluation", options.seed), options.evaluation_episodes)

    def draw(measured: Scenario, env: Stack[mdp.Env]) -> State:
        floors = min(env.size, len(keys))
        sorted_keys = keys[: len(keys) // floors * floors].reshape(-1, floors).T.ravel()
        first = env.take(np.arange(floors))
        return first.vmap(lambda env, key: reset(replace(env.scenario, metrics=measured.metrics), key))(sorted_keys)

    return tuple(draw(measured, env) for measured, env in zip(scenarios, envs, strict=True))


def _train(
    options: ReinforcementConfig,
    console: ProgressLike,
    setting: Setting,
    agents: Agent,
    callbacks: tuple[Callable, ...],
    config: dict[str, Any],
) -> TrainState:
    """Train in a folder that this process has locked, or the first of the processes that train together."""
    # Everything that can be refused comes before the starts are drawn.
    scenarios, envs, network = setting
    resumes = processes.on_first_process(lambda: check_config(options.folder, config))
    layout = device_layout(len(options.agents))
    _check_devices(options, layout, len(envs))
    if idle := unused_devices(len(options.agents)):
        say(console, idle)
    run = programs(options, network, layout)

    # A training that goes on has imitated already.
    teachers = ()
    if options.imitate is not None and not (resumes and list((options.folder / "checkpoints").glob("[0-9]*"))):
        teachers = tuple(policies.load_policy(options.imitate, scenario, "imitate") for scenario in scenarios)

    with progress(console if processes.is_first_process() else None) as tell:
        tell.stage("drawing starts")
        envs, starts = draw_starts(options, scenarios, envs)
        if teachers:
            assert options.imitate is not None
            tell.stage(f"imitating {options.imitate.kind}")
            agents = _imitate(options, setting, teachers, agents)

        # A network that imitates is almost deterministic; with more noise it explores again.
        if options.noise is not None:
            agents = with_noise(agents, options.noise)
        state = run.begin(envs, agents)

        # From here on, environments lie on all devices, and the state as its layout says.
        scenarios, envs, starts = devices.replicate(layout.mesh, (scenarios, envs, starts))
        course = Course(options, run, Setting(scenarios, envs, network), starts, tell, Recent())

        # Checkpoints are the same for any number of devices: they are decoded and then placed.
        loop = Loop(
            advance=functools.partial(_advance, course),
            is_over=lambda state: int(state.update) >= options.updates,
            done=lambda state: int(state.update),
            place=lambda state: devices.place(state, placement(layout)),
            encode=_encode,
            decode=_decode,
        )
        return trainer.fit(options.folder, config, state, loop, options.updates, tell, callbacks)


def _check_devices(options: ReinforcementConfig, layout: DeviceLayout, environments: int) -> None:
    """Refuse scenarios that do not divide among the devices."""
    if layout.shares_agents or options.scenarios // environments % layout.mesh.size == 0:
        return
    if environments > 1:
        raise InputError(
            f"scenarios: {options.scenarios} do not spread evenly over {layout.mesh.size} devices in {environments} "
            "environments; take a multiple."
        )
    raise InputError(
        f"scenarios: {options.scenarios} do not spread evenly over {layout.mesh.size} devices; take a multiple."
    )


class Recent:
    """The latest episodes of a training, at least 100 of them as soon as so many have ended, and its latest speed.

    An update alone may end a handful of episodes, whose means say nothing.
    """

    def __init__(self) -> None:
        self._updates: collections.deque[dict[str, float]] = collections.deque()  # sums over the episodes of each
        self._speeds: collections.deque[tuple[float, float]] = collections.deque(maxlen=SPEEDS + 1)

    def add(self, episodes: dict[str, np.ndarray], steps: float, seconds: float) -> None:
        """Add an update: numbers (A,) of the episodes of each agent, steps of all of them, and the time [s]."""
        number = np.nan_to_num(episodes.get("number", np.zeros(1)))
        sums = {name: float((np.nan_to_num(episodes[name]) * number).sum()) for name in ("return", "completed")}
        self._updates.append({"number": float(number.sum()), **sums})
        while self._number() - self._updates[0]["number"] >= EPISODES:
            self._updates.popleft()
        self._speeds.append((steps, seconds))

    def note(self) -> str:
        """The means in words."""
        words = "no episode has ended"
        number = self._number()
        if number:
            value, completed = (sum(each[name] for each in self._updates) / number for name in ("return", "completed"))
            words = f"last {number:,.0f} episodes: return {value:.1f}, completed {completed:.0%}"
        speeds = list(self._speeds)[1:]  # the first update was compiled
        if speeds:
            words += f" · {sum(steps for steps, _ in speeds) / sum(seconds for _, seconds in speeds):,.0f} steps/s"
        return words

    def _number(self) -> float:
        return sum(each["number"] for each in self._updates)


class Course(NamedTuple):
    """What a training goes through with: its programs, what they are called with, and who is told."""

    options: ReinforcementConfig
    run: Programs
    setting: Setting
    starts: tuple[State, ...]  # (E, ...) of evaluations, in each environment
    tell: Progress
    recent: Recent


def _advance(course: Course, state: TrainState) -> tuple[TrainState, Report]:
    """An update, and an evaluation if it is due."""
    options = course.options
    envs = course.setting.envs
    start = time.time()
    state, metrics = course.run.update(envs, state)
    number = int(state.update)
    metrics = jax.tree.map(np.asarray, metrics)
    if state.curriculum is not None and number % options.curriculum_every == 0:
        state = course.run.refill(envs, state)
    if not np.isfinite(metrics["train"]["loss"]).all():
        raise FloatingPointError(
            f"the loss is not finite in update {number}; {options.folder} keeps the checkpoints until then; "
            "try a lower --learning-rate in another folder."
        )

    steps = options.scenarios * options.horizon
    seconds = time.time() - start
    all_steps = len(options.agents) * steps
    course.recent.add(metrics["episodes"], all_steps, seconds)
    line: dict[str, Any] = {
        "epoch": number,
        "steps": number * steps,
        "seconds": seconds,
        "per_second": all_steps / seconds,
    }
    line |= {part: _finite_means(values) for part, values in metrics.items()}

    due = number % options.evaluate_every == 0 or number == options.updates
    if due:
        with course.tell.aside("evaluating"):
            state, evaluation = _evaluate(course, state)
        line |= evaluation
    loss = -float(np.sum(np.asarray(state.best.value, float)))
    return state, Report(number, line, loss, due, f"update {number} · {course.recent.note()}")


def _first_agents(options: ReinforcementConfig, setting: Setting) -> Agent:
    """The agents before the first update, (A, ...).

    Raises:
        InputError: the pretrained agent is missing, or sees something else.
        IncompleteError: its checkpoint cannot be read.
    """
    scenario, *_ = setting.scenarios
    env = setting.envs[0].member
    network = setting.network
    keys = agent_keys(options, "weights")
    if options.pretrained is None:
        return jax.jit(lambda keys: init_agents(network, env.observations, env.observation_space, keys))(keys)
    agent = policies.load_agent(_agent_folder(options.pretrained), scenario)[1]
    return jax.tree.map(lambda part: jnp.broadcast_to(part[None], (keys.shape[0], *part.shape)), agent)


def _imitate(options: ReinforcementConfig, setting: Setting, teachers: tuple[Policy, ...], agents: Agent) -> Agent:
    """The agents after they have learned from another policy, (A, ...)."""

    def clone(envs: Envs, teachers: tuple[Policy, ...], agent: Agent, key: Array) -> tuple[Agent, Array]:
        sizes = options.horizon, options.learning_rate, options.minibatches
        lesson = bc.make_lesson(setting.network, envs, teachers, *sizes)
        return bc.clone(lesson, agent, options.scenarios, options.pool, key)

    clone_all = jax.jit(jax.vmap(clone, (None, None, 0, 0)))
    agents, errors = clone_all(setting.envs, teachers, agents, agent_keys(options, "imitation"))
    if not np.isfinite(np.asarray(errors)).all():
        raise FloatingPointError(f"imitate: what {teachers[0].name} does is not finite; choose another --imitate.")
    return agents


def _evaluate(course: Course, state: TrainState) -> tuple[TrainState, dict[str, dict]]:
    """The state with its best agents, and the evaluation: means of all environments and agents, and, if there are
    several, of each environment and of each agent."""
    options = course.options
    scenarios, envs, _ = course.setting
    envs = tuple(env.with_fields(pool=None) for env in envs)
    value, means = course.run.evaluate(scenarios, envs, course.starts, state.agent)
    state = course.run.keep_best(state, jnp.asarray(value, jnp.float32))

    # Means over environments are (A, ...) of each agent; means over agents are of each environment.
    means = jax.tree.map(np.asarray, means)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a situation that never occurred
        agents = {name: np.nanmean([numbers[name] for numbers in means], 0) for name in means[0]}
        overall = _mean_of_agents(agents)
        places = [_mean_of_agents(numbers) for numbers in means]

    columns = ["", *(f" in {name}" for name, _ in scenarios[0].situations)]
    line = {"evaluation": _by_situation(columns, overall)}
    if len(places) > 1:
        for name, numbers in zip(environment_names(options, scenarios), places, strict=True):
            line[f"evaluation in {name}"] = _by_situation(columns, numbers)
    if (count := value.shape[0]) > 1:
        for index in range(count):
            own = {name: numbers[index] for name, numbers in agents.items()}
            line[f"agent {index}"] = _by_situation(columns, own)
    return state, line


def _mean_of_agents(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Means over (A, ...)."""
    return {name: np.nanmean(numbers, 0) for name, numbers in values.items()}


def _by_situation(names: list[str], values: dict[str, np.ndarray]) -> dict[str, float]:
    """The finite numbers of () or (1 + S,) values, by name and situation."""
    numbers = {}
    for name, value in values.items():
        for column, part in zip(names, value.reshape(-1), strict=False):
            if np.isfinite(part):
                numbers[name + column] = float(part)
    return numbers


def _finite_means(values: dict[str, np.ndarray]) -> dict[str, float]:
    """Means over agents of finite numbers, as JSON values."""
    finite = {name: value[np.isfinite(value)] for name, value in values.items()}
    return {name: float(value.mean()) for name, value in finite.items() if value.size}


@jax.jit  # of arrays on the devices of other processes, an array of none is made only so
def _encode(tree: PyTree) -> PyTree:
    """The state as checkpoints can hold it: keys as numbers, and one number for an empty array."""
    return jax.tree.map(lambda leaf: leaf if leaf.size else jnp.zeros(1, leaf.dtype), random_streams.as_numbers(tree))


def _decode(saved: PyTree, like: PyTree) -> PyTree:
    """The inverse of ``_encode``."""
    return random_streams.as_keys(jax.tree.map(lambda leaf, one: leaf if one.size else one, saved, like), like)


def _agent_folder(folder: Path) -> Path:
    """A folder with an agent; without one, that of the package's agent of this name."""
    return folder if (folder / policies.CONFIG).is_file() else policies.AGENTS.get(str(folder), folder)


def _check_pretrained(options: ReinforcementConfig, folder: Path) -> None:
    """Refuse an agent with other observations or of another size."""
    saved = user_parts.by_content(policies.read_options(folder))
    current = user_parts.by_content(options)
    for name in ("observations", "critic", "width", "layers", "recurrent", "bfloat16", "network", "distribution"):
        if saved[name] != current[name]:
            raise InputError(f"pretrained: {folder} has {name} {saved[name]}, not {current[name]}; ask for the same.")
