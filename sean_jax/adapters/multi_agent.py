"""A team of robots as an environment of several agents: what the adapters of JaxMARL and PettingZoo share.

Agents are the robots, by name (``kuri_0``). An observation is one vector, without images; an action is that of
``mdp.action_space``. An agent whose episode has ended stands, without a reward, until the episodes of all have ended.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Float

from sean_jax.config import OBSERVED
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.mdp import make_env, observations, rewards, to_command
from sean_jax.mdp.observations import ObservationLike, flatten
from sean_jax.mdp.rewards import RewardLike
from sean_jax.robots.teammates import with_bodies
from sean_jax.simulation import team
from sean_jax.simulation.scenario_stack import Stack


@struct.dataclass
class TeamState:
    """The state of an episode of M robots."""

    states: State  # (M, ...)
    observation: Float[Array, "M size"]
    observed: Any  # (M, ...) memory of the terms of the observation
    potentials: dict[str, Float[Array, "M"]]  # of the terms of the reward that have one


class TeamStep(NamedTuple):
    """The results (M,) of a step of all robots."""

    reward: Array
    terminated: Array
    truncated: Array
    info: dict[str, Array]


class TeamEnv:
    """A team with an observation and a reward of each robot."""

    def __init__(
        self,
        members: Stack[Scenario],
        observations: Mapping[str, ObservationLike] | Sequence[str] = OBSERVED,
        rewards: Mapping[str, RewardLike] | None = None,
    ):
        """An environment of ``make_team``; observations and rewards as in ``make_env``.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        env = make_env(members.member, observations, rewards)
        self.jitted_reset = jax.jit(self.reset)  # compiled at first use
        self.jitted_step = jax.jit(self.step)
        self.members = members
        self.agents = list(members.names)
        self.observations = env.observations
        self.rewards = env.rewards
        self.action_space = env.action_space  # of each robot: robots of one team have the same drive
        boxes = env.observation_space.items()
        self.low = flatten(self.observations, {name: jnp.full(box.shape, box.low) for name, box in boxes})
        self.high = flatten(self.observations, {name: jnp.full(box.shape, box.high) for name, box in boxes})

    def reset(self, key: Array) -> TeamState:
        """The first state of an episode, from a () typed PRNG key."""
        reset_key, delay_key = jax.random.split(key)
        states = team.reset(self.members, reset_key)
        keys = jax.random.split(delay_key, self.members.size)

        def begin(member: Scenario, state: State, key: Array) -> tuple:
            first, memory = observations.begin(self.observations, *with_bodies(member, state), key)
            flat = flatten(self.observations, first)
            return flat, memory, rewards.potentials(self.rewards, member, state)

        return TeamState(states, *self.members.over_members(begin)(states, keys))

    def step(self, state: TeamState, actions: Float[Array, "M command"]) -> tuple[TeamState, TeamStep]:
        """One step of control, without a reset; actions are from -1 to 1."""
        commands = self.members.over_members(lambda member, action: to_command(member.robot, action))(actions)
        before = state.states
        after = team.step(self.members, before, commands)

        def observe(member: Scenario, before: State, after: State, observed: Any, previous: dict[str, Array]) -> tuple:
            view = with_bodies(member, after)
            observation, memory = observations.observe(self.observations, *view, observed)
            potentials = rewards.potentials(self.rewards, member, after)
            terms = rewards.of_step(self.rewards, member, before, after, previous, potentials)
            over = before.completed | before.timed_out
            reward = jnp.where(over, 0.0, jnp.stack(list(terms.values())).sum())
            return flatten(self.observations, observation), memory, potentials, reward

        observe_all = self.members.over_members(observe)
        observation, memory, potentials, reward = observe_all(before, after, state.observed, state.potentials)
        info = {"completed": after.completed, "timed_out": after.timed_out, "command": commands}
        result = TeamStep(reward, after.completed, after.timed_out, info)
        return TeamState(after, observation, memory, potentials), result

    def by_agent(self, values: Array) -> dict[str, Array]:
        """Agent -> its row of values (M, ...)."""
        return {name: values[row] for row, name in enumerate(self.agents)}

    def rows(self, by_agent: Mapping[str, Any]) -> Float[Array, "M command"]:
        """The actions of a dict by agent; zeros of agents that are not in it."""
        still = jnp.zeros(self.action_space.shape, float)
        return jnp.stack([jnp.asarray(by_agent.get(name, still), float) for name in self.agents])
