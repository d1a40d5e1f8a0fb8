"""Gymnasium's interface; once this is imported, Gymnasium's ``make`` and ``make_vec`` know the environments, too.

Names are ``sean/`` and a name of ``registry.ALL_ENVS``, as in ``gymnasium.make("sean/Lab-Random-RandomAbNav-v0")``.
Episode ``n`` after ``reset(seed=s)`` is drawn from ``fold_in(key(s), n)``, and row ``k`` of a vector environment has
the seed ``s + k``: so it is equal to a single environment of that seed. Observations are dicts of numpy arrays.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import PyTree

from sean_jax import mdp
from sean_jax.adapters import NAMESPACE, identity, load, picture
from sean_jax.core import random_streams
from sean_jax.core.data_types import Array
from sean_jax.core.errors import InputError
from sean_jax.mdp import registry
from sean_jax.simulation.scenario import results

MAX_RECENT = 8  # environments whose compiled programs are remembered


class _Packing:
    """A pytree as one array per type of number: a call with a hundred arrays takes three times the time of a step."""

    def __init__(self, like: PyTree):
        self.leaves, self.structure = jax.tree.flatten(like)

    def pack(self, tree: PyTree) -> dict[str, Array]:
        """The leaves of a pytree, flat and one after the other, by type."""
        flat: dict[str, list[Array]] = {}
        for leaf in jax.tree.leaves(tree):
            flat.setdefault(str(leaf.dtype), []).append(jnp.ravel(leaf))
        return {dtype: jnp.concatenate(arrays) for dtype, arrays in flat.items()}

    def unpack(self, packed: Mapping[str, Any]) -> PyTree:
        """The pytree of arrays (..., K), with their leading axes."""
        leaves = []
        begin = dict.fromkeys(packed, 0)  # of the next leaf of each type
        for leaf in self.leaves:
            dtype = str(leaf.dtype)
            end = begin[dtype] + leaf.size
            values = packed[dtype][..., begin[dtype] : end]
            leaves.append(values.reshape((*values.shape[:-1], *leaf.shape)))
            begin[dtype] = end
        return self.structure.unflatten(leaves)


class _Programs:
    """The compiled functions of an environment, of packed states and packed results of a step in 32 bits."""

    def __init__(self, env: mdp.Env, rows: bool):
        observation, self.state = jax.eval_shape(lambda: env.reset(jax.random.key(0)))
        self._env = env
        self._states = _Packing(jax.eval_shape(random_streams.as_numbers, self.state))
        self._zeros = {
            "reward": np.zeros((), np.float32),
            "terminated": np.zeros((), np.float32),
            "truncated": np.zeros((), np.float32),
            "completed": np.zeros((), np.float32),
            "command": np.zeros(env.action_space.shape, np.float32),
            "situations": np.zeros(len(env.scenario.situations), np.float32),
        }
        first = {name: np.zeros(term.shape, np.float32) for name, term in observation.items()}
        self._results = _Packing(self._zeros | {"observation": first})
        over = jax.vmap if rows else lambda function: function
        self.begin = jax.jit(over(self._begin))
        self.advance = jax.jit(over(self._advance))
        self.measured = jax.jit(over(self._measured))

    def _begin(self, seed: Array, number: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        """The first state of an episode of a seed, and its results."""
        observation, state = self._env.reset(jax.random.fold_in(jax.random.key(seed), number))
        return self._pack(state, self._zeros | {"observation": observation})

    def _advance(self, packed: dict[str, Array], action: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        """The state after a step, and its results."""
        state, observation, reward, terminated, truncated, info = self._env.advance(self.unpack(packed), action)
        values = {name: info[name] for name in ("completed", "command", "situations")}
        values |= {"reward": reward, "terminated": terminated, "truncated": truncated, "observation": observation}
        return self._pack(state, values)

    def _measured(self, packed: dict[str, Array]) -> dict[str, Array]:
        """The metrics of a state."""
        return results(self._env.scenario, self.unpack(packed).simulation)

    def _pack(self, state: PyTree, values: dict[str, Any]) -> tuple[dict[str, Array], dict[str, Array]]:
        values = jax.tree.map(lambda value: jnp.asarray(value, jnp.float32), values)
        return self._states.pack(random_streams.as_numbers(state)), self._results.pack(values)

    def unpack(self, packed: dict[str, Array]) -> mdp.EnvState:
        """The state of its packed form."""
        return random_streams.as_keys(self._states.unpack(packed), self.state)

    def read(self, packed: dict[str, Any]) -> dict[str, Any]:
        """The results of a step on the host, with an observation that may be written to."""
        values = self._results.unpack(jax.device_get(packed))
        values["observation"] = {name: np.array(term) for name, term in values["observation"].items()}
        return values


_recent: dict[Any, _Programs] = {}


def _programs(env: mdp.Env, rows: bool) -> _Programs:
    """The programs of an equal environment, if it is among the latest; else new ones."""
    key = identity(env), rows
    _recent[key] = _recent.pop(key, None) or _Programs(env, rows)
    if len(_recent) > MAX_RECENT:
        del _recent[next(iter(_recent))]
    return _recent[key]


class SocialNavigation(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """One scenario; after its end an episode waits for ``reset``."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, env: mdp.Env | str, render_mode: str | None = None, **config: Any):
        """An environment of ``make_env``, or a name of ``registry.ALL_ENVS`` with fields of its description, as
        ``people=20``.

        Args:
            render_mode: None or rgb_array.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = load(env, config)
        self.metadata = self.metadata | {"render_fps": round(1.0 / self.env.scenario.time_step)}
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode: '{render_mode}' is not rgb_array or None.")
        self.render_mode = render_mode
        self.observation_space = _space(self.env)
        self.action_space = spaces.Box(-1.0, 1.0, self.env.action_space.shape, np.float32)
        self._run = _programs(self.env, rows=False)
        self._seed: int | None = None
        self._episodes = 0
        self._state: dict[str, Array] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The first observation of an episode, and an empty dict; a seed begins a new row of episodes, None goes on
        with the next one.
        """
        super().reset(seed=seed)
        if seed is not None or self._seed is None:
            self._seed = _seed(seed, self.np_random)
            self._episodes = 0
        self._state, packed = self._run.begin(np.uint32(self._seed), np.int32(self._episodes))
        self._episodes += 1
        return self._run.read(packed)["observation"], {}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One step of control, of an action from -1 to 1.

        Returns:
            The observation, the reward, ``terminated``, ``truncated``, and a dict: whether the task is ``completed``,
            the ``command`` [m/s, rad/s], the ``situations``, and, at the end of an episode, its ``metrics``.

        Raises:
            InputError: no episode has begun.
        """
        if self._state is None:
            raise InputError("step: no episode has begun; call reset first.")
        self._state, packed = self._run.advance(self._state, np.asarray(action, np.float32))
        values = self._run.read(packed)
        terminated = bool(values["terminated"])
        truncated = bool(values["truncated"])
        names = [name for name, _ in self.env.scenario.situations]
        info = {
            "completed": bool(values["completed"]),
            "command": np.array(values["command"]),
            "situations": dict(zip(names, values["situations"] > 0.5, strict=True)),
        }
        if terminated or truncated:
            info["metrics"] = jax.device_get(self._run.measured(self._state))
        return values["observation"], float(values["reward"]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """A picture (height, width, 3) uint8 of the scenario from above; None without a render_mode."""
        if self.render_mode is None or self._state is None:
            return None
        return picture(self.env, self._run.unpack(self._state))


class VectorSocialNavigation(VectorEnv):
    """Many scenarios that step together; when an episode ends, the same or the next step starts another."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        env: mdp.Env | str,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **config: Any,
    ):
        """As of ``SocialNavigation``.

        Args:
            autoreset_mode: SAME_STEP or NEXT_STEP, which Gymnasium's wrappers of observations need.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = load(env, config)
        self.num_envs = num_envs
        self._mode = _autoreset_mode(autoreset_mode)
        self.metadata = self.metadata | {
            "render_fps": round(1.0 / self.env.scenario.time_step),
            "autoreset_mode": self._mode,
        }
        self.single_observation_space = _space(self.env)
        self.single_action_space = spaces.Box(-1.0, 1.0, self.env.action_space.shape, np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self._run = _programs(self.env, rows=True)
        self._seeds: np.ndarray | None = None
        self._episodes = np.zeros(num_envs, np.int32)
        self._done = np.zeros(num_envs, bool)
        self._state: dict[str, Array] | None = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The first observations (B, ...) of an episode in each row, and an empty dict.

        Args:
            seed: of the first row, and one more for each of the next; or a seed for each row.

        Raises:
            InputError: seeds are not as many as rows, or one is out of range.
        """
        if isinstance(seed, list):
            if len(seed) != self.num_envs:
                raise InputError(f"seed: {len(seed)} seeds for {self.num_envs} environments; give one for each.")
            self._seeds = np.array([_seed(row_seed, self.np_random) for row_seed in seed], np.uint32)
        else:
            super().reset(seed=seed)
            if seed is not None or self._seeds is None:
                self._seeds = (_seed(seed, self.np_random) + np.arange(self.num_envs)).astype(np.uint32)
        if seed is not None:
            self._episodes = np.zeros(self.num_envs, np.int32)
        self._state, packed = self._run.begin(self._seeds, self._episodes)
        self._episodes = self._episodes + 1
        self._done = np.zeros(self.num_envs, bool)
        return self._run.read(packed)["observation"], {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One step of control in each row, of actions (B, 2) from -1 to 1.

        Returns:
            The observations, rewards, ``terminated`` and ``truncated`` (B, ...), and a dict with the ``metrics`` of
            ended episodes. SAME_STEP: there the observation is the first of the next episode, and the dict's
            ``final_obs`` and ``final_info`` hold the last. NEXT_STEP: there the next step begins the next episode,
            whatever the action, with a reward of 0.

        Raises:
            InputError: no episode has begun.
        """
        if self._state is None:
            raise InputError("step: no episode has begun; call reset first.")
        state, packed = self._run.advance(self._state, np.asarray(actions, np.float32))
        if self._mode == AutoresetMode.NEXT_STEP:
            state, packed = self._begin(self._done, state, packed)
        values = self._run.read(packed)
        observation = values["observation"]
        terminated = values["terminated"] > 0.5
        truncated = values["truncated"] > 0.5
        done = terminated | truncated
        completed = values["completed"] > 0.5
        info: dict[str, Any] = {"completed": completed, "command": np.array(values["command"])}

        # Where an episode has ended, its metrics; SAME_STEP also begins the next one there.
        if done.any():
            metrics = jax.device_get(self._run.measured(state))
            if self._mode == AutoresetMode.NEXT_STEP:
                info |= {"metrics": metrics, "_metrics": done}
            else:
                info |= {"final_obs": observation, "_final_obs": done, "_final_info": done}
                info["final_info"] = {"metrics": metrics, "completed": completed}
                state, packed = self._begin(done, state, packed)
                observation = self._run.read(packed)["observation"]
        self._state = state
        self._done = done
        return observation, np.array(values["reward"]), terminated, truncated, info

    def _begin(self, rows: np.ndarray, state: dict[str, Array], packed: dict[str, Array]) -> tuple[dict, dict]:
        """State and results with the next episode in some rows."""
        if not rows.any():
            return state, packed
        begun = self._run.begin(self._seeds, self._episodes)
        self._episodes = self._episodes + rows.astype(np.int32)

        def choose(new: Array, old: Array) -> Array:
            return jnp.where(rows[:, None], new, old)

        return jax.tree.map(choose, begun, (state, packed))


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    modes = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP
    for known in modes:
        if mode in (known, known.name, known.value):
            return known
    raise InputError(f"autoreset_mode: '{mode}' is not {' or '.join(known.name for known in modes)}.")


def _space(env: mdp.Env) -> spaces.Dict:
    boxes = {}
    for name, box in env.observation_space.items():
        boxes[name] = spaces.Box(box.low, box.high, box.shape, np.float32)
    return spaces.Dict(boxes)


def _seed(seed: int | None, random: np.random.Generator) -> int:
    """A seed, drawn if there is none; InputError if it is out of range."""
    if seed is None:
        return int(random.integers(2**31))
    if not 0 <= seed < 2**32:
        raise InputError(f"seed: {seed} must be a whole number from 0 to {2**32 - 1:,}.")
    return int(seed)


for _name in registry.ALL_ENVS:
    if f"{NAMESPACE}/{_name}" not in gymnasium.registry:
        gymnasium.register(
            id=f"{NAMESPACE}/{_name}",
            entry_point=SocialNavigation,
            vector_entry_point=VectorSocialNavigation,
            kwargs={"env": _name},
        )
