"""The recorder: demonstrations from any source of commands, outside ``jit``: a joystick, a web page, a planner, a list.

It makes the same datasets as ``sean collect``. An episode is one shard, so what is committed survives whatever comes.
"""

import functools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import navigation, prng, sensors, writing
from sean_jax.base import Array, Scenario, State
from sean_jax.config import MAX_PIXELS, present_names
from sean_jax.errors import InputError
from sean_jax.learning import dataset as datasets
from sean_jax.learning.collection import check_place, scenario_facts
from sean_jax.learning.dataset import Dataset
from sean_jax.learning.demonstrations import Batch, steps_of_row
from sean_jax.learning.examples import row
from sean_jax.scenario import reset, step


class Recorder:
    """Episodes of one scenario, one after the other, into a dataset that is begun or continued.

    ``state = recorder.begin()``, then ``state = recorder.step(command)`` for each step of control, then
    ``recorder.commit()`` or ``recorder.discard()``.
    """

    def __init__(
        self,
        folder: Path | str,
        scenario: Scenario,
        *,
        driver: str = "human",
        seed: int = 0,
        width: int = 64,
        height: int = 48,
        rate: int = 1,
    ):
        """Args:
            driver: who gives the commands: a word for the manifest.
            seed: episode ``i`` begins as ``fold_in(prng.key("record", seed), i)`` says.
            width: of the depth images [pixels].
            height: likewise.
            rate: rows a second, a divisor of the steps of control in a second.

        Raises:
            InputError: the folder holds something else, the images are too large, or the rate is no divisor.
        """  # noqa: D205
        if width * height > MAX_PIXELS:
            raise InputError(f"width: {width} times {height} are more than {MAX_PIXELS:,} pixels; ask for fewer.")
        if (steps := round(1.0 / scenario.time_step)) % rate:
            raise InputError(f"rate: {rate} rows a second do not divide its {steps} steps; choose a divisor.")
        folder = Path(folder)
        self.scenario, self.seed, self.rate = scenario, seed, rate
        self.eye = sensors.camera(scenario, "depth", width=width, height=height)
        self.data = self._opened(folder, driver)
        self._begin, self._step, self._row = (jax.jit(part) for part in (_begin, step, self._look))
        self.discard()

    @property
    def number(self) -> int:
        """Of the next episode."""
        return len(self.data.manifest["shards"])

    def begin(self, key: Array | None = None) -> State:
        """A new episode; one that was not committed is forgotten.

        Args:
            key: () typed PRNG key that the episode is drawn from, such as one of another program's episodes that shall
                be driven as well; by default of the recorder's own stream, which has no episode of any other.
        """
        self.discard()
        if key is None:
            key = jax.random.fold_in(prng.key("record", self.seed), jnp.uint32(self.number))
        self.state, self._last = self._begin(self.scenario, key)
        return self.state

    def step(self, command: Any) -> State:
        """One step of control later.

        Args:
            command: (2,) m/s and rad/s; None, or one that is not finite, is no new one.

        Raises:
            InputError: no episode has begun.
        """
        if self.state is None:
            raise InputError("recorder: no episode has begun; call begin first.")
        given = np.full(2, np.nan) if command is None else np.asarray(command, np.float64).reshape(2)
        new = bool(np.isfinite(given).all())
        self._held = np.where(new, given, self._held)
        if int(self.state.tick) % steps_of_row(self.scenario, self.rate) == 0 and len(self._rows) < self._max_rows:
            held = jnp.asarray(self._held, float)
            self._rows.append(jax.tree.map(np.asarray, self._row(self.scenario, self.state, held, self._last)))
        self.state = self._step(self.scenario, self.state, jnp.asarray(given, float))
        return self.state

    def commit(self) -> None:
        """Keep the episode.

        Raises IncompleteError if it cannot be written, and then it can be tried again; InputError or WriteError if
        somebody else records in the folder.
        """
        if self.state is None or not self._rows:
            raise InputError("recorder: there is nothing to commit; call begin and step first.")
        rows = {}
        for name, (shape, kind) in self.data.fields.items():
            rows[name] = np.zeros((1, self._max_rows, *shape), kind)
            rows[name][0, : len(self._rows)] = np.stack([getattr(one, name) for one in self._rows])
        completed = np.array([bool(self.state.completed)])
        with writing.folder_lock(self.data.folder):
            if datasets.open_dataset(self.data.folder).manifest != self.data.manifest:
                raise InputError(f"{self.data.folder} was continued by somebody else; record in another folder.")
            self.data.commit(0, Batch(rows, np.array([len(self._rows)]), completed))
        self.discard()

    def discard(self) -> None:
        """Forget the episode."""
        self.state: Any = None
        self._rows: list[Any] = []
        self._held = np.zeros(2)

    @property
    def _max_rows(self) -> int:
        return self.data.most_rows

    def _look(self, scenario: Scenario, state: State, command: Array, last: Array) -> Any:
        return row(scenario, state, command, self.eye, last)

    def _opened(self, folder: Path, driver: str) -> Dataset:
        kept = {"seed": self.seed, "driver": driver, "task": self.scenario.task_name, "people": self.scenario.people}
        manifest = {
            "command": "",
            "options": {
                **kept,
                "rate": self.rate,
                "environment": self.scenario.environment.name,
                "size": [self.eye.width, self.eye.height],
            },
            **scenario_facts(self.scenario, self.eye, driver, self.rate),
            "hours": 1e6,  # all that is recorded takes part
            "batch": 1,
            "streams": [self.scenario.task_name],
        }
        if not (folder / datasets.MANIFEST).exists():
            check_place(folder)
            with writing.folder_lock(folder):
                return datasets.create_dataset(folder, manifest)
        data = datasets.open_dataset(folder)
        if {"rate": 1, **present_names(data.manifest["options"])} != manifest["options"]:
            raise InputError(f"{folder} was begun with another scenario, driver, seed or rate; choose another folder.")
        return data


def record(recorder: Recorder, commands: Callable[[State], Any] | Iterable[Any], episodes: int) -> Dataset:
    """Record so many episodes, each until it is completed or timed out, and commit them.

    Args:
        commands: a function of the state, or one command (2,) for each step. If they end midway, what was driven until
            then is committed as the last episode.
    """
    source = commands if callable(commands) else functools.partial(_next, iter(commands))
    for _ in range(episodes):
        state, over = recorder.begin(), False
        while not (over or bool(state.completed | state.timed_out)):
            try:
                state = recorder.step(source(state))
            except StopIteration:
                over = True
        if recorder._rows:
            recorder.commit()
        if over:
            break
    return recorder.data


def _next(commands: Any, state: State) -> Any:
    return next(commands)


def _begin(scenario: Scenario, key: Array) -> tuple[State, Array]:
    state = reset(scenario, key)
    return state, navigation.last_arc_to_goal(scenario.navigation, state.task.goal)
