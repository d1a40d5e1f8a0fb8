"""Behavioral cloning: a network learns the actions of another policy.

``programs`` learn from demonstrations, for ``sean train imitation`` and ``sean train dagger`` (section V-C). The losses
of the local planner and of the velocity controller have equal weight. ``clone`` learns from a teacher in the states of
teacher and student, for an agent before reinforcement learning (``--imitate``).

Source: S. Ross, G. Gordon & J. Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax.typing import VariableDict
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Float, Int

from sean_jax import mdp
from sean_jax.core import devices
from sean_jax.core.data_types import Array, Policy
from sean_jax.learning import examples, networks, ppo, rollouts
from sean_jax.learning.examples import Example, Recording, example
from sean_jax.learning.networks import ActorCritic, Agent, AgentDescription, NetworkOutput
from sean_jax.learning.rollouts import EnvBatch, Envs, Optimization, Transition
from sean_jax.learning.trainer import TrainState, keep_best
from sean_jax.mdp import observations
from sean_jax.simulation import episodes
from sean_jax.simulation.scenario_stack import Stack

# ------------------------------------------------------------------ from demonstrations


class CloningLosses(NamedTuple):
    """Means over examples."""

    loss: Array  # () sum of the next two
    local_plan: Array  # () m2, mean squared distance from the places of the next five seconds
    command: Array  # () squared error of the command in units of ``Agent.command_scale``, summed over both numbers


class Student(NamedTuple):
    """A network that learns from demonstrations, and its optimizer."""

    network: ActorCritic
    terms: observations.Terms
    optimizer: optax.GradientTransformation  # with a learning rate of -1
    learning_rate: float


class Batching(NamedTuple):
    """How the rows of an epoch become batches."""

    size: int
    devices: int  # among which a batch is divided equally
    sharding: NamedSharding
    padded: bool  # whether the rows may fill whole batches with -1


class CloningPrograms(NamedTuple):
    """The compiled functions of a training. Each compiles at its first call.

    Rows are of a recording, (R,) in their order; -1 counts for nothing. "Sums" are the (4,) of ``error_sums``, from
    which ``losses`` are computed.
    """

    learn: Callable  # (state, recording, rows) -> (state, sums); donates the state
    measure: Callable  # (state, recording, rows) -> sums
    finish: Callable  # (state, training sums, validation sums) -> (state, training losses, validation losses)


def make_student(description: AgentDescription, learning_rate: float, weight_decay: float) -> Student:
    """A student that learns by AdamW."""
    optimizer = optax.chain(optax.scale_by_adam(), optax.add_decayed_weights(weight_decay))
    return Student(description.network, description.terms, optimizer, learning_rate)


def programs(student: Student, batch: int, mesh: Mesh, padded: bool = False) -> CloningPrograms:
    """The compiled functions of a training, which donate the memory of the state.

    Args:
        batch: examples of a step of the optimizer.
        padded: whether the rows may fill whole batches with -1.
    """
    batching = Batching(batch, mesh.size, NamedSharding(mesh, PartitionSpec(devices.AXIS)), padded)
    return CloningPrograms(
        learn=jax.jit(functools.partial(learn, student, batching), donate_argnums=0),
        measure=jax.jit(functools.partial(measure, student, batching)),
        finish=jax.jit(finish_epoch),
    )


def error_sums(student: Student, agent: Agent, demonstrations: Example, weight: Float[Array, "B"]) -> Float[Array, "4"]:
    """Sums over examples: squared distances, number of valid places, squared errors of the command, and examples."""
    observation = examples.observation(student.terms, demonstrations)
    vector = rollouts.flat_observations(student.terms, observation)  # (B, F)
    images = {name: observation[name] for name in student.network.images}
    memory = jnp.zeros((*weight.shape, 0), jnp.float32)
    start = jnp.ones(weight.shape, bool)
    output = networks.apply(student.network, agent, vector, images, memory, start)

    # The local plan is compared as long as the episode lasted.
    gap = output.auxiliary["local_plan"] - demonstrations.future  # (B, 5, 2) m
    squared = gap[..., 0] * gap[..., 0] + gap[..., 1] * gap[..., 1]
    valid = demonstrations.future_valid.astype(jnp.float32)

    assert agent.command_scale is not None
    error = output.mean - demonstrations.command / agent.command_scale[None]
    of_examples = (valid * squared).sum(-1), valid.sum(-1), (error * error).sum(-1), jnp.ones_like(weight)
    weighted = weight[:, None] * jnp.stack(of_examples, -1)  # (B, 4)
    return weighted.sum(0)


def losses(sums: Float[Array, "4"]) -> CloningLosses:
    """The losses of ``error_sums``."""
    local_plan = sums[0] / jnp.maximum(sums[1], 1.0)
    command = sums[2] / jnp.maximum(sums[3], 1.0)
    return CloningLosses(local_plan + command, local_plan, command)


def update(
    student: Student, state: TrainState, demonstrations: Example, weight: Float[Array, "B"]
) -> tuple[TrainState, Float[Array, "4"]]:
    """The state after one step of the optimizer, and the sums before it."""

    def loss(parameters: VariableDict) -> tuple[Array, Array]:
        sums = error_sums(student, replace(state.agent, parameters=parameters), demonstrations, weight)
        return losses(sums).loss, sums

    gradient, sums = jax.grad(loss, has_aux=True)(state.agent.parameters)
    rate = jnp.asarray(student.learning_rate, jnp.float32)
    parameters, optimizer = rollouts.apply_gradient(
        student.optimizer, rate, state.agent.parameters, state.optimizer, gradient
    )
    return replace(state, agent=replace(state.agent, parameters=parameters), optimizer=optimizer), sums


def learn(
    student: Student, batching: Batching, state: TrainState, recording: Recording, rows: Int[Array, "R"]
) -> tuple[TrainState, Float[Array, "4"]]:
    """The state after a step of the optimizer for each batch of the rows, and the sums before each of them."""

    def step(state: TrainState, batch: Int[Array, "B"]) -> tuple[TrainState, Array]:
        after, sums = update(student, state, *gather(batching, recording, batch))
        if not batching.padded:
            return after, sums
        some = (batch >= 0).any()  # of a batch of none, the optimizer would still move
        return jax.tree.map(lambda old, new: jnp.where(some, new, old), state, after), sums

    state, sums = jax.lax.scan(step, state, in_batches(rows, batching))
    return state, sums.sum(0)


def measure(
    student: Student, batching: Batching, state: TrainState, recording: Recording, rows: Int[Array, "R"]
) -> Float[Array, "4"]:
    """The sums of a state."""

    def step(_: int, batch: Int[Array, "B"]) -> tuple[int, Array]:
        return 0, error_sums(student, state.agent, *gather(batching, recording, batch))

    return jax.lax.scan(step, 0, in_batches(rows, batching))[1].sum(0)


def gather(batching: Batching, recording: Recording, rows: Int[Array, "B"]) -> tuple[Example, Float[Array, "B"]]:
    """Examples (B, ...) and their weights, 0 for rows of -1."""
    rows = jax.lax.with_sharding_constraint(rows, batching.sharding)
    return example(recording, jnp.maximum(rows, 0)), (rows >= 0).astype(jnp.float32)


def finish_epoch(
    state: TrainState, training: Float[Array, "4"], validation: Float[Array, "4"]
) -> tuple[TrainState, CloningLosses, CloningLosses]:
    """The state at the end of an epoch, whose agent is the best if its loss in validation is the smallest so far."""
    training_losses = losses(training)
    validation_losses = losses(validation)
    state = keep_best(replace(state, update=state.update + 1), -validation_losses.loss)
    return state, training_losses, validation_losses


def in_batches(rows: Int[Array, "R"], batching: Batching) -> Int[Array, "batches B"]:
    """Rows (R,) int32 in batches of equal size; -1 fills the last one.

    B is the smaller of ``size`` and R, rounded up to a multiple of the devices.
    """
    count = rows.shape[0]
    size = -(-max(1, min(batching.size, count)) // batching.devices) * batching.devices
    spare = -count % size
    return jnp.concatenate([rows, jnp.full((spare,), -1, jnp.int32)]).reshape(-1, size)


# ------------------------------------------------------------------ from a teacher

UPDATES = 100  # of ``clone``
EPOCHS = 4


class Lesson(NamedTuple):
    """What an agent learns from: environments with the teacher of each, and the sizes of an update."""

    network: ActorCritic
    envs: Envs
    teachers: tuple[Policy, ...]
    horizon: int  # steps of each scenario in an update
    optimization: Optimization


def clone(lesson: Lesson, agent: Agent, scenarios: int, pool: int, key: Array) -> tuple[Agent, Float[Array, "updates"]]:
    """The agent after it has learned to act as the teachers do, and the mean squared errors of actions (UPDATES,).

    In the first half of the updates the teacher drives, in the second half the agent, with the teacher's actions as
    labels: so the agent also learns the way back from states to which only its own errors lead.

    Args:
        scenarios: number of scenarios that step together.
        pool: number of starts of episodes.
        key: () typed PRNG key.
    """
    pool_key, batch_key, key = jax.random.split(key, 3)
    pool_keys = pool_key, *(jax.random.fold_in(key, 2**31 - turn) for turn in range(1, len(lesson.envs)))
    envs = tuple(
        with_taught_pool(env, teacher, pool, pool_key)
        for env, teacher, pool_key in zip(lesson.envs, lesson.teachers, pool_keys, strict=True)
    )
    lesson = lesson._replace(envs=envs)
    batch = begin_lesson(lesson, rollouts.reset_envs(envs, lesson.network, batch_key, scenarios))

    carry = agent, lesson.optimization.optimizer.init(agent.parameters), batch
    updates = jnp.arange(UPDATES, dtype=jnp.int32)
    (agent, _, _), errors = jax.lax.scan(functools.partial(imitate, lesson, key), carry, updates)
    return agent, errors


def make_lesson(
    network: ActorCritic, envs: Envs, teachers: tuple[Policy, ...], horizon: int, rate: float, minibatches: int
) -> Lesson:
    """A lesson with the optimizer of PPO."""
    optimization = Optimization(ppo.OPTIMIZER, jnp.asarray(rate, jnp.float32), EPOCHS, minibatches)
    return Lesson(network, envs, teachers, horizon, optimization)


def with_taught_pool(env: Stack[mdp.Env], teacher: Policy, size: int, key: Array) -> Stack[mdp.Env]:
    """The environment with a pool of starts that have the teacher's memory."""

    def begin_pool(env: mdp.Env, pool: mdp.Pool) -> mdp.Pool:
        return replace(pool, states=jax.vmap(functools.partial(begin_teacher, teacher, env))(pool.states))

    return rollouts.with_pool(env, key, size, begin_pool)


def begin_teacher(teacher: Policy, env: mdp.Env, state: mdp.EnvState) -> mdp.EnvState:
    """The state with the teacher's memory of the beginning of an episode."""
    return replace(state, simulation=episodes.init_policy(env.scenario, teacher, state.simulation))


def begin_lesson(lesson: Lesson, batch: EnvBatch) -> EnvBatch:
    """The scenarios with the teachers' memories."""
    states = []
    for env, teacher, env_states in zip(lesson.envs, lesson.teachers, batch.envs, strict=True):
        states.append(env.vmap(functools.partial(begin_teacher, teacher))(env_states))
    return replace(batch, envs=tuple(states))


def imitate(
    lesson: Lesson, key: Array, carry: tuple[Agent, optax.OptState, EnvBatch], number: Int[Array, ""]
) -> tuple[tuple[Agent, optax.OptState, EnvBatch], Float[Array, ""]]:
    """One update: collect labelled transitions, then learn the labels."""
    agent, optimizer, batch = carry
    memory = batch.memory
    update_key = jax.random.fold_in(key, number)
    teacher_drives = number < UPDATES // 2

    collect = functools.partial(labelled_step, lesson, agent, teacher_drives, update_key)
    batch, transitions = jax.lax.scan(collect, batch, jnp.arange(lesson.horizon, dtype=jnp.int32))

    learner = lesson.network, agent, optimizer
    agent, optimizer, error = rollouts.optimize(
        lesson.optimization, action_error, *learner, (transitions,), memory, update_key
    )
    return (rollouts.with_statistics(agent, transitions), optimizer, batch), error


def labelled_step(
    lesson: Lesson, agent: Agent, teacher_drives: Array, key: Array, batch: EnvBatch, tick: Int[Array, ""]
) -> tuple[EnvBatch, Transition]:
    """One step of all scenarios, with the teachers' actions in the transitions."""
    envs = lesson.envs
    network = lesson.network
    output = rollouts.forward(network, agent, envs[0].member.observations, batch)

    labels = []
    states = []
    for env, teacher, env_states in zip(envs, lesson.teachers, batch.envs, strict=True):
        env_labels, env_states = env.vmap(functools.partial(label, teacher))(env_states)
        labels.append(env_labels)
        states.append(env_states)
    actions = rollouts.merge_envs(labels)  # (B, 2)

    driven = jnp.where(teacher_drives, actions, output.mean)
    step_key = jax.random.fold_in(key, tick)
    batch = replace(batch, envs=tuple(states))
    batch, transition = rollouts.step(envs, network, agent, batch, output, driven, step_key)
    return batch, transition._replace(action=actions, info={})


def label(teacher: Policy, env: mdp.Env, before: mdp.EnvState) -> tuple[Float[Array, "2"], mdp.EnvState]:
    """The teacher's action in a state, and the state with its memory afterwards."""
    state = before.simulation
    policy_key = jax.random.fold_in(state.streams.policy, state.tick)
    command, memory = episodes.command(env.scenario, teacher, state, policy_key)
    after = replace(before, simulation=replace(state, policy_state=memory))
    return mdp.to_action(env.scenario.robot, command).astype(jnp.float32), after


def action_error(output: NetworkOutput, transitions: Transition) -> tuple[Array, Array]:
    """Mean squared error of actions, as the loss and for the log."""
    error = ((output.mean - transitions.action) ** 2).mean()
    return error, error
