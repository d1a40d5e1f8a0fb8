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
from flax import struct
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Float, Int, PyTree

from sean_jax import mdp
from sean_jax.config import ReinforcementConfig, user_parts
from sean_jax.core import devices, random_streams
from sean_jax.core.clock import ceil_ticks
from sean_jax.core.data_types import Array, Policy, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.core.messages import listed
from sean_jax.io import writing
from sean_jax.io.progress import Progress, ProgressLike, progress, say
from sean_jax.learning import costs as bounds
from sean_jax.learning import curriculum as curricula
from sean_jax.learning import dagger, ppo, processes, rollouts, shac, trainer
from sean_jax.learning import policy as policies
from sean_jax.learning.curriculum import Curriculum, Plan
from sean_jax.learning.networks import ActorCritic, Agent, init_agents, with_noise
from sean_jax.learning.policy import Best
from sean_jax.learning.rollouts import EnvBatch, Envs
from sean_jax.learning.trainer import Loop, Report, check_config, method_config
from sean_jax.mdp import registry, rewards
from sean_jax.robots.drive import require
from sean_jax.simulation.episodes import init_policy, policy_step
from sean_jax.simulation.scenario import reset, results
from sean_jax.simulation.scenario_stack import Stack

REWARDS = "rewards."  # prefix of a sweep's numbers that are weights of rewards

LOWEST = float(np.finfo(np.float32).min)  # value of agents that were never evaluated

EPISODES, SPEEDS = 100, 20  # episodes, at least, and updates of which progress shows the means

CRITIC_UPDATES = 20  # after --imitate, in which the critic alone learns the returns of the imitating agent

METHODS = {"ppo": ppo, "apg": shac}
"""Method -> the module that has its ``init`` and ``update``."""


@struct.dataclass
class TrainState:
    """The state of a training. The field names are the names in checkpoints on disk."""

    agent: Agent  # (A, ...)
    optimizer: PyTree  # (A, ...)
    rows: EnvBatch  # (A, B, ...)
    best: Best
    curriculum: Curriculum | None  # (A, ...); None: all starts of the pool are alike
    update: Int[Array, ""]  # updates done
    multipliers: bounds.Multipliers | None = None  # of costs; None without any


class Programs(NamedTuple):
    """The compiled functions of a training. Each compiles at its first call."""

    begin: Callable  # (envs, agents) -> TrainState
    update: Callable  # (envs, state) -> (state, numbers for the log, (A, ...)); donates the state
    evaluate: Callable  # (scenarios, envs, starts, agents) -> mean return, (A,), and numbers for the log, (A, ...)
    refill: Callable  # (envs, state) -> state with other starts; donates the state
    keep_best: Callable  # (state, mean return, (A,)) -> state with its best agents


class Layout(NamedTuple):
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
        bounds.with_costs(tuple(plan.rewards.items()), options.cost_limits)
    _, private = policies.agent_terms(options)
    envs = [registry.build(plan) for plan in plans]

    def prepare(env: mdp.Env) -> mdp.Env:
        require(env.scenario.robot, ("differential",), "agents drive")
        terms = (*env.observations, *private)
        env = replace(env, observations=terms, rewards=bounds.with_costs(env.rewards, options.cost_limits))
        return curricula.prepare(env, options.curriculum)

    def without_metrics(env: mdp.Env) -> mdp.Env:
        return replace(env, scenario=replace(env.scenario, metrics=()))

    envs = [env.map_member(prepare) for env in envs]
    first = envs[0].member
    rewards.reweighted(first.rewards, _weights(options.agents[0]))  # refuses unknown terms
    _check_alike(environment_names(options, [env.member.scenario for env in envs]), [env.member for env in envs])
    for env in envs:
        if options.scenarios // len(envs) % env.size:
            text = f"{options.scenarios // len(envs)} do not divide equally among {env.size} floors and robots"
            raise InputError(f"scenarios: {text}; take a multiple.")
        if env.size > 1 and options.curriculum != "none":
            text = f"{options.curriculum} samples the starts of one floor, not of {env.size}"
            raise InputError(f"curriculum: {text}; choose one of the two.")
    network = policies.agent_network(options, first.observation_space)
    measured = tuple(env.member.scenario for env in envs)
    return Setting(measured, tuple(env.map_member(without_metrics) for env in envs), network)


def _callbacks(options: ReinforcementConfig) -> tuple[Callable, ...]:
    """The functions that receive each line of the log."""
    functions = tuple(user_parts.resolve(part, {}, "callbacks") for part in options.callbacks)
    for part, function in zip(options.callbacks, functions, strict=True):
        if not callable(function):
            raise InputError(f"callbacks: {part.label} is no function; give one that takes a dict.")
    return functions


def environment_names(options: ReinforcementConfig, scenarios: Sequence[Scenario]) -> list[str]:
    """The name of each environment in the log, with the law of its people if there are several."""
    laws, names = listed(options.laws), [scenario.environment.name for scenario in scenarios]
    return [f"{name}, {law}" for name, law in zip(names, itertools.cycle(laws), strict=False)] if laws else names


def _check_alike(names: Sequence[str], envs: Sequence[mdp.Env]) -> None:
    """Refuse environments of one name, whose evaluations would mix, and of other observation sizes."""
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"environment: {twice[0]} is listed more than once; list each once.")
    first, *others = [{name: box.shape for name, box in env.observation_space.items()} for env in envs]
    for name, shapes in zip(names[1:], others, strict=True):
        for term in (term for term in first if shapes[term] != first[term]):
            sizes = f"{term} of the size {shapes[term]}, and {names[0]} {first[term]}"
            raise InputError(f"observations: {name} shows {sizes}; leave it out, or train in one of them.")


def device_layout(agents: int) -> Layout:
    """Devices share the agents if there are several, which then exchange nothing, and else the scenarios.

    Agents that do not divide among all devices take as many devices as they divide among: if devices shared the
    scenarios of several agents, each call of a GPU kernel would exchange them. Only one process can hold other agents
    on each of its devices, since all processes of several read the agents.
    """
    if agents == 1 or jax.process_count() > 1:
        mesh = devices.mesh()
        return Layout(mesh, _sharding(mesh), _sharding(mesh, None, devices.AXIS))
    count = max(count for count in range(1, len(jax.devices()) + 1) if agents % count == 0)
    mesh = devices.mesh(jax.devices()[:count])
    return Layout(mesh, _sharding(mesh, devices.AXIS), _sharding(mesh, devices.AXIS))


def _sharding(mesh: Mesh, *axes: str | None) -> NamedSharding:
    return NamedSharding(mesh, PartitionSpec(*axes))


def unused_devices(agents: int) -> str | None:
    """A sentence on the devices that a training of that many agents leaves idle; None if it takes all."""
    used, count = device_layout(agents).mesh.size, len(jax.devices())
    if used == count:
        return None
    return f"{agents} agents divide among {used} of {count} devices; the others are idle. Train a multiple of {count}."


def programs(options: ReinforcementConfig, network: ActorCritic, layout: Layout) -> Programs:
    """The compiled functions of a training."""
    method: Any = METHODS[options.method]
    keys = jnp.stack([random_streams.key("training", int(agent["seed"])) for agent in options.agents])
    numbers = {
        name: jnp.asarray([agent[name] for agent in options.agents], jnp.float32)
        for name in options.agents[0]
        if name != "seed"
    }
    plan = None if options.curriculum == "none" else Plan(options.curriculum)
    total, (terms, _) = options.updates, policies.agent_terms(options)
    curriculum_keys = jnp.stack([random_streams.key("curriculum", int(agent["seed"])) for agent in options.agents])

    held, limits = CRITIC_UPDATES if options.imitate is not None else 0, options.cost_limits

    def begin(envs: Envs, agents: Agent) -> TrainState:
        def one(agent: Agent, key: Array, start: Array) -> tuple[PyTree, EnvBatch, Curriculum | None]:
            first, ages = jax.random.split(jax.random.fold_in(key, 0))
            batch = rollouts.reset_envs(envs, network, first, options.scenarios)
            if options.behavior.kind != "playback":  # whose people are where they are by the tick
                batch = stagger(envs, batch, ages)
            policy, start = policies.agent_policy(network, agent, terms), jax.random.fold_in(start, 0)
            return method.init(agent), batch, plan and curricula.init(envs[0].member, plan, start, options.pool, policy)

        optimizer, batch, curriculum = jax.vmap(one)(agents, keys, curriculum_keys)
        count = keys.shape[0]
        best = Best(agents, jnp.full(count, LOWEST, jnp.float32), jnp.zeros(count, jnp.int32))
        multipliers = bounds.init(envs[0].member.rewards, limits, count)
        return TrainState(agents, optimizer, batch, best, curriculum, jnp.zeros((), jnp.int32), multipliers)

    def update(envs: Envs, state: TrainState) -> tuple[TrainState, dict[str, Any]]:
        number = state.update + 1
        falls = options.learning_rate_schedule == "linear"
        left = 1.0 - state.update.astype(jnp.float32) / total if falls else jnp.ones((), jnp.float32)

        def one(agent: Agent, optimizer: PyTree, batch: EnvBatch, curriculum: Curriculum | None, key: Array, own: dict):
            rate = own["learning_rate"] * left
            own = own | {"learning_rate": rate, "actor_rate": jnp.where(number > held, rate, 0.0)}
            mine = envs if curriculum is None else (envs[0].with_fields(pool=curriculum.pool),)
            key = jax.random.fold_in(key, number)
            mine = _reweighted(mine, own)
            *changed, batch, transitions, log = method.update(options, own, mine, network, agent, optimizer, batch, key)
            curriculum, more = curricula.follow(envs[0].member, plan, curriculum, transitions.info, transitions.done)
            return *changed, batch, curriculum, log | more

        parts = state.agent, state.optimizer, state.rows, state.curriculum
        learned = {REWARDS + name: weight for name, weight in bounds.weights(state.multipliers, limits).items()}
        agent, optimizer, batch, curriculum, log = jax.vmap(one)(*parts, keys, numbers | learned)
        time_step = envs[0].member.scenario.time_step
        multipliers, told = bounds.follow(state.multipliers, limits, log["rewards"], time_step)
        unknown = state.best.update.max() == 0  # until the first evaluation, the latest agents are the best
        best = jax.tree.map(lambda old, new: jnp.where(unknown, new, old), state.best.agent, agent)
        state = replace(state, agent=agent, optimizer=optimizer, rows=batch, curriculum=curriculum, update=number)
        return replace(state, best=replace(state.best, agent=best), multipliers=multipliers), log | told

    def refill(envs: Envs, state: TrainState) -> TrainState:
        def one(agent: Agent, curriculum: Curriculum | None, start: Array) -> Curriculum:
            policy, key = policies.agent_policy(network, agent, terms), jax.random.fold_in(start, state.update)
            assert plan is not None and curriculum is not None
            return curricula.refill(envs[0].member, plan, curriculum, key, policy)

        return replace(state, curriculum=jax.vmap(one)(state.agent, state.curriculum, curriculum_keys))

    def evaluate(
        scenarios: tuple[Scenario, ...], envs: Envs, starts: tuple[State, ...], agents: Agent
    ) -> tuple[Array, list]:
        def one(agent: Agent, own: dict[str, Array]) -> list[dict[str, Any]]:
            policy = policies.agent_policy(network, agent, terms)
            each = zip(scenarios, _reweighted(envs, own), starts, strict=True)
            return [_evaluate_policy(scenario, env, policy, first, limits) for scenario, env, first in each]

        each = jax.vmap(one)(agents, numbers)
        return jnp.stack([numbers.pop("value") for numbers in each]).mean(0), each

    whole, placed = _sharding(layout.mesh), placement(layout)
    return Programs(
        jax.jit(begin),
        jax.jit(update, donate_argnums=1, out_shardings=(placed, whole)),
        jax.jit(evaluate, out_shardings=whole),
        jax.jit(refill, donate_argnums=1, out_shardings=placed),
        jax.jit(keep_best, out_shardings=placed),
    )


def keep_best(state: TrainState, value: Float[Array, "A"]) -> TrainState:
    """The state in which agents with a greater value than before are the best."""
    better = value > state.best.value
    latest = Best(state.agent, value, jnp.broadcast_to(state.update, value.shape))

    def choose(old: Array, new: Array) -> Array:
        return jnp.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)

    return replace(state, best=jax.tree.map(choose, state.best, latest))


def placement(layout: Layout) -> Any:
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


def _evaluate_policy(
    measured: Scenario, envs: Stack[mdp.Env], policy: Policy, starts: State, limits: dict[str, float]
) -> dict[str, Any]:
    """Means over episodes in which the agent takes the mean of its actions: return without costs, costs a minute, the
    metrics of ``measured``, and the value by which agents are compared.
    """
    steps = math.ceil(measured.time_limit / measured.time_step) + 1

    def episode(env: mdp.Env, start: State) -> tuple[tuple, Array, dict[str, Array]]:
        scenario = replace(env.scenario, metrics=measured.metrics)
        state = init_policy(scenario, policy, start)
        potentials = rewards.potentials(env.rewards, scenario, state)

        def one(carry: tuple, _) -> tuple[tuple, None]:
            before, then, total, spent, number, going = carry
            after, _ = policy_step(scenario, policy, before)
            now = rewards.potentials(env.rewards, scenario, after)
            parts = rewards.of_step(env.rewards, scenario, before, after, then, now)
            spent = {name: spent[name] + jnp.where(going, parts.pop(name), 0.0) for name in limits}
            total += jnp.where(going, jnp.stack(list(parts.values())).sum(), 0.0) if parts else 0.0
            ends = jnp.stack([after.completed, after.timed_out, *env.ends(scenario, before, after)])
            if env.terminations:  # completed and timed-out episodes are constant anyway
                after = jax.tree.map(lambda old, new: jnp.where(going, new, old), before, after)
            return (after, now, total, spent, number + going.astype(jnp.int32), going & ~ends.any()), None

        nothing = {name: jnp.zeros((), float) for name in limits}
        carry = state, potentials, jnp.zeros((), float), nothing, jnp.zeros((), jnp.int32), jnp.ones((), bool)
        (last, _, total, spent, number, _), _ = jax.lax.scan(one, carry, length=steps)
        return (total, spent, number), last.completed, results(scenario, last)

    floors = np.arange(min(envs.size, len(starts.tick)))
    (total, spent, lasted), completed, values = envs.take(floors).vmap(episode)(starts)
    minutes, terms = lasted.sum().astype(float) * (measured.time_step / 60.0), dict(envs.member.rewards)
    rates = {name: part.sum() / terms[name].weight / minutes for name, part in spent.items()}
    numbers = {"return": total.mean(), "completed": completed.mean(dtype=jnp.float32)}
    numbers |= {"value": total.mean() - bounds.penalty(rates, limits)}
    numbers |= {f"{name} a minute": rate for name, rate in rates.items()}
    return numbers | {name: jnp.nanmean(value, 0) for name, value in values.items()}


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
    scenarios, envs, network = setting
    resumes = processes.on_first_process(lambda: check_config(options.folder, config))
    placed, total = device_layout(len(options.agents)), options.updates
    if not placed.shares_agents and options.scenarios // len(envs) % placed.mesh.size:
        text = f"scenarios: {options.scenarios} do not spread evenly over {placed.mesh.size} devices"
        text += f" in {len(envs)} environments" if len(envs) > 1 else ""
        raise InputError(f"{text}; take a multiple.")
    if idle := unused_devices(len(options.agents)):
        say(console, idle)
    run = programs(options, network, placed)
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
        if options.noise is not None:
            agents = with_noise(agents, options.noise)
        state = run.begin(envs, agents)
        scenarios, envs, starts = devices.replicate(placed.mesh, (scenarios, envs, starts))
        setting = Setting(scenarios, envs, network)
        recent = Recent()
        loop = Loop(
            advance=lambda state: _advance(options, run, setting, starts, state, tell, recent),
            is_over=lambda state: int(state.update) >= total,
            done=lambda state: int(state.update),
            place=lambda state: devices.place(state, placement(placed)),
            encode=_encode,
            decode=_decode,
        )
        return trainer.fit(options.folder, config, state, loop, total, tell, callbacks)


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
        words, number = "no episode has ended", self._number()
        if number:
            value, completed = (sum(each[name] for each in self._updates) / number for name in ("return", "completed"))
            words = f"last {number:,.0f} episodes: return {value:.1f}, completed {completed:.0%}"
        speeds = list(self._speeds)[1:]  # the first update was compiled
        if speeds:
            words += f" · {sum(steps for steps, _ in speeds) / sum(seconds for _, seconds in speeds):,.0f} steps/s"
        return words

    def _number(self) -> float:
        return sum(each["number"] for each in self._updates)


def _advance(
    options: ReinforcementConfig,
    run: Programs,
    setting: Setting,
    starts: tuple[State, ...],
    state: TrainState,
    tell: Progress,
    recent: Recent,
) -> tuple[TrainState, Report]:
    """An update, and an evaluation if it is due."""
    start = time.time()
    state, log = run.update(setting.envs, state)
    number, log = int(state.update), jax.tree.map(np.asarray, log)
    if state.curriculum is not None and number % options.curriculum_every == 0:
        state = run.refill(setting.envs, state)
    if not np.isfinite(log["train"]["loss"]).all():
        where = f"the loss is not finite in update {number}; {options.folder} keeps the checkpoints until then"
        raise FloatingPointError(f"{where}; try a lower --learning-rate in another folder.")
    steps, seconds = options.scenarios * options.horizon, time.time() - start
    rate = len(options.agents) * steps / seconds
    line: dict[str, Any] = {"epoch": number, "steps": number * steps, "seconds": seconds, "per_second": rate}
    line |= {part: _finite_means(values) for part, values in log.items()}
    recent.add(log["episodes"], len(options.agents) * steps, seconds)
    due = number % options.evaluate_every == 0 or number == options.updates
    if due:
        with tell.aside("evaluating"):
            state, evaluation = _evaluate(options, run, setting, starts, state)
        line |= evaluation
    loss = -float(np.sum(np.asarray(state.best.value, float)))
    return state, Report(number, line, loss, due, f"update {number} · {recent.note()}")


def _first_agents(options: ReinforcementConfig, setting: Setting) -> Agent:
    """The agents before the first update, (A, ...).

    Raises:
        InputError: the pretrained agent is missing, or sees something else.
        IncompleteError: its checkpoint cannot be read.
    """
    (scenario, *_), env, network = setting.scenarios, setting.envs[0].member, setting.network
    keys = jnp.stack([random_streams.key("weights", int(agent["seed"])) for agent in options.agents])
    if options.pretrained is None:
        return jax.jit(lambda keys: init_agents(network, env.observations, env.observation_space, keys))(keys)
    agent = policies.load_agent(_agent_folder(options.pretrained), scenario)[1]
    return jax.tree.map(lambda part: jnp.broadcast_to(part[None], (keys.shape[0], *part.shape)), agent)


def _imitate(options: ReinforcementConfig, setting: Setting, teachers: tuple[Policy, ...], agents: Agent) -> Agent:
    """The agents after they have learned from another policy, (A, ...)."""
    keys = jnp.stack([random_streams.key("imitation", int(agent["seed"])) for agent in options.agents])

    clone = jax.vmap(functools.partial(dagger.clone, options, setting.network), (None, None, 0, 0))
    agents, errors = jax.jit(clone)(setting.envs, teachers, agents, keys)
    if not np.isfinite(np.asarray(errors)).all():
        raise FloatingPointError(f"imitate: what {teachers[0].name} does is not finite; choose another --imitate.")
    return agents


def _evaluate(
    options: ReinforcementConfig, run: Programs, setting: Setting, starts: tuple[State, ...], state: TrainState
) -> tuple[TrainState, dict[str, dict]]:
    """The state with its best agents, and the evaluation: means of all environments and agents, and, if there are
    several, of each environment and of each agent."""
    scenarios, envs, _ = setting
    value, each = run.evaluate(scenarios, tuple(env.with_fields(pool=None) for env in envs), starts, state.agent)
    state = run.keep_best(state, jnp.asarray(value, jnp.float32))
    each = jax.tree.map(np.asarray, each)
    names = ["", *(f" in {name}" for name, _ in scenarios[0].situations)]
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a situation that never occurred
        agents = {name: np.nanmean([one[name] for one in each], 0) for name in each[0]}
        mean, *places = [{name: np.nanmean(part, 0) for name, part in one.items()} for one in (agents, *each)]
    line = {"evaluation": _by_situation(names, mean)}
    if len(places) > 1:
        pairs = zip(environment_names(options, scenarios), places, strict=True)
        line |= {f"evaluation in {place}": _by_situation(names, part) for place, part in pairs}
    if (count := value.shape[0]) > 1:
        parts = [{name: part[number] for name, part in agents.items()} for number in range(count)]
        line |= {f"agent {number}": _by_situation(names, part) for number, part in enumerate(parts)}
    return state, line


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
    saved, current = user_parts.by_content(policies.read_options(folder)), user_parts.by_content(options)
    for name in ("observations", "critic", "width", "layers", "recurrent", "bfloat16", "network", "distribution"):
        if saved[name] != current[name]:
            raise InputError(f"pretrained: {folder} has {name} {saved[name]}, not {current[name]}; ask for the same.")
