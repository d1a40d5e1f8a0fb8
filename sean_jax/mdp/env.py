"""A scenario as an environment of reinforcement learning: observations, actions, rewards and ends of episodes.

``reset`` and ``step`` are pure functions of one scenario, to be vmapped. An episode that has ended is followed by
another in the same step. A whole reset in each step would triple its time, so ``with_pool`` draws starts beforehand and
``step`` copies one of them.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Bool, Float, Int, PyTree

from sean_jax.config import OBSERVED
from sean_jax.core import random_streams, user_calls
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.core.errors import InputError
from sean_jax.io import files
from sean_jax.mdp import observations as observing
from sean_jax.mdp import rewards as rewarding
from sean_jax.mdp.observations import ObservationLike
from sean_jax.mdp.randomization import Randomization, RandomizationLike, as_randomization
from sean_jax.mdp.rewards import RewardLike
from sean_jax.mdp.spaces import Box, action_space, to_command
from sean_jax.simulation.scenario import reset, results, step

CHANCES = 2**30  # parts of the total probability; their sums are exact, and 0 is never taken


@struct.dataclass
class EnvState:
    """The state of an episode."""

    simulation: State
    randomization: PyTree  # parameters of the scenario of this episode; () if there are none
    start: Int[Array, ""]  # number of the start in its pool, K more for each start that was there before; -1: of none
    observed: PyTree  # memory of the terms of the observation
    potentials: dict[str, Float[Array, ""]]  # of the terms of the reward that have one
    commands: Float[Array, "L command"]  # m/s, rad/s: the last commands, newest first
    late: Int[Array, ""]  # steps of control, delay of commands in this episode
    episode_return: Float[Array, ""]  # sum of the rewards so far
    episode_length: Int[Array, ""]  # steps so far


@struct.dataclass
class Pool:
    """Starts of episodes, with their first observations."""

    states: EnvState  # (K, ...)
    observations: dict[str, Array]  # (K, ...)
    weights: Float[Array, "K"]  # 0 or more, how likely each is taken, relative to the others


@struct.dataclass
class Env:
    """A scenario with an observation and a reward. ``make_env`` makes one.

    It is a pytree. ``reset``, ``step`` and ``with_pool`` are compiled at their first call, with the tables of the
    environment as arguments; ``jax.jit(env.step)`` holds them as constants of the program.
    """

    scenario: Scenario
    pool: Pool | None  # None: episodes are followed by a new reset, which is computed in each step
    observations: observing.Terms = struct.field(pytree_node=False)
    rewards: rewarding.Terms = struct.field(pytree_node=False)
    terminations: tuple[tuple[str, Callable], ...] = struct.field(pytree_node=False)
    randomization: Randomization | None = struct.field(pytree_node=False, default=None)
    action_delay: tuple[int, int] = struct.field(pytree_node=False, default=(0, 0))  # steps of control, least and most
    transition_gradients: bool = struct.field(pytree_node=False, default=False)

    # ------------------------------------------------------------------ spaces

    @property
    def action_space(self) -> Box:
        """(2,) from -1 to 1: shares of the top speed and of the top turn rate, or of a car's steering angle.

        An omnidirectional robot has (3,), with the share of the top speed to the left in the middle.
        """
        return action_space(self.scenario.robot)

    @property
    def observation_space(self) -> dict[str, Box]:
        """A box for each term of the observation."""
        shapes = jax.eval_shape(lambda scenario: reset(scenario, jax.random.key(0)), self.scenario)
        return observing.space(self.observations, self.scenario, shapes)

    # ------------------------------------------------------------------ episodes

    @jax.jit
    def reset(self, key: Array, randomization: PyTree = None) -> tuple[dict[str, Array], EnvState]:
        """The first observation and state of an episode.

        Args:
            key: () typed PRNG key, from which all chance of the episode comes.
            randomization: parameters of the scenario; drawn by the key if None.
        """
        episode_key, draw_key, delay_key = jax.random.split(random_streams.typed(key), 3)
        if randomization is None:
            randomization = () if self.randomization is None else self.randomization.draw(draw_key, self.scenario)
        scenario = self.scenario_of(randomization)
        simulation = reset(scenario, episode_key)
        first, second = jax.random.split(delay_key)
        observation, memory = observing.begin(self.observations, scenario, simulation, first)
        least, most = self.action_delay
        state = EnvState(
            simulation=simulation,
            randomization=randomization,
            start=jnp.full((), -1, jnp.int32),
            observed=memory,
            potentials=rewarding.potentials(self.rewards, scenario, simulation),
            commands=jnp.zeros((most + 1, *action_space(scenario.robot).shape), float),
            late=jax.random.randint(second, (), least, most + 1, jnp.int32),
            episode_return=jnp.zeros((), float),
            episode_length=jnp.zeros((), jnp.int32),
        )
        return observation, state

    @jax.jit
    def step(
        self, key: Array, state: EnvState, action: Float[Array, "2"]
    ) -> tuple[dict[str, Array], EnvState, Float[Array, ""], Bool[Array, ""], Bool[Array, ""], dict[str, Any]]:
        """One step of control; if it ends the episode, observation and state are the first of the next.

        Args:
            key: () typed PRNG key of the next episode, if this one ends; within an episode all chance comes from its
                state.
            action: from -1 to 1, of ``action_space``.

        Returns:
            The observation, the state, the reward, ``terminated``, ``truncated`` (by the time limit), and ``info``:
            ``final_observation`` before a reset, ``rewards`` by term, ``command``, ``situations``, and, of the episode
            so far, ``start`` (its number in the pool), ``completed``, ``episode_return``, ``episode_length`` and
            ``metrics``.
        """
        ended, observation, reward, terminated, truncated, info = self.advance(state, action)
        done = terminated | truncated
        first, start = self.start(key)
        following = jax.tree.map(lambda old, new: jnp.where(done, new, old), ended, start)
        shown = jax.tree.map(lambda old, new: jnp.where(done, new, old), observation, first)
        return shown, following, reward, terminated, truncated, info | {"final_observation": observation}

    def advance(
        self, state: EnvState, action: Float[Array, "2"]
    ) -> tuple[EnvState, dict[str, Array], Float[Array, ""], Bool[Array, ""], Bool[Array, ""], dict[str, Any]]:
        """As ``step``, without the next episode, for callers that reset by themselves; the action is from -1 to 1.

        Returns:
            The state, the observation, the reward, ``terminated``, ``truncated``, and ``info``.
        """
        scenario = self.scenario_of(state.randomization)
        before = state.simulation
        command = to_command(scenario.robot, jnp.asarray(action, before.robot.position.dtype))
        commands = jnp.concatenate([command[None], state.commands[:-1]])
        after = step(scenario, before, commands[state.late])
        potentials = rewarding.potentials(self.rewards, scenario, after)
        parts = rewarding.of_step(self.rewards, scenario, before, after, state.potentials, potentials)
        reward = jnp.stack(list(parts.values())).sum()
        with jax.named_scope("observe"):
            observation, memory = observing.observe(self.observations, scenario, after, state.observed)
        terminated = jnp.stack([after.completed, *self.ends(scenario, before, after)]).any()
        truncated = after.timed_out & ~terminated
        state = replace(
            state,
            simulation=after,
            observed=memory,
            potentials=potentials,
            commands=commands,
            episode_return=state.episode_return + reward,
            episode_length=state.episode_length + 1,
        )
        if not self.transition_gradients:
            observation, state = jax.lax.stop_gradient((observation, state))
        info = {
            "rewards": parts,
            "command": command,
            "completed": after.completed,
            "situations": after.situations,
            "start": state.start,
            "episode_return": state.episode_return,
            "episode_length": state.episode_length,
            "metrics": results(scenario, after),
        }
        return state, observation, reward, terminated, truncated, info

    def ends(self, scenario: Scenario, before: State, after: State) -> list[Bool[Array, ""]]:
        """The ``terminations`` of a step, besides completion and the time limit."""
        conditions = []
        for _, condition in self.terminations:
            value = rewarding.call("terminations", condition, "scenario, before, after", scenario, before, after)
            user_calls.check_array(
                "terminations", condition, value, bool, (), "compare numbers, and reduce with any or all"
            )
            conditions.append(value)
        return conditions

    # ------------------------------------------------------------------ variants

    @functools.partial(jax.jit, static_argnames="size")
    def with_pool(self, key: Array, size: int) -> "Env":
        """The environment with starts that are drawn now, whose ``step`` saves a reset.

        Starts are taken at random, by the ``weights`` of the pool, which are equal. All chance after the start is the
        episode's own. The noise of a first observation is the start's.
        """
        return replace(self, pool=self.draw_pool(jax.random.split(random_streams.typed(key), size)))

    def draw_pool(self, keys: Array, randomization: PyTree = None) -> Pool:
        """Equally likely starts of keys (K,).

        Args:
            randomization: (K, ...) parameters of their scenarios; drawn by the keys if None.
        """
        number = keys.shape[0]
        observations, states = jax.vmap(self.reset, (0, None if randomization is None else 0))(keys, randomization)
        states = replace(states, start=jnp.arange(number, dtype=jnp.int32))
        return Pool(states, observations, jnp.ones(number, float))

    def with_transition_gradients(self) -> "Env":
        """The environment whose observations and states can be differentiated, as gymnax words it.

        Otherwise gradients are truncated to one step: only the derivative of a reward by its action is left.
        """
        return replace(self, transition_gradients=True)

    # ------------------------------------------------------------------

    def scenario_of(self, randomization: PyTree) -> Scenario:
        """The scenario of an episode, rebuilt in each step, so that a state need not hold it."""
        if self.randomization is None:
            return self.scenario
        apply = self.randomization.apply
        scenario = user_calls.call("randomization", apply, "parameters, scenario", randomization, self.scenario)
        if not isinstance(scenario, Scenario):
            function = getattr(self.randomization, "function", apply)
            raise user_calls.wrong(
                "randomization", function, user_calls.describe(scenario), "a Scenario", "give scenario.replace(...)"
            )
        return scenario

    def start(self, key: Array) -> tuple[dict[str, Array], EnvState]:
        """The first observation and state of an episode: a start of the pool, or, without a pool, a reset."""
        if self.pool is None:
            return self.reset(key)
        choice_key, streams_key = jax.random.split(random_streams.typed(key))
        chosen = _choose(choice_key, self.pool.weights)
        observation, state = jax.tree.map(lambda leaf: leaf[chosen], (self.pool.observations, self.pool.states))
        return observation, replace(
            state, simulation=replace(state.simulation, streams=random_streams.streams(streams_key))
        )


def _choose(key: Array, weights: Float[Array, "K"]) -> Int[Array, ""]:
    """The index of a start by its weight. Sums are of whole numbers: floats would now and then take a start of weight
    0.
    """
    parts = jnp.round(weights / weights.sum() * CHANCES).astype(jnp.int32)
    below = jnp.cumsum(parts, dtype=jnp.int32)
    drawn = jax.random.randint(key, (), 0, below[-1], jnp.int32)
    return jnp.searchsorted(below, drawn, side="right", method="scan_unrolled").astype(jnp.int32)


# ------------------------------------------------------------------ ends


def _grown(name: str, definition: str) -> Callable:
    term = rewarding.of_metric(name).step
    assert term is not None

    def grows(scenario: Scenario, before: State, after: State) -> Array:
        return term(scenario, before, after) > 0.0

    grows.__doc__ = definition
    return grows


TERMINATIONS: dict[str, Callable[[Scenario, State, State], Array]] = {
    "collision": _grown("collision_robot_on_person", "The robot, by its own motion, touches a person."),
    "obstacle": _grown("collision_with_obstacle", "The robot touches an obstacle."),
    "intimate": _grown("intimate_robot_on_person", "The robot, by its own motion, comes within 0.45 m of a person."),
}
"""Name -> (scenario, before, after) -> () bool: whether a step ends an episode early."""


def make_env(
    scenario: Scenario,
    observations: Mapping[str, ObservationLike] | Sequence[str] = OBSERVED,
    rewards: Mapping[str, RewardLike] | None = None,
    *,
    terminations: Sequence[str | Callable] = (),
    randomization: RandomizationLike | None = None,
    action_delay: int | tuple[int, int] = 0,
) -> Env:
    """An environment of reinforcement learning, without a pool.

    Args:
        scenario: of ``make``.
        observations: names in ``OBSERVATIONS``, or name -> term.
        rewards: name -> weight of the term of that name in ``REWARDS``, or your own term; ``mdp.rewards.DEFAULT`` if
            None.
        terminations: ends of episodes besides completion: names in ``TERMINATIONS``, or functions
            (scenario, before, after) -> () bool.
        randomization: of each episode: a name in ``RANDOMIZATIONS``, bounds by the names of ``PARAMETERS`` such as
            ``{"speed": (0.5, 2.0)}``, a YAML file of them, or (key, scenario) -> scenario with other leaves.
        action_delay: delay of commands in steps of control: a number, or (least, most), drawn for each episode.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    randomization = as_randomization(randomization)
    least, most = (action_delay, action_delay) if isinstance(action_delay, int) else action_delay
    if not 0 <= least <= most:
        raise InputError(f"action_delay: {least} to {most} steps must be a lesser and a greater number, 0 or more.")
    env = Env(
        scenario=scenario,
        pool=None,
        observations=observing.as_terms(observations if isinstance(observations, Mapping) else tuple(observations)),
        rewards=rewarding.as_terms(rewarding.DEFAULT if rewards is None else rewards),
        terminations=tuple(as_termination(each) for each in terminations),
        randomization=randomization,
        action_delay=(least, most),
    )
    jax.eval_shape(_try_env, env, jax.eval_shape(jax.random.key, 0))  # reports mistakes of a part now
    return env


def _try_env(env: Env, key: Array) -> None:
    """A reset, and the functions that read a step; the step itself is the scenario's."""
    _, state = env.reset(key)
    scenario = env.scenario_of(state.randomization)
    simulation = state.simulation
    if jax.tree.structure(scenario) == jax.tree.structure(env.scenario):  # not with another term of its forces, say
        for (path, old), new in zip(jax.tree.leaves_with_path(env.scenario), jax.tree.leaves(scenario), strict=True):
            if jnp.shape(old) != jnp.shape(new):
                name = jax.tree_util.keystr(path, simple=True, separator=".")
                function: Any = getattr(env.randomization, "function", env.randomization)
                result = f"{name} of shape {jnp.shape(new)}"
                cure = "keep the shapes of the scenario"
                raise user_calls.wrong("randomization", function, result, str(jnp.shape(old)), cure)
    rewarding.of_step(env.rewards, scenario, simulation, simulation, state.potentials, state.potentials)
    env.ends(scenario, simulation, simulation)


def as_termination(value: str | Callable) -> tuple[str, Callable]:
    """The name and function of a termination: a name in ``TERMINATIONS``, or (scenario, before, after) -> () bool.

    Raises:
        InputError: it is neither.
    """
    if callable(value):
        return getattr(value, "__name__", "own"), value
    if not isinstance(value, str):
        raise InputError(f"terminations: {value!r:.60} is no function (scenario, before, after) -> bool; give one.")
    if value not in TERMINATIONS:
        raise InputError(files.unknown_name("terminations", value, TERMINATIONS))
    return value, TERMINATIONS[value]
