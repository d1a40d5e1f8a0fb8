"""Gymnasium's interface: ``make`` and ``make_vec``, and the same by Gymnasium's own functions once this is imported.

Names are those of ``registry.ALL_ENVS`` after ``sean/``, as in ``gymnasium.make("sean/Lab-Random-RandomAbNav-v0")``.
Episode ``n`` after ``reset(seed=s)`` is drawn from ``fold_in(key(s), n)``, and row ``k`` of a vector environment has
the seed ``s + k``: so it is equal to a single environment of that seed. Observations are dicts of numpy arrays.
"""

import dataclasses
import math
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import PyTree

from sean_jax import mdp, prng, registry
from sean_jax.adapters import NAMESPACE, identity
from sean_jax.base import Array
from sean_jax.drawing import view
from sean_jax.errors import InputError
from sean_jax.scenario import frame, results

MAX_RECENT = 8  # environments whose compiled programs are remembered


@dataclasses.dataclass(frozen=True)
class _Told:
    """What a step gives, cut out of one array: each array that leaves the device costs as much as a small step."""

    sizes: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, env: mdp.Env) -> "_Told":
        parts = [("reward", ()), ("terminated", ()), ("truncated", ()), ("completed", ()), ("command", (2,))]
        parts.append(("situations", (len(env.scenario.situations),)))
        return cls((*parts, *((f"/{name}", box.shape) for name, box in env.observation_space.items())))

    def pack(self, values: dict[str, Any]) -> Array:
        return jnp.concatenate([jnp.ravel(values[name]).astype(jnp.float32) for name, _ in self.sizes])

    def unpack(self, packed: np.ndarray) -> dict[str, np.ndarray]:
        """The parts of (..., K) numbers."""
        found, first = {}, 0
        for name, shape in self.sizes:
            last = first + math.prod(shape)
            found[name] = packed[..., first:last].reshape((*packed.shape[:-1], *shape))
            first = last
        return found

    def observation(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name[1:]: np.array(value) for name, value in values.items() if name.startswith("/")}


class _Layout:
    """A state as one array of bits: a call with a hundred arrays takes three times as long as a step."""

    def __init__(self, like: PyTree):
        self.like = like
        numbers = jax.eval_shape(prng.as_numbers, like)
        self.shapes, self.structure = jax.tree.flatten(numbers)

    def pack(self, state: PyTree) -> Array:
        parts = []
        for leaf in jax.tree.leaves(prng.as_numbers(state)):
            bits = leaf.astype(jnp.uint32) if leaf.dtype == bool else jax.lax.bitcast_convert_type(leaf, jnp.uint32)
            parts.append(jnp.ravel(bits))
        return jnp.concatenate(parts)

    def unpack(self, packed: Array) -> PyTree:
        found, first = [], 0
        for shape in self.shapes:
            words = 1 if shape.dtype == bool else shape.dtype.itemsize // 4
            last = first + words * shape.size
            bits = packed[first:last].reshape((*shape.shape, *([words] if words > 1 else [])))
            whole = bits != 0 if shape.dtype == bool else jax.lax.bitcast_convert_type(bits, shape.dtype)
            found.append(whole)
            first = last
        return prng.as_keys(self.structure.unflatten(found), self.like)


class _Programs:
    """The compiled functions of an environment, of states as arrays of bits."""

    def __init__(self, env: mdp.Env, rows: bool):
        self.told = _Told.of(env)
        self.layout = layout = _Layout(jax.eval_shape(lambda: env.reset(jax.random.key(0)))[1])

        def begin(seed: Array, number: Array) -> tuple[Array, Array]:
            observation, state = env.reset(jax.random.fold_in(jax.random.key(seed), number))
            nothing = {name: jnp.zeros(shape) for name, shape in self.told.sizes}
            seen = {f"/{name}": part for name, part in observation.items()}
            return layout.pack(state), self.told.pack(nothing | seen)

        def advance(packed: Array, action: Array) -> tuple[Array, Array]:
            state, observation, reward, terminated, truncated, info = env.advance(layout.unpack(packed), action)
            values = {"reward": reward, "terminated": terminated, "truncated": truncated}
            values |= {name: info[name] for name in ("completed", "command", "situations")}
            seen = {f"/{name}": part for name, part in observation.items()}
            return layout.pack(state), self.told.pack(values | seen)

        def measured(packed: Array) -> dict[str, Array]:
            return results(env.scenario, layout.unpack(packed).simulation)

        over = jax.vmap if rows else lambda function: function
        self.begin, self.advance, self.measured = (jax.jit(over(part)) for part in (begin, advance, measured))


_recent: dict[Any, _Programs] = {}


def _programs(env: mdp.Env, rows: bool) -> _Programs:
    """Those of an equal environment, if it is among the last; else new ones."""
    key = identity(env), rows
    _recent[key] = _recent.pop(key, None) or _Programs(env, rows)
    if len(_recent) > MAX_RECENT:
        del _recent[next(iter(_recent))]
    return _recent[key]


class SocialNavigation(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """One scenario; an episode that has ended waits for ``reset``."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, env: mdp.Env | str, render_mode: str | None = None, **config: Any):
        """Make the environment.

        Args:
            env: of ``make_env``, or a name of ``registry.ALL_ENVS``.
            render_mode: None or rgb_array.
            config: of a name, fields of its description, such as ``people=20``.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = _env(env, config)
        self.metadata = self.metadata | {"render_fps": round(1.0 / self.env.scenario.time_step)}
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode: '{render_mode}' is not rgb_array or None.")
        self.render_mode = render_mode
        self.observation_space = _space(self.env)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._run = _programs(self.env, rows=False)
        self._seed: int | None = None
        self._episodes = 0
        self._state: Array | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: begins a new row of episodes; None goes on with the next one.

        Returns:
            The observation, and an empty dict.
        """
        super().reset(seed=seed)
        if seed is not None or self._seed is None:
            self._seed, self._episodes = _seed(seed, self.np_random), 0
        self._state, packed = self._run.begin(np.uint32(self._seed), np.int32(self._episodes))
        self._episodes += 1
        return self._run.told.observation(self._run.told.unpack(np.asarray(packed))), {}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One step of control.

        Args:
            action: (2,) from -1 to 1.

        Returns:
            The observation, the reward, ``terminated``, ``truncated``, and a dict: whether the task is ``completed``,
            the ``command`` [m/s, rad/s], the ``situations``, and, at the end of an episode, its ``metrics``.

        Raises:
            InputError: no episode has begun.
        """
        if self._state is None:
            raise InputError("step: no episode has begun; call reset first.")
        self._state, packed = self._run.advance(self._state, np.asarray(action, np.float32))
        told = self._run.told.unpack(np.asarray(packed))
        terminated, truncated = bool(told["terminated"]), bool(told["truncated"])
        names = [name for name, _ in self.env.scenario.situations]
        info = {
            "completed": bool(told["completed"]),
            "command": np.array(told["command"]),
            "situations": dict(zip(names, told["situations"] > 0.5, strict=True)),
        }
        if terminated or truncated:
            info["metrics"] = jax.device_get(self._run.measured(self._state))
        return self._run.told.observation(told), float(told["reward"]), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """A picture of the scenario from above.

        Returns:
            (height, width, 3) uint8, or None if no render_mode was chosen.
        """
        if self.render_mode is None or self._state is None:
            return None
        state = self._run.layout.unpack(self._state)
        shown = frame(state.simulation, state.simulation, state.commands[0])
        return _pixels(view(jax.tree.map(lambda leaf: leaf[None], shown), self.env.scenario))


class VectorSocialNavigation(VectorEnv):
    """Many scenarios that step together; where an episode has ended, the same step or the next one begins another."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        env: mdp.Env | str,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **config: Any,
    ):
        """Make the environments.

        Args:
            env: as of ``SocialNavigation``.
            autoreset_mode: SAME_STEP or NEXT_STEP, which Gymnasium's wrappers of observations need.
            config: as of ``SocialNavigation``.

        Raises:
            InputError: one sentence that names the value and the cure.
        """
        self.env = _env(env, config)
        self.num_envs = num_envs
        self._mode = _autoreset_mode(autoreset_mode)
        rate = round(1.0 / self.env.scenario.time_step)
        self.metadata = self.metadata | {"render_fps": rate, "autoreset_mode": self._mode}
        self.single_observation_space = _space(self.env)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self._run = _programs(self.env, rows=True)
        self._seeds: np.ndarray | None = None
        self._episodes = np.zeros(num_envs, np.int32)
        self._over = np.zeros(num_envs, bool)
        self._state: Array | None = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode in each row.

        Args:
            seed: of the first row, and one more for each of the next; or a seed for each row.

        Returns:
            The observations (B, ...), and an empty dict.

        Raises:
            InputError: seeds are not as many as rows, or one is out of range.
        """
        if isinstance(seed, list):
            if len(seed) != self.num_envs:
                raise InputError(f"seed: {len(seed)} seeds for {self.num_envs} environments; give one for each.")
            self._seeds = np.array([_seed(each, self.np_random) for each in seed], np.uint32)
        else:
            super().reset(seed=seed)
            if seed is not None or self._seeds is None:
                self._seeds = (_seed(seed, self.np_random) + np.arange(self.num_envs)).astype(np.uint32)
        if seed is not None:
            self._episodes = np.zeros(self.num_envs, np.int32)
        self._state, packed = self._run.begin(self._seeds, self._episodes)
        self._episodes, self._over = self._episodes + 1, np.zeros(self.num_envs, bool)
        return self._run.told.observation(self._run.told.unpack(np.asarray(packed))), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One step of control in each row.

        Args:
            actions: (B, 2) from -1 to 1.

        Returns:
            The observations, rewards, ``terminated`` and ``truncated`` (B, ...), and a dict with the ``metrics`` of
            episodes that have ended. SAME_STEP: there the observation is the first of the next episode, and the dict's
            ``final_obs`` and ``final_info`` hold the last. NEXT_STEP: there the step after it begins the next episode,
            whatever the action, with a reward of 0.

        Raises:
            InputError: no episode has begun.
        """
        if self._state is None:
            raise InputError("step: no episode has begun; call reset first.")
        state, packed = self._run.advance(self._state, np.asarray(actions, np.float32))
        packed = np.asarray(packed)
        if self._mode == AutoresetMode.NEXT_STEP:
            state, packed = self._begin(self._over, state, packed)
        told = self._run.told.unpack(packed)
        observation = self._run.told.observation(told)
        terminated, truncated = told["terminated"] > 0.5, told["truncated"] > 0.5
        over, completed = terminated | truncated, told["completed"] > 0.5
        info: dict[str, Any] = {"completed": completed, "command": np.array(told["command"])}
        if over.any():
            metrics = jax.device_get(self._run.measured(state))
            if self._mode == AutoresetMode.NEXT_STEP:
                info |= {"metrics": metrics, "_metrics": over}
            else:
                info |= {"final_obs": observation, "_final_obs": over, "_final_info": over}
                info["final_info"] = {"metrics": metrics, "completed": completed}
                state, packed = self._begin(over, state, packed)
                observation = self._run.told.observation(self._run.told.unpack(packed))
        self._state, self._over = state, over
        return observation, np.array(told["reward"]), terminated, truncated, info

    def _begin(self, rows: np.ndarray, state: Array, packed: np.ndarray) -> tuple[Array, np.ndarray]:
        """The next episode in some rows, and what the others have."""
        if not rows.any():
            return state, packed
        begun, first = self._run.begin(self._seeds, self._episodes)
        self._episodes = self._episodes + rows.astype(np.int32)
        return jnp.where(rows[:, None], begun, state), np.where(rows[:, None], np.asarray(first), packed)


def make(name: str, render_mode: str | None = None, **config: Any) -> SocialNavigation:
    """One environment by its name, without Gymnasium's wrappers.

    Args:
        name: of ``registry.ALL_ENVS``.
        render_mode: None or rgb_array.
        config: fields of its description that differ, such as ``people=20``.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    return SocialNavigation(name, render_mode, **config)


def make_vec(
    name: str, num_envs: int = 1, autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP, **config: Any
) -> VectorSocialNavigation:
    """Many environments by their name, which step together in one compiled call.

    Args:
        name: of ``registry.ALL_ENVS``.
        autoreset_mode: as of ``VectorSocialNavigation``.

    Raises:
        InputError: one sentence that names the value and the cure.
    """
    return VectorSocialNavigation(name, num_envs, autoreset_mode, **config)


def _env(env: mdp.Env | str, config: dict[str, Any]) -> mdp.Env:
    if isinstance(env, str):
        return registry.load(env, config_overrides=config)
    if config:
        raise InputError(f"{next(iter(config))}: the environment is made already; give its name, or leave this out.")
    return env


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    modes = AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP
    for known in modes:
        if mode in (known, known.name, known.value):
            return known
    raise InputError(f"autoreset_mode: '{mode}' is not {' or '.join(known.name for known in modes)}.")


def _space(env: mdp.Env) -> spaces.Dict:
    boxes = env.observation_space.items()
    return spaces.Dict({name: spaces.Box(box.low, box.high, box.shape, np.float32) for name, box in boxes})


def _seed(seed: int | None, random: np.random.Generator) -> int:
    if seed is not None and not 0 <= seed < 2**32:
        raise InputError(f"seed: {seed} must be a whole number from 0 to {2**32 - 1:,}.")
    return int(random.integers(2**31)) if seed is None else int(seed)


def _pixels(figure: Any) -> np.ndarray:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


for _name in registry.ALL_ENVS:
    if f"{NAMESPACE}/{_name}" not in gymnasium.registry:
        gymnasium.register(
            id=f"{NAMESPACE}/{_name}",
            entry_point=SocialNavigation,
            vector_entry_point=VectorSocialNavigation,
            kwargs={"env": _name},
        )
