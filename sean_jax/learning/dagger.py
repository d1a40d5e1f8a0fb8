"""Dataset aggregation: imitation of an expert in the student's own states.

``train`` is ``sean train dagger``: in rounds, the network drives, the expert labels, and the next network learns from
all data until then. The folder has ``round-0``, the network of the demonstrations alone, ``data-K``, what network K - 1
drove with the expert's labels, and ``round-K``, the network of all data until then; each part is resumed. ``clone`` is
the same on-policy, for an agent of reinforcement learning before its first update.

Source: S. Ross, G. Gordon & J. Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011, with networks that drive by themselves from the first round on.
"""

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import optax

from sean_jax import mdp
from sean_jax.config import (
    CollectConfig,
    DaggerConfig,
    ImitationConfig,
    Named,
    ReinforcementConfig,
    user_parts,
    validate,
)
from sean_jax.core.data_types import Array, Policy
from sean_jax.io import writing
from sean_jax.io.progress import ProgressLike, say
from sean_jax.learning import collection, imitation, ppo, rollouts
from sean_jax.learning.dataset import Dataset, open_dataset
from sean_jax.learning.imitation import TrainState
from sean_jax.learning.networks import ActorCritic, Agent, NetworkOutput
from sean_jax.learning.policy import check_policy
from sean_jax.learning.rollouts import EnvBatch, Envs, Optimization, Transition
from sean_jax.learning.trainer import check_config, method_config, write_config
from sean_jax.simulation import episodes
from sean_jax.simulation.scenario_stack import Stack

UPDATES = 100  # of ``clone``
EPOCHS = 4


def train(options: DaggerConfig, console: ProgressLike = None) -> TrainState:
    """Train networks in rounds, or resume that; the state of the last, whose best weights ``learning.load`` reads.

    Args:
        console: shows the progress; a function receives the share that is done.

    Raises:
        InputError: the options are impossible, or the folder holds something else.
        WriteError: another process works in the folder.
        IncompleteError: a file is damaged or cannot be written. Finished parts are kept.
        FloatingPointError: a number is not finite. Finished parts are kept.
    """
    first = open_dataset(options.dataset)
    user_parts.check_trust(_collect_options(options, first, 1))
    data = {"fingerprint": first.fingerprint(), "command": first.manifest["command"]}
    config = method_config(options, dataset=data)
    imitation.prepare(_train_options(options, [options.dataset, *options.datasets], options.pretrained, options.folder))
    check_policy(options.expert, _collect_options(options, first, 1), "expert")
    resumes = check_config(options.folder, config)
    with writing.folder_lock(options.folder):
        if not resumes:
            write_config(options.folder, config)
        data, before, state = [options.dataset, *options.datasets], options.pretrained, None
        for number in range(options.rounds + 1):
            if number > 0:
                data.append(options.folder / f"data-{number}")
                say(console, f"round {number} of {options.rounds}: the network drives, {options.expert.kind} labels")
                part = _part_of_progress(console, 2 * number - 1, options.rounds)
                collection.collect(_collect_options(options, first, number), part)
            out = options.folder / f"round-{number}"
            part = _part_of_progress(console, 2 * number, options.rounds)
            state = imitation.train(_train_options(options, data, before, out), part)
            before = out
    assert state is not None
    return state


def _collect_options(options: DaggerConfig, first: Dataset, number: int) -> CollectConfig:
    """Of a round: the demonstrations' scenario, with other episodes."""
    described = first.description()
    student = str(options.folder / f"round-{number - 1}")
    changed = {
        "policy": Named(kind=student),
        "labels": options.expert,
        "hours": options.hours,
        "seed": described.seed + number,
    }
    return described.replace(**changed, out=options.folder / f"data-{number}", quiet=options.quiet)


def _train_options(options: DaggerConfig, data: list[Path], before: Path | None, out: Path) -> ImitationConfig:
    shared = {name: getattr(options, name) for name in ImitationConfig.model_fields}
    changed = {"method": "imitation", "dataset": data[0], "datasets": tuple(data[1:]), "pretrained": before, "out": out}
    return validate(ImitationConfig, shared | changed)


def _part_of_progress(console: Any, part: int, rounds: int) -> Any:
    """A function that maps the share of a part to the share of the whole; a console is unchanged."""
    if console is None or hasattr(console, "print"):
        return console
    return lambda share: console((part + share) / (2 * rounds + 1))


# ------------------------------------------------------------------ before reinforcement learning


def clone(
    options: ReinforcementConfig,
    network: ActorCritic,
    envs: Envs,
    teachers: tuple[Policy, ...],
    agent: Agent,
    key: Array,
) -> tuple[Agent, Array]:
    """The agent after it has learned to act as ``teachers`` do, and the mean squared errors of actions (UPDATES,).

    In the first half of the updates the teacher drives, in the second half the agent, with the teacher's actions as
    labels: so the agent also learns the way back from states to which only its own errors lead.

    Args:
        teachers: one for each environment.
        key: () typed PRNG key.
    """
    pool_key, batch_key, key = jax.random.split(key, 3)
    pool_keys = pool_key, *(jax.random.fold_in(key, 2**31 - turn) for turn in range(1, len(envs)))

    def with_memory(teacher: Policy, env: mdp.Env, state: mdp.EnvState) -> mdp.EnvState:
        return replace(state, simulation=episodes.init_policy(env.scenario, teacher, state.simulation))

    def with_pool(env: Stack[mdp.Env], teacher: Policy, key: Array) -> Stack[mdp.Env]:
        def change(env: mdp.Env, pool: mdp.Pool) -> mdp.Pool:
            return replace(pool, states=jax.vmap(functools.partial(with_memory, teacher, env))(pool.states))

        return rollouts.with_pool(env, key, options.pool, change)

    envs = tuple(map(with_pool, envs, teachers, pool_keys))
    batch = rollouts.reset_envs(envs, network, batch_key, options.scenarios)
    each = zip(envs, teachers, batch.envs, strict=True)
    begun = (env.vmap(functools.partial(with_memory, teacher))(states) for env, teacher, states in each)
    batch = replace(batch, envs=tuple(begun))
    rate = jnp.asarray(options.learning_rate, jnp.float32)
    how = Optimization(ppo.OPTIMIZER, rate, EPOCHS, options.minibatches)

    def label(teacher: Policy, env: mdp.Env, before: mdp.EnvState) -> tuple[Array, mdp.EnvState]:
        state = before.simulation
        policy_key = jax.random.fold_in(state.streams.policy, state.tick)
        command, memory = episodes.command(env.scenario, teacher, state, policy_key)
        after = replace(before, simulation=replace(state, policy_state=memory))
        return mdp.to_action(env.scenario.robot, command).astype(jnp.float32), after

    def update(carry: tuple[Agent, optax.OptState, EnvBatch], number: Array) -> tuple[tuple, Array]:
        agent, optimizer, batch = carry
        memory, turn = batch.memory, jax.random.fold_in(key, number)

        def one(batch: EnvBatch, tick: Array) -> tuple[EnvBatch, Transition]:
            output = rollouts.forward(network, agent, envs[0].member.observations, batch)
            parts = zip(envs, teachers, batch.envs, strict=True)
            each = [env.vmap(functools.partial(label, teacher))(states) for env, teacher, states in parts]
            labels, states = rollouts.merge_envs([actions for actions, _ in each]), tuple(after for _, after in each)
            action = jnp.where(number >= UPDATES // 2, output.mean, labels)
            next_key = jax.random.fold_in(turn, tick)
            batch, steps = rollouts.step(envs, network, agent, replace(batch, envs=states), output, action, next_key)
            return batch, steps._replace(action=labels, info={})

        batch, steps = jax.lax.scan(one, batch, jnp.arange(options.horizon, dtype=jnp.int32))
        learner = network, agent, optimizer
        agent, optimizer, error = rollouts.optimize(how, _action_error, *learner, (steps,), memory, turn)
        return (rollouts.with_statistics(agent, steps), optimizer, batch), error

    carry = agent, ppo.OPTIMIZER.init(agent.parameters), batch
    (agent, _, _), errors = jax.lax.scan(update, carry, jnp.arange(UPDATES, dtype=jnp.int32))
    return agent, errors


def _action_error(output: NetworkOutput, steps: Transition) -> tuple[Array, Array]:
    """Mean squared error of actions, as the loss and for the log."""
    error = ((output.mean - steps.action) ** 2).mean()
    return error, error
