"""``sean train dagger``: imitation of an expert in the student's own states (dataset aggregation).

A network that imitates demonstrations drives into states in which nobody ever demonstrated. So it drives, the expert
says what should have been done there, and the next network learns from all data until then. In the folder ``round-0``
is the network of the demonstrations alone, ``data-K`` what network K - 1 drove with the expert's labels, and
``round-K`` the network of all data until then. Each of these parts goes on where it stopped.

Source: S. Ross et al., "A reduction of imitation learning and structured prediction to no-regret online learning",
AISTATS 2011, with networks that drive by themselves from the first round on.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import optax
from rich.console import Console

from sean_jax import components, episodes, mdp, writing
from sean_jax.base import Array, Policy
from sean_jax.config import CollectConfig, DaggerConfig, ReinforcementConfig, TrainConfig
from sean_jax.flags import command
from sean_jax.learning import collection, imitation, ppo, rollouts
from sean_jax.learning.dataset import Dataset, open_dataset
from sean_jax.learning.imitation import TrainState
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput, update_statistics
from sean_jax.learning.policy import check_policy
from sean_jax.learning.rollouts import EnvBatch, Optimization, Transition, forward, merge_envs, optimize, step
from sean_jax.learning.trainer import check_config, write_config
from sean_jax.versions import versions


def train(options: DaggerConfig, console: Console | Callable[[float], None] | None = None) -> TrainState:
    """Train networks in turn with further demonstrations, or go on with that, in the folder of the options.

    Args:
        console: shows the progress; a function receives the fraction done instead, and None shows nothing.

    Returns:
        The state of the last network. ``learning.load`` reads its best weights from the folder.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process works in the folder.
        IncompleteError: a file is damaged or cannot be written. What was finished stays.
        FloatingPointError: a number is not finite. What was finished stays.
    """
    first = open_dataset(options.dataset)
    components.check_trust(_collect_options(options, first, 1))
    config = _config(options, first)
    imitation.prepare(_train_options(options, [options.dataset, *options.further], options.pretrained, options.folder))
    check_policy(options.expert, _collect_options(options, first, 1), "expert")
    resumes = check_config(options.folder, config)
    with writing.folder_lock(options.folder):
        if not resumes:
            write_config(options.folder, config)
        data, before, state = [options.dataset, *options.further], options.pretrained, None
        for number in range(options.rounds + 1):
            if number > 0:
                data.append(options.folder / f"data-{number}")
                _print(console, f"round {number} of {options.rounds}: the network drives, {options.expert.kind} labels")
                collection.collect(
                    _collect_options(options, first, number), _part_of_progress(console, 2 * number - 1, options.rounds)
                )
            out = options.folder / f"round-{number}"
            state = imitation.train(
                _train_options(options, data, before, out), _part_of_progress(console, 2 * number, options.rounds)
            )
            before = out
    assert state is not None
    return state


def _collect_options(options: DaggerConfig, first: Dataset, number: int) -> CollectConfig:
    """What is recorded in a round: the demonstrations' scenario, with other episodes."""
    had = first.description()
    student = str(options.folder / f"round-{number - 1}")
    own = {"policy": student, "labels": options.expert, "hours": options.hours, "seed": had.seed + number}
    return had.replace(**own, out=options.folder / f"data-{number}", quiet=options.quiet)


def _train_options(options: DaggerConfig, data: list[Path], before: Path | None, out: Path) -> TrainConfig:
    """What is trained in a round."""
    shared = {name: getattr(options, name) for name in TrainConfig.model_fields}
    own = {"method": "imitation", "dataset": data[0], "further": tuple(data[1:]), "pretrained": before, "out": out}
    return TrainConfig(**(shared | own))


def _part_of_progress(console: Any, part: int, rounds: int) -> Any:
    """What tells a part's progress as a share of the whole."""
    if console is None or hasattr(console, "print"):
        return console
    return lambda share: console((part + share) / (2 * rounds + 1))


def _print(console: Any, text: str) -> None:
    if console is not None and hasattr(console, "print"):
        console.print(text, markup=False)


def _config(options: DaggerConfig, first: Dataset) -> dict[str, Any]:
    return {
        "command": command("train", options),
        "method": options.method,
        **options.decisive(),
        "parts": components.digests(options),
        "dataset": {"fingerprint": first.fingerprint(), "command": first.manifest["command"]},
        "versions": versions(),
    }


UPDATES = 100
EPOCHS = 4


def clone(
    options: ReinforcementConfig,
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    teachers: tuple[Policy, ...],
    key: Array,
) -> tuple[Agent, Array]:
    """Let an agent act as a policy does.

    Args:
        key: () typed PRNG key.

    Returns:
        The agent, and (UPDATES,) the mean squared difference of actions in each update.
    """
    pool_key, rows_key, key = jax.random.split(key, 3)
    pool_keys = pool_key, *(jax.random.fold_in(key, 2**31 - turn) for turn in range(1, len(envs)))

    def remember(env: mdp.Env, teacher: Policy, states: mdp.EnvState) -> mdp.EnvState:
        begun = jax.vmap(lambda state: episodes.init_policy(env.scenario, teacher, state))(states.simulation)
        return replace(states, simulation=begun)

    def with_pool(env: mdp.Env, teacher: Policy, key: Array) -> mdp.Env:
        env = env.with_pool(key, options.pool)
        assert env.pool is not None
        return replace(env, pool=replace(env.pool, states=remember(env, teacher, env.pool.states)))

    envs = tuple(map(with_pool, envs, teachers, pool_keys))
    rows = rollouts.reset_envs(envs, network, rows_key, options.scenarios)
    rows = replace(rows, envs=tuple(map(remember, envs, teachers, rows.envs)))
    rate = jnp.asarray(options.learning_rate, jnp.float32)
    descent = Optimization(ppo.OPTIMIZER, rate, EPOCHS, options.minibatches)

    def one(carry: tuple[Agent, optax.OptState, EnvBatch], number: Array) -> tuple[tuple, Array]:
        agent, optimizer, rows = carry
        memory, turn = rows.memory, jax.random.fold_in(key, number)
        rows, seen = _teach(envs, network, agent, teachers, rows, options.horizon, turn, number >= UPDATES // 2)
        agent, optimizer, error = optimize(descent, _action_error, network, agent, optimizer, (seen,), memory, turn)
        statistics = update_statistics(agent.statistics, seen.vector.reshape(-1, seen.vector.shape[-1]))
        return (replace(agent, statistics=statistics), optimizer, rows), error

    carry = agent, ppo.init(agent), rows
    (agent, _, _), errors = jax.lax.scan(one, carry, jnp.arange(UPDATES, dtype=jnp.int32))
    return agent, errors


def _action_error(said: NetworkOutput, steps: Transition) -> tuple[Array, Array]:
    """Mean squared difference of actions, as the loss and for the log."""
    error = ((said.mean - steps.action) ** 2).mean()
    return error, error


def _teach(
    envs: tuple[mdp.Env, ...],
    network: ActorCritic,
    agent: Agent,
    teachers: tuple[Policy, ...],
    rows: EnvBatch,
    steps: int,
    key: Array,
    alone: Array,
) -> tuple[EnvBatch, Transition]:
    """Steps that the teacher drives, or the agent if it is ``alone``; the actions that are told are the teacher's."""

    def ask(env: mdp.Env, teacher: Policy, before: mdp.EnvState) -> tuple[Array, mdp.EnvState]:
        state = before.simulation
        chance = jax.random.fold_in(state.streams.policy, state.tick)
        wanted, memory = episodes.command(env.scenario, teacher, state, chance)
        asked = replace(before, simulation=replace(state, policy_state=memory))
        return mdp.to_action(env.scenario.robot, wanted).astype(jnp.float32), asked

    def one(rows: EnvBatch, tick: Array) -> tuple[EnvBatch, Transition]:
        said = forward(network, agent, envs[0].observations, rows)
        each = [jax.vmap(ask, (None, None, 0))(*given) for given in zip(envs, teachers, rows.envs, strict=True)]
        wanted, asked = merge_envs([wanted for wanted, _ in each]), tuple(states for _, states in each)
        action = jnp.where(alone, said.mean, wanted)
        turn = jax.random.fold_in(key, tick)
        rows, seen = step(envs, network, agent, replace(rows, envs=asked), said, action, turn)
        return rows, seen._replace(action=wanted, told={})

    return jax.lax.scan(one, rows, jnp.arange(steps, dtype=jnp.int32))
