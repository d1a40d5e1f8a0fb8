"""``sean train ppo`` and ``sean train apg``: training from rewards, with checkpoints, evaluations and several agents.

An update is one compiled program: all scenarios take some steps, and the agent learns from them (``ppo``, ``shac``).
Several environments share the scenarios equally, and the agent learns from all of them together.
Agents of different seeds and numbers are trained side by side, along a leading axis A. Chance depends on (seed, update)
and on the states of the scenarios, which checkpoints hold, so a training that was stopped goes on to the same curve.
Processes that ``jax.distributed`` has joined train together: scenarios are spread over the devices of all of them.
"""

import contextlib
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
from jaxtyping import Int, PyTree
from rich.console import Console

from sean_jax import components, devices, mdp, prng, registry, writing
from sean_jax.base import Array, Policy, Scenario
from sean_jax.config import ReinforcementConfig
from sean_jax.episodes import init_policy, policy_step
from sean_jax.errors import InputError
from sean_jax.flags import command
from sean_jax.learning import agents, choice, cloning, driving, ppo, processes, rollouts, shac
from sean_jax.learning import curriculum as curricula
from sean_jax.learning.actor_critic import ActorCritic, Agent, init_agents, with_noise
from sean_jax.learning.checkpoints import Checkpoints, check_config, write_config
from sean_jax.learning.curriculum import Curriculum
from sean_jax.learning.curves import draw_curve, sparkline
from sean_jax.learning.logs import Log
from sean_jax.learning.rollouts import Rows
from sean_jax.learning.trained import Best, load
from sean_jax.mdp import rewards
from sean_jax.progress import progress
from sean_jax.scenario import reset, results
from sean_jax.versions import versions

REWARDS = "rewards."  # what numbers of a sweep begin with that are weights

TRAINERS = {"ppo": ppo, "apg": shac}
"""Method -> the module that has its ``init`` and ``update``."""


@struct.dataclass
class TrainState:
    """Everything on which the rest of a training depends. The field names are those of the checkpoints on disk."""

    agent: Agent  # (A, ...)
    optimizer: PyTree  # (A, ...)
    rows: Rows  # (A, B, ...)
    best: Best
    curriculum: Curriculum | None  # (A, ...); None: all starts of the pool are alike
    update: Int[Array, ""]  # updates done


class Programs(NamedTuple):
    """The compiled functions of a training. Each compiles at its first call."""

    begin: Callable  # (envs, agents) -> TrainState
    update: Callable  # (envs, state) -> (state, numbers for the log, (A, ...))
    evaluate: Callable  # (scenarios, envs, agents) -> mean return, (A,), and numbers of each for the log, (A, ...)
    refill: Callable  # (envs, state) -> state with other starts


def train(options: ReinforcementConfig, console: Console | Callable[[float], None] | None = None) -> TrainState:
    """Train agents, or continue their training, in the folder of the options.

    Args:
        console: shows the progress; a function receives the fraction done instead, and None shows nothing.

    Returns:
        The state after the last update. ``learning.load`` reads the best agent from the folder.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process trains in the folder.
        IncompleteError: a file is damaged or cannot be written. The checkpoints stay.
        FloatingPointError: the loss is not finite. The checkpoints stay.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(components.read_once())
        config = processes.together(lambda: _config(options))
        processes.by_first(lambda: check_config(options.folder, config))  # refuses before anything is written
        scenarios, envs, network = processes.together(lambda: build(options))
        processes.by_first(lambda: stack.enter_context(writing.folder_lock(options.folder)))
        return _train(options, console, scenarios, envs, network, config)


def build(options: ReinforcementConfig) -> tuple[tuple[Scenario, ...], tuple[mdp.Env, ...], ActorCritic]:
    """What is trained, and where.

    Returns:
        The scenario of evaluations in each environment, and the ``Env`` of the training, without a pool, and the
        network.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    if options.imitate is not None:
        choice.check(options.imitate, options, "imitate")
    if options.pretrained is not None:
        _check_pretrained(options, options.pretrained)
    for each in options.per_environment:
        registry.check(each)
    terms = sum(agents.terms(options), ())
    built = [curricula.prepare(registry.build(each), options.curriculum) for each in options.per_environment]
    envs = [replace(env, observations=terms) for env in built]
    rewards.reweighted(envs[0].rewards, _weights(options.agents[0]))  # refuses what is none of its terms
    _check_alike(envs)
    network = agents.network(options, envs[0].observation_space)
    measured = tuple(env.scenario for env in envs)
    return measured, tuple(replace(env, scenario=replace(env.scenario, metrics=())) for env in envs), network


def _check_alike(envs: Sequence[mdp.Env]) -> None:
    """Refuse environments of one name, whose evaluations could not be told apart, and those that show other sizes."""
    names = [env.scenario.environment.name for env in envs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"environment: {twice[0]} is there more than once; give each once.")
    first, *others = [{name: box.shape for name, box in env.observation_space.items()} for env in envs]
    for name, shapes in zip(names[1:], others, strict=True):
        for term in (term for term in first if shapes[term] != first[term]):
            sizes = f"{term} of the size {shapes[term]}, and {names[0]} {first[term]}"
            raise InputError(f"observations: {name} shows {sizes}; leave it out, or train in one of them.")


def updates(options: ReinforcementConfig) -> int:
    """How many updates a training has."""
    return max(1, math.ceil(options.steps / (options.scenarios * options.horizon)))


def programs(options: ReinforcementConfig, network: ActorCritic, over: Mesh) -> Programs:
    """The compiled functions of a training.

    Returns:
        Functions, of which ``update`` reuses (donates) the memory of the state that it receives.
    """
    trainer: Any = TRAINERS[options.method]
    keys = jnp.stack([prng.key("training", int(agent["seed"])) for agent in options.agents])
    numbers = {
        name: jnp.asarray([agent[name] for agent in options.agents], jnp.float32)
        for name in options.agents[0]
        if name != "seed"
    }
    number, plan, (seen, _) = updates(options), curricula.plan(options.curriculum), agents.terms(options)
    starts = jnp.stack([prng.key("curriculum", int(agent["seed"])) for agent in options.agents])

    def begin(envs: tuple[mdp.Env, ...], first: Agent) -> TrainState:
        def one(agent: Agent, key: Array, start: Array) -> tuple[PyTree, Rows, Curriculum | None]:
            rows = rollouts.begin(envs, network, jax.random.fold_in(key, 0), options.scenarios)
            driver, start = driving.policy(network, agent, seen), jax.random.fold_in(start, 0)
            return trainer.init(agent), rows, plan and curricula.init(envs[0], plan, start, options.pool, driver)

        optimizer, rows, curriculum = jax.vmap(one)(first, keys, starts)
        count = keys.shape[0]
        best = Best(first, jnp.full(count, -jnp.inf, jnp.float32), jnp.zeros(count, jnp.int32))
        return TrainState(first, optimizer, rows, best, curriculum, jnp.zeros((), jnp.int32))

    def update(envs: tuple[mdp.Env, ...], state: TrainState) -> tuple[TrainState, dict[str, Any]]:
        done = state.update + 1
        left = 1.0 - state.update.astype(jnp.float32) / number

        def one(agent: Agent, optimizer: PyTree, rows: Rows, curriculum: Curriculum | None, key: Array, own: dict):
            own = own | {"learning_rate": own["learning_rate"] * left}
            where = envs if curriculum is None else (replace(envs[0], pool=curriculum.pool),)
            where = tuple(replace(env, rewards=rewards.reweighted(env.rewards, _weights(own))) for env in where)
            key = jax.random.fold_in(key, done)
            *changed, rows, seen, told = trainer.update(options, own, where, network, agent, optimizer, rows, key)
            curriculum, more = curricula.follow(envs[0], plan, curriculum, seen.told, seen.over)
            return *changed, rows, curriculum, told | more

        parts = state.agent, state.optimizer, state.rows, state.curriculum
        agent, optimizer, rows, curriculum, told = jax.vmap(one)(*parts, keys, numbers)
        state = replace(state, agent=agent, optimizer=optimizer, rows=rows, curriculum=curriculum, update=done)
        return state, told

    def refill(envs: tuple[mdp.Env, ...], state: TrainState) -> TrainState:
        def one(agent: Agent, curriculum: Curriculum | None, start: Array) -> Curriculum:
            driver, key = driving.policy(network, agent, seen), jax.random.fold_in(start, state.update)
            assert plan is not None and curriculum is not None
            return curricula.refill(envs[0], plan, curriculum, key, driver)

        return replace(state, curriculum=jax.vmap(one)(state.agent, state.curriculum, starts))

    def evaluate(scenarios: tuple[Scenario, ...], envs: tuple[mdp.Env, ...], several: Agent) -> tuple[Array, list]:
        chosen = jax.random.split(prng.key("evaluation", options.seed), options.evaluation_episodes)

        def one(agent: Agent) -> list[dict[str, Any]]:
            policy = driving.policy(network, agent, seen)
            return [_evaluate(scenario, env, policy, chosen) for scenario, env in zip(scenarios, envs, strict=True)]

        each = jax.vmap(one)(several)
        return jnp.stack([numbers["return"] for numbers in each]).mean(0), each

    whole, split = (NamedSharding(over, PartitionSpec(*axes)) for axes in ((), (None, devices.AXIS)))
    placed: Any = TrainState(agent=whole, optimizer=whole, rows=split, best=whole, curriculum=whole, update=whole)  # pyright: ignore
    return Programs(
        jax.jit(begin),
        jax.jit(update, donate_argnums=1, out_shardings=(placed, whole)),
        jax.jit(evaluate, out_shardings=whole),
        jax.jit(refill, donate_argnums=1, out_shardings=placed),
    )


def _weights(own: dict[str, Any]) -> dict[str, Any]:
    """Those of rewards, of what an agent has for itself."""
    return {name.removeprefix(REWARDS): value for name, value in own.items() if name.startswith(REWARDS)}


def _spread(over: Mesh, state: TrainState) -> TrainState:
    """Scenarios on all devices, and all else on each."""
    whole = devices.replicate(over, replace(state, rows=None))
    return replace(whole, rows=devices.split(over, state.rows, axis=1))


def _evaluate(scenario: Scenario, env: mdp.Env, policy: Policy, keys: Array) -> dict[str, Any]:
    """Means over episodes in which the agent takes the mean of its actions: return, and all metrics."""
    steps = math.ceil(scenario.time_limit / scenario.time_step) + 1

    def episode(key: Array) -> tuple[Array, Array, dict[str, Array]]:
        state = init_policy(scenario, policy, reset(scenario, key))
        potentials = rewards.potentials(env.rewards, scenario, state)

        def one(carry: tuple, _) -> tuple[tuple, None]:
            before, then, total, going = carry
            after, _ = policy_step(scenario, policy, before)
            now = rewards.potentials(env.rewards, scenario, after)
            parts = rewards.of_step(env.rewards, scenario, before, after, then, now)
            total += jnp.where(going, jnp.stack(list(parts.values())).sum(), 0.0)
            ends = jnp.stack([after.completed, after.timed_out, *env.ends(scenario, before, after)])
            if env.terminations:  # an episode that was completed or timed out stands still by itself
                after = jax.tree.map(lambda old, new: jnp.where(going, new, old), before, after)
            return (after, now, total, going & ~ends.any()), None

        carry = state, potentials, jnp.zeros((), float), jnp.ones((), bool)
        (last, _, total, _), _ = jax.lax.scan(one, carry, length=steps)
        return total, last.completed, results(scenario, last)

    total, completed, measured = jax.vmap(episode)(keys)
    numbers = {"return": total.mean(), "completed": completed.mean(dtype=jnp.float32)}
    return numbers | {name: jnp.nanmean(value, 0) for name, value in measured.items()}


# ------------------------------------------------------------------ the training


def _train(
    options: ReinforcementConfig,
    console: Console | Callable[[float], None] | None,
    scenarios: tuple[Scenario, ...],
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    config: dict[str, Any],
) -> TrainState:
    """Train in a folder that this process has locked, or the first of those that train together."""
    resumes = processes.by_first(lambda: check_config(options.folder, config))
    over, number, first = devices.mesh(), updates(options), processes.is_first()
    if options.scenarios // len(envs) % over.size:
        text = f"scenarios: {options.scenarios} do not spread evenly over {over.size} devices"
        text += f" in {len(envs)} environments" if len(envs) > 1 else ""
        raise InputError(f"{text}; take a multiple.")
    run = programs(options, network, over)
    several, teachers = _agents(options, network, envs[0], scenarios[0]), ()
    if options.imitate is not None and not (resumes and list((options.folder / "checkpoints").glob("[0-9]*"))):
        teachers = tuple(choice.policy(options.imitate, scenario, "imitate") for scenario in scenarios)
    with progress(console if first else None) as tell:
        tell.stage("drawing starts")
        key, draw = prng.key("training", options.seed), jax.jit(mdp.Env.with_pool, static_argnums=2)
        if options.curriculum == "none":
            keys = [jax.random.fold_in(key, 2**31 - 1 - turn) for turn in range(len(envs))]
            envs = tuple(draw(env, own, options.pool) for env, own in zip(envs, keys, strict=True))
        if teachers:
            assert options.imitate is not None
            tell.stage(f"imitating {options.imitate.kind}")
            several = _imitating(options, network, envs, teachers, several)
        if options.noise is not None:
            several = with_noise(several, options.noise)
        state = run.begin(envs, several)
        if not resumes:
            processes.by_first(lambda: write_config(options.folder, config))
        checkpoints = Checkpoints(options.folder, writes=True)
        saved = checkpoints.latest(_plain(state)) if resumes else None
        state = state if saved is None else _typed(saved, state)
        (scenarios, envs), state = devices.replicate(over, (scenarios, envs)), _spread(over, state)
        log = Log(options.folder, int(state.update)) if first else None
        curve = [float(line["evaluation"]["return"]) for line in (log.lines if log else []) if "evaluation" in line]
        tell.start("training", number)
        try:
            while int(state.update) < number:
                begun = time.time()
                state, told = run.update(envs, state)
                done, told = int(state.update), jax.tree.map(np.asarray, told)
                if state.curriculum is not None and done % options.curriculum_every == 0:
                    state = run.refill(envs, state)
                _check_finite(told, done, options)
                each = options.scenarios * options.horizon
                took = time.time() - begun
                rate = len(options.agents) * each / took
                line = {"epoch": done, "steps": done * each, "seconds": took, "per_second": rate}
                line |= {part: _numbers(values) for part, values in told.items()}
                due = done % options.evaluate_every == 0 or done == number
                if due:
                    state, evaluation = _judge(run, scenarios, envs, state)
                    line |= evaluation
                    curve.append(evaluation["evaluation"]["return"])
                if log is not None:  # before the checkpoint: what follows it is dropped at a restart
                    log.add(line | {"time": time.time()})
                if due:
                    checkpoints.save(_plain(state), done, -float(np.sum(np.asarray(state.best.value))))
                    if log is not None:
                        draw_curve(options.folder)
                episodes = line["episodes"]
                note = f"return {episodes.get('return', math.nan):.1f}, completed {episodes.get('completed', 0.0):.0%}"
                if processes.must_stop(done):
                    raise KeyboardInterrupt
                tell.update(done, f"update {done} · {note} · {sparkline(curve)} · {rate:,.0f} steps/s")
        finally:
            checkpoints.wait()
    return state


def _agents(options: ReinforcementConfig, network: ActorCritic, env: mdp.Env, scenario: Scenario) -> Agent:
    """The agents before the first update, (A, ...)."""
    keys = jnp.stack([prng.key("weights", int(agent["seed"])) for agent in options.agents])
    if options.pretrained is None:
        return jax.jit(lambda keys: init_agents(network, env.observations, env.observation_space, keys))(keys)
    folder = options.pretrained
    other = (agents.load if agents.is_packed(folder) else load)(folder, scenario)[1]
    return jax.tree.map(lambda part: jnp.broadcast_to(part[None], (keys.shape[0], *part.shape)), other)


def _imitating(
    options: ReinforcementConfig,
    network: ActorCritic,
    envs: tuple[mdp.Env, ...],
    teachers: tuple[Policy, ...],
    several: Agent,
) -> Agent:
    """The agents after they have learned from another policy, (A, ...)."""
    envs = tuple(replace(env, pool=None) for env in envs)
    keys = jnp.stack([prng.key("imitation", int(agent["seed"])) for agent in options.agents])

    def one(envs: tuple, teachers: tuple, agent: Agent, key: Array) -> tuple[Agent, Array]:
        return cloning.clone(options, envs, network, agent, teachers, key)

    taught, errors = jax.jit(jax.vmap(one, (None, None, 0, 0)))(envs, teachers, several, keys)
    if not np.isfinite(np.asarray(errors)).all():
        raise FloatingPointError(f"imitate: what {teachers[0].name} does is not finite; choose another --imitate.")
    return taught


def _judge(
    run: Programs, scenarios: tuple[Scenario, ...], envs: tuple[mdp.Env, ...], state: TrainState
) -> tuple[TrainState, dict[str, dict]]:
    """The state with its best agents, and what this evaluation found: the means of all environments and agents, and
    those in each and of each if there are several."""
    value, each = run.evaluate(scenarios, tuple(replace(env, pool=None) for env in envs), state.agent)
    value, each = jnp.asarray(value, jnp.float32), jax.tree.map(np.asarray, each)
    better = value > state.best.value
    now = Best(state.agent, value, jnp.broadcast_to(state.update, value.shape))
    best = jax.tree.map(
        lambda old, new: jnp.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old), state.best, now
    )
    names = ["", *(f" in {name}" for name, _ in scenarios[0].situations)]
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a situation that never occurred
        found = {name: np.nanmean([one[name] for one in each], 0) for name in each[0]}
        mean, *places = [{name: np.nanmean(part, 0) for name, part in one.items()} for one in (found, *each)]
    told = {"evaluation": _row(names, mean)}
    if len(places) > 1:
        told |= {f"evaluation in {a.environment.name}": _row(names, b) for a, b in zip(scenarios, places, strict=True)}
    if (count := value.shape[0]) > 1:
        parts = [{name: part[number] for name, part in found.items()} for number in range(count)]
        told |= {f"agent {number}": _row(names, part) for number, part in enumerate(parts)}
    return replace(state, best=best), told


def _row(names: list[str], found: dict[str, np.ndarray]) -> dict[str, float]:
    """What is finite, by name and by situation."""
    told = {}
    for name, value in found.items():
        for column, part in zip(names, value.reshape(-1), strict=False):
            if np.isfinite(part):
                told[name + column] = float(part)
    return told


def _numbers(values: dict[str, np.ndarray]) -> dict[str, float]:
    """Means over agents of what is finite, as JSON has words for."""
    finite = {name: value[np.isfinite(value)] for name, value in values.items()}
    return {name: float(value.mean()) for name, value in finite.items() if value.size}


def _check_finite(numbers: dict[str, Any], done: int, options: ReinforcementConfig) -> None:
    if not np.isfinite(numbers["train"]["loss"]).all():
        where = f"the loss is not finite in update {done}; {options.folder} keeps the checkpoints until then"
        raise FloatingPointError(f"{where}; try a lower --learning-rate in another folder.")


@jax.jit  # of arrays on the devices of other processes, an array of none is made only so
def _plain(tree: PyTree) -> PyTree:
    """What checkpoints can hold: keys as numbers, and one number for an array of none."""
    return jax.tree.map(lambda leaf: leaf if leaf.size else jnp.zeros(1, leaf.dtype), prng.as_numbers(tree))


def _typed(plain: PyTree, like: PyTree) -> PyTree:
    """The inverse of ``_plain``."""
    return prng.as_keys(jax.tree.map(lambda leaf, one: leaf if one.size else one, plain, like), like)


def _config(options: ReinforcementConfig) -> dict[str, Any]:
    return {
        "command": command("train", options),
        "method": options.method,
        **options.identity(),
        "parts": components.digests(options),
        "devices": len(jax.devices()),
        "versions": versions(),
    }


def _check_pretrained(options: ReinforcementConfig, folder: Path) -> None:
    """Refuse an agent that sees something else or is of another size."""
    had, asked = components.by_content(agents.read_options(folder)), components.by_content(options)
    for name in ("observations", "critic", "width", "layers", "recurrent", "bfloat16", "careful"):
        if had[name] != asked[name]:
            raise InputError(f"pretrained: {folder} has {name} {had[name]}, not {asked[name]}; ask for the same.")
