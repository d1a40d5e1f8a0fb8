"""``sean train ppo``: proximal policy optimization in one compiled program an update, with checkpoints.

An update steps all scenarios together for some steps, estimates advantages, and goes through what was seen in
minibatches of whole scenarios. A value is bootstrapped where the time limit truncates an episode, from the observation
before the reset, and not where the task ends. Chance depends on (seed, update) and on the states of the scenarios,
which checkpoints hold, so a training that was stopped goes on to the same curve.

Source: J. Schulman et al., "Proximal policy optimization algorithms", 2017; "High-dimensional continuous control using
generalized advantage estimation", ICLR 2016.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Bool, Float, PyTree
from rich.console import Console

from sean_jax import devices, files, mdp, prng, registry, writing
from sean_jax.base import Array, Scenario
from sean_jax.config import PPOConfig, validate
from sean_jax.episodes import init_policy, policy_step
from sean_jax.errors import InputError
from sean_jax.flags import command
from sean_jax.learning import curriculum as curricula
from sean_jax.learning import driving
from sean_jax.learning.actor_critic import (
    ActorCritic,
    Agent,
    Answer,
    answer,
    entropy,
    init_agent,
    log_density,
    update_statistics,
)
from sean_jax.learning.checkpoints import Checkpoints, check_config, write_config
from sean_jax.learning.logs import Log
from sean_jax.learning.manifests import CONFIG
from sean_jax.mdp import observations, rewards
from sean_jax.progress import progress
from sean_jax.scenario import reset, results
from sean_jax.versions import versions

VALUE_WEIGHT = 0.5  # of the critic's loss
MAX_GRADIENT_NORM = 0.5
FEW = 1e-8
TOLD = ("rewards", "completed", "episode_return", "episode_length", "start", "situations")


@struct.dataclass
class TrainState:
    """Everything on which the rest of a training depends. The field names are those of the checkpoints on disk."""

    agent: Agent
    optimizer: optax.OptState
    envs: mdp.EnvState  # (B, ...)
    observation: dict[str, Array]  # (B, ...)
    memory: Float[Array, "B M"]  # of the network
    start: Bool[Array, "B"]  # whether the observation is the first of an episode
    update: Array  # () int32, updates done
    best: Array  # () highest return in an evaluation so far
    best_update: Array  # () int32
    curriculum: curricula.Curriculum | None = None  # None: all starts of the pool are alike


class Seen(NamedTuple):
    """What a step of a scenario gives, or stacked (T, B, ...)."""

    vector: Float[Array, "F"]
    images: dict[str, Array]
    start: Bool[Array, ""]
    action: Float[Array, "2"]
    log_density: Float[Array, ""]
    value: Float[Array, ""]
    reward: Float[Array, ""]
    over: Bool[Array, ""]  # the episode ended with this step
    final_value: Float[Array, ""]  # of what followed a truncation; 0 where none was
    told: dict[str, Any]  # for the log


class Programs(NamedTuple):
    """The compiled functions of a training. Each compiles at its first call."""

    begin: Callable  # (env, agent) -> TrainState
    update: Callable  # (env, state) -> (state, numbers for the log)
    evaluate: Callable  # (scenario, agent, env) -> numbers for the log
    refill: Callable  # (env, state) -> state with other starts


def train(options: PPOConfig, console: Console | Callable[[float], None] | None = None) -> TrainState:
    """Train an agent, or continue its training, in the folder of the options.

    Args:
        options: what to train.
        console: shows the progress; a function receives the fraction done instead, and None shows nothing.

    Returns:
        The state after the last update. ``learning.load`` reads the best agent from the folder.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process trains in the folder.
        IncompleteError: a file is damaged or cannot be written. The checkpoints stay.
        FloatingPointError: the loss is not finite. The checkpoints stay.
    """
    config = _config(options)
    check_config(options.folder, config)  # refuses before anything is written
    scenario, env, network = build(options)
    with writing.folder_lock(options.folder):
        return _train(options, console, scenario, env, network, config)


def build(options: PPOConfig) -> tuple[Scenario, mdp.Env, ActorCritic]:
    """What is trained, and where.

    Args:
        options: of the training.

    Returns:
        The scenario of evaluations, the environment of the training, without a pool, and the network.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    env = curricula.prepare(registry.build(options), options.curriculum)
    return env.scenario, replace(env, scenario=replace(env.scenario, metrics=())), _network(options, env.observations)


def _network(options: PPOConfig, terms: observations.Terms) -> ActorCritic:
    images = tuple(name for name, term in terms if term.image)
    return ActorCritic(options.width, options.layers, images, options.recurrent)


def updates(options: PPOConfig) -> int:
    """How many updates a training has.

    Args:
        options: of the training.

    Returns:
        The number.
    """
    return max(1, math.ceil(options.steps / (options.scenarios * options.horizon)))


def programs(options: PPOConfig, network: ActorCritic) -> Programs:
    """The compiled functions of a training.

    Args:
        options: sizes, optimizer and seed.
        network: what is trained.

    Returns:
        Functions, of which ``update`` reuses (donates) the memory of the state that it receives.
    """
    optimizer, plan = _optimizer(options), curricula.plan(options.curriculum)
    seed_key, starts_key = prng.key("training", options.seed), prng.key("curriculum", options.seed)

    def begin(env: mdp.Env, agent: Agent) -> TrainState:
        keys = jax.random.split(jax.random.fold_in(seed_key, 0), options.scenarios)
        observation, envs = jax.vmap(env.reset)(keys)
        driver, first_key = driving.policy(network, agent, env.observations), jax.random.fold_in(starts_key, 0)
        return TrainState(
            agent=agent,
            optimizer=optimizer.init(agent.parameters),
            envs=envs,
            observation=observation,
            memory=jnp.zeros((options.scenarios, network.memory_size), jnp.float32),
            start=jnp.ones(options.scenarios, bool),
            update=jnp.zeros((), jnp.int32),
            best=jnp.full((), -jnp.inf, jnp.float32),
            best_update=jnp.zeros((), jnp.int32),
            curriculum=plan and curricula.init(env, plan, first_key, options.pool, driver),
        )

    def update(env: mdp.Env, state: TrainState) -> tuple[TrainState, dict[str, Any]]:
        key = jax.random.fold_in(seed_key, state.update + 1)
        first_memory = state.memory
        env = env if state.curriculum is None else replace(env, pool=state.curriculum.pool)
        state, seen = _collect(env, network, state, options.horizon, key)
        last = _say(network, state.agent, env.observations, state.observation, state.memory, state.start)
        advantage = _advantages(seen, last.value, options)
        returns = advantage + seen.value
        learned = _learn(options, network, optimizer, state.agent, state.optimizer, seen, first_memory, advantage, key)
        agent, optimizer_state, losses = learned
        agent = replace(agent, statistics=update_statistics(agent.statistics, _rows(seen.vector)))
        numbers = {
            "train": losses | {"explained_variance": _explained(seen.value, returns)},
            "episodes": _of_episodes(seen),
            "rewards": {name: part.mean() for name, part in seen.told["rewards"].items()},
        }
        curriculum, told = curricula.follow(env, plan, state.curriculum, seen.told, seen.over)
        state, numbers = replace(state, curriculum=curriculum), numbers | told
        done = state.update + 1
        return replace(state, agent=agent, optimizer=optimizer_state, update=done), numbers

    def evaluate(scenario: Scenario, agent: Agent, env: mdp.Env) -> dict[str, Any]:
        keys = jax.random.split(prng.key("evaluation", options.seed), options.evaluation_episodes)
        return _evaluate(scenario, env, driving.policy(network, agent, env.observations), keys)

    def refill(env: mdp.Env, state: TrainState) -> TrainState:
        assert plan is not None and state.curriculum is not None
        key = jax.random.fold_in(starts_key, state.update)
        driver = driving.policy(network, state.agent, env.observations)
        return replace(state, curriculum=curricula.refill(env, plan, state.curriculum, key, driver))

    update = jax.jit(update, donate_argnums=1)
    return Programs(jax.jit(begin), update, jax.jit(evaluate), jax.jit(refill, donate_argnums=1))


# ------------------------------------------------------------------ an update


def _say(
    network: ActorCritic, agent: Agent, terms: observations.Terms, seen: dict, memory: Array, start: Array
) -> Answer:
    """The answer to a batch of observations."""
    vector = jax.vmap(functools.partial(observations.flatten, terms))(seen).astype(jnp.float32)
    images = {name: seen[name].astype(jnp.float32) for name in network.images}
    return answer(network, agent, vector, images, memory, start)


def _collect(env: mdp.Env, network: ActorCritic, state: TrainState, steps: int, key: Array) -> tuple[TrainState, Seen]:
    """``steps`` steps of all scenarios."""

    def one(carry: tuple, tick: Array) -> tuple[tuple, Seen]:
        envs, observation, memory, start = carry
        action_key, next_key = jax.random.split(jax.random.fold_in(key, tick))
        said = _say(network, state.agent, env.observations, observation, memory, start)
        noise = jax.random.normal(action_key, said.mean.shape, said.mean.dtype)
        action = said.mean + jnp.exp(said.log_std) * noise
        keys = jax.random.split(next_key, start.shape[0])
        following, envs, reward, terminated, truncated, info = jax.vmap(env.step)(keys, envs, action)
        over = terminated | truncated
        final = _say(
            network, state.agent, env.observations, info["final_observation"], said.memory, jnp.zeros_like(over)
        )
        seen = Seen(
            vector=jax.vmap(functools.partial(observations.flatten, env.observations))(observation).astype(jnp.float32),
            images={name: observation[name].astype(jnp.float32) for name in network.images},
            start=start,
            action=action,
            log_density=log_density(said, action),
            value=said.value,
            reward=reward.astype(jnp.float32),
            over=over,
            final_value=jnp.where(truncated, final.value, 0.0),
            told={name: info[name] for name in TOLD},
        )
        return (envs, following, said.memory, over), seen

    carry = state.envs, state.observation, state.memory, state.start
    (envs, observation, memory, start), seen = jax.lax.scan(one, carry, jnp.arange(steps, dtype=jnp.int32))
    return replace(state, envs=envs, observation=observation, memory=memory, start=start), seen


def _advantages(seen: Seen, last_value: Array, options: PPOConfig) -> Float[Array, "T B"]:
    """Generalized advantage estimates; an episode that was truncated is worth what followed."""

    def back(carry: tuple[Array, Array], step: Seen) -> tuple[tuple[Array, Array], Array]:
        advantage, following = carry
        following = jnp.where(step.over, step.final_value, following)
        error = step.reward + options.discount * following - step.value
        decay = jnp.where(step.over, 0.0, options.discount * options.advantage_decay)
        advantage = error + decay * advantage
        return (advantage, step.value), advantage

    nothing = jnp.zeros_like(last_value)
    _, advantage = jax.lax.scan(back, (nothing, last_value), seen._replace(vector=(), images={}, told={}), reverse=True)
    return advantage


def _learn(
    options: PPOConfig,
    network: ActorCritic,
    optimizer: optax.GradientTransformation,
    agent: Agent,
    optimizer_state: optax.OptState,
    seen: Seen,
    memory: Float[Array, "B M"],
    advantage: Float[Array, "T B"],
    key: Array,
) -> tuple[Agent, optax.OptState, dict[str, Array]]:
    """Steps of the optimizer over minibatches of whole scenarios."""
    data = seen._replace(told={}), advantage, advantage + seen.value

    def loss(parameters: PyTree, part: tuple, memory: Array) -> tuple[Array, dict[str, Array]]:
        steps, gain, wanted = part
        said = _unroll(network, replace(agent, parameters=parameters), steps, memory)
        change = log_density(said, steps.action) - steps.log_density
        ratio = jnp.exp(change)
        gain = (gain - gain.mean()) / (gain.std() + FEW)
        clipped = jnp.clip(ratio, 1.0 - options.clip, 1.0 + options.clip)
        actor = -jnp.minimum(ratio * gain, clipped * gain).mean()
        critic = 0.5 * ((said.value - wanted) ** 2).mean()
        spread = entropy(said).mean()
        total = actor + VALUE_WEIGHT * critic - options.entropy * spread
        told = {
            "loss": total,
            "actor": actor,
            "critic": critic,
            "entropy": spread,
            "divergence": ((ratio - 1.0) - change).mean(),
            "clipped": (jnp.abs(ratio - 1.0) > options.clip).mean(dtype=jnp.float32),
        }
        return total, told

    def step(carry: tuple, rows: Array) -> tuple[tuple, dict[str, Array]]:
        parameters, optimizer_state = carry
        part = jax.tree.map(lambda leaf: leaf[:, rows], data)
        gradient, told = jax.grad(loss, has_aux=True)(parameters, part, memory[rows])
        with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
            change, optimizer_state = optimizer.update(gradient, optimizer_state, parameters)
        return (optax.apply_updates(parameters, change), optimizer_state), told

    def epoch(carry: tuple, key: Array) -> tuple[tuple, dict[str, Array]]:
        order = jax.random.permutation(key, options.scenarios).reshape(options.minibatches, -1)
        return jax.lax.scan(step, carry, order)

    keys = jax.random.split(jax.random.fold_in(key, 2**31 - 1), options.epochs)
    (parameters, optimizer_state), told = jax.lax.scan(epoch, (agent.parameters, optimizer_state), keys)
    return replace(agent, parameters=parameters), optimizer_state, jax.tree.map(jnp.mean, told)


def _unroll(network: ActorCritic, agent: Agent, steps: Seen, memory: Array) -> Answer:
    """Answers to (T, B) observations in a row."""
    if not network.recurrent:
        empty = jnp.zeros((*steps.start.shape, 0), jnp.float32)
        return answer(network, agent, steps.vector, steps.images, empty, steps.start)

    def one(memory: Array, step: Seen) -> tuple[Array, Answer]:
        said = answer(network, agent, step.vector, step.images, memory, step.start)
        return said.memory, said

    return jax.lax.scan(one, memory, steps)[1]


def _rows(vectors: Float[Array, "T B F"]) -> Float[Array, "K F"]:
    return vectors.reshape(-1, vectors.shape[-1])


def _explained(value: Array, wanted: Array) -> Array:
    return 1.0 - (wanted - value).var() / jnp.maximum(wanted.var(), FEW)


def _of_episodes(seen: Seen) -> dict[str, Array]:
    """Of the episodes that ended in an update: how many, and means, which are NaN if none did."""
    over = seen.over.astype(jnp.float32)
    number = over.sum()

    def mean(values: Array) -> Array:
        return (values.astype(jnp.float32) * over).sum() / number

    told = seen.told
    return {
        "number": number,
        "return": mean(told["episode_return"]),
        "steps": mean(told["episode_length"]),
        "completed": mean(told["completed"]),
    }


def _evaluate(scenario: Scenario, env: mdp.Env, policy: Any, keys: Array) -> dict[str, Any]:
    """Means over episodes in which the agent takes the mean of its actions: return, and all metrics."""
    steps = math.ceil(scenario.time_limit / scenario.time_step) + 1

    def episode(key: Array) -> tuple[Array, Array, dict[str, Array]]:
        state = init_policy(scenario, policy, reset(scenario, key))
        potentials = rewards.potentials(env.rewards, scenario, state)

        def one(carry: tuple, _) -> tuple[tuple, None]:
            before, then, total = carry
            after, _ = policy_step(scenario, policy, before)
            now = rewards.potentials(env.rewards, scenario, after)
            parts = rewards.of_step(env.rewards, scenario, before, after, then, now)
            going = ~(before.completed | before.timed_out)
            return (after, now, total + jnp.where(going, jnp.stack(list(parts.values())).sum(), 0.0)), None

        carry = state, potentials, jnp.zeros((), float)
        (last, _, total), _ = jax.lax.scan(one, carry, length=steps)
        return total, last.completed, results(scenario, last)

    total, completed, measured = jax.vmap(episode)(keys)
    numbers = {"return": total.mean(), "completed": completed.mean(dtype=jnp.float32)}
    return numbers | {name: jnp.nanmean(value, 0) for name, value in measured.items()}


# ------------------------------------------------------------------ the training


def _optimizer(options: PPOConfig) -> optax.GradientTransformation:
    steps = updates(options) * options.epochs * options.minibatches
    rate = optax.linear_schedule(options.learning_rate, 0.0, steps)
    return optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), optax.adam(rate, eps=1e-5))


def _train(
    options: PPOConfig,
    console: Console | Callable[[float], None] | None,
    scenario: Scenario,
    env: mdp.Env,
    network: ActorCritic,
    config: dict[str, Any],
) -> TrainState:
    """Train in a folder that this process has locked."""
    resumes, mesh = check_config(options.folder, config), devices.mesh()
    run, number = programs(options, network), updates(options)
    with progress(console) as tell:
        tell.stage("drawing starts")
        agent = init_agent(network, env.observations, env.observation_space, prng.key("weights", options.seed))
        if options.pretrained is not None:
            agent = _pretrained(options, agent)
        pool_key = jax.random.fold_in(prng.key("training", options.seed), 2**31 - 1)
        if options.curriculum == "none":
            env = jax.jit(mdp.Env.with_pool, static_argnums=2)(env, pool_key, options.pool)
        state = run.begin(env, agent)
        if not resumes:
            write_config(options.folder, config)
        checkpoints = Checkpoints(options.folder, writes=True)
        saved = checkpoints.latest(_plain(state)) if resumes else None
        state = state if saved is None else _typed(saved, state)
        env, state = devices.replicate(mesh, env), _spread(mesh, state, options.scenarios)
        log = Log(options.folder, int(state.update))
        tell.start("training", number)
        try:
            while int(state.update) < number:
                begun = time.time()
                state, numbers = run.update(env, state)
                done, numbers = int(state.update), jax.tree.map(np.asarray, numbers)
                if state.curriculum is not None and done % options.curriculum_every == 0:
                    state = run.refill(env, state)
                _check_finite(numbers, done, options)
                took = time.time() - begun
                rate = options.scenarios * options.horizon / took
                line = {"epoch": done, "steps": done * options.scenarios * options.horizon, "per_second": rate}
                line |= {part: _numbers(each) for part, each in numbers.items()}
                due = done % options.evaluate_every == 0 or done == number
                if due:
                    state, line["evaluation"] = _judge(run, scenario, env, state)
                log.add(line | {"time": time.time()})  # before the checkpoint: what follows it is dropped at a restart
                if due:
                    checkpoints.save(_plain(state), done, -line["evaluation"]["return"])
                episodes, best = numbers["episodes"], f"best {float(state.best):.1f}"
                note = f"return {float(episodes['return']):.1f}, completed {float(episodes['completed']):.0%}, {best}"
                tell.update(done, f"update {done} · {note}, {rate:,.0f} steps/s")
        finally:
            checkpoints.wait()
    return state


def _judge(run: Programs, scenario: Scenario, env: mdp.Env, state: TrainState) -> tuple[TrainState, dict]:
    """The state with its best evaluation, and what this one found."""
    found = jax.tree.map(np.asarray, run.evaluate(scenario, state.agent, replace(env, pool=None)))
    if float(found["return"]) > float(state.best):
        state = replace(state, best=jnp.asarray(found["return"], jnp.float32), best_update=state.update + 0)
    names = ["", *(f" in {name}" for name, _ in scenario.situations)]
    told = {}
    for name, value in found.items():
        split = value.reshape(-1)
        for column, part in zip(names, split, strict=False):
            if np.isfinite(part):
                told[name + column] = float(part)
    return state, told


def _numbers(values: dict[str, np.ndarray]) -> dict[str, float]:
    """What is finite, as JSON has words for."""
    return {name: float(value) for name, value in values.items() if np.isfinite(value)}


def _check_finite(numbers: dict[str, Any], done: int, options: PPOConfig) -> None:
    if not np.isfinite(numbers["train"]["loss"]):
        where = f"the loss is not finite in update {done}; {options.folder} keeps the checkpoints until then"
        raise FloatingPointError(f"{where}; try a lower --learning-rate in another folder.")


def _plain(tree: PyTree) -> PyTree:
    """What checkpoints can hold: keys as numbers, and one number for an array of none."""
    return jax.tree.map(lambda leaf: leaf if leaf.size else jnp.zeros(1, leaf.dtype), prng.as_numbers(tree))


def _typed(plain: PyTree, like: PyTree) -> PyTree:
    """The inverse of ``_plain``."""
    return prng.as_keys(jax.tree.map(lambda leaf, one: leaf if one.size else one, plain, like), like)


def _spread(mesh: Any, state: TrainState, scenarios: int) -> TrainState:
    """The scenarios on all devices, and all else on each."""
    if scenarios % mesh.size:
        raise InputError(f"scenarios: {scenarios} do not spread evenly over {mesh.size} devices; take a multiple.")
    split, whole = NamedSharding(mesh, PartitionSpec(devices.AXIS)), NamedSharding(mesh, PartitionSpec())
    own = {"envs", "observation", "memory", "start"}
    parts = {
        field.name: jax.device_put(getattr(state, field.name), split if field.name in own else whole)
        for field in dataclasses.fields(state)  # pyright: ignore[reportArgumentType]
    }
    return TrainState(**parts)


def _config(options: PPOConfig) -> dict[str, Any]:
    return {
        "command": command("train", options),
        "method": options.method,
        **options.decisive(),
        "devices": len(jax.devices()),
        "versions": versions(),
    }


def load(folder: Path, scenario: Scenario) -> tuple[ActorCritic, Agent, observations.Terms]:
    """The best agent of a training.

    Args:
        folder: of the training.
        scenario: where it will drive.

    Returns:
        The network, the agent, and the terms of its observation.

    Raises:
        InputError: there is no checkpoint, or the agent learned from observations of another size.
        IncompleteError: the checkpoint cannot be read.
    """
    options = _read_options(folder)
    known = registry.observation_terms(options)
    network = _network(options, known)
    shapes = jax.eval_shape(lambda scenario: reset(scenario, jax.random.key(0)), scenario)
    space = observations.space(known, scenario, shapes)
    agent = jax.eval_shape(lambda: init_agent(network, known, space, jax.random.key(0)))
    return network, Checkpoints(folder).best("agent", agent), known


def _read_options(folder: Path) -> PPOConfig:
    """Those of the training in a folder."""
    if not (folder / CONFIG).is_file():
        raise InputError(f"{folder} has no trained agent; make one with `sean train ppo --out {folder}`.")
    saved = files.read_json(folder / CONFIG)
    try:
        return validate(PPOConfig, {name: saved[name] for name in saved if name in PPOConfig.model_fields})
    except InputError as error:
        raise InputError(f"{folder / CONFIG}: {error}") from None


def _pretrained(options: PPOConfig, agent: Agent) -> Agent:
    """The best agent of another training, which must have seen the same and be of the same size."""
    folder = Path(str(options.pretrained))
    had, asked = _read_options(folder).decisive(), options.decisive()
    for name in ("observations", "width", "layers", "recurrent"):
        if had[name] != asked[name]:
            raise InputError(f"pretrained: {folder} has {name} {had[name]}, not {asked[name]}; ask for the same.")
    return Checkpoints(folder).best("agent", agent)
