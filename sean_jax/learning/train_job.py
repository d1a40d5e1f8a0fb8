"""``sean train imitation``: epochs until the loss in validation stops falling, with checkpoints (section V-C).

Killed at any moment, the same command goes on from the latest checkpoint and comes to the same result.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import devices, writing
from sean_jax.learning import balance, training
from sean_jax.learning.checkpoints import Checkpoints, begin, begun
from sean_jax.learning.dataset import Dataset, on_device, open_dataset, split
from sean_jax.learning.loader import Loader, Token
from sean_jax.learning.logs import Log
from sean_jax.learning.network import Network
from sean_jax.learning.options import Refused, Train
from sean_jax.learning.progress import shown
from sean_jax.learning.training import Losses, TrainState
from sean_jax.versions import versions

if TYPE_CHECKING:
    from rich.console import Console

EVERY = 10  # epochs, between two checkpoints where nothing gets better
FALLBACK = 4e9  # bytes, of a device that does not tell how much memory it has


def train(options: Train, console: Console | Callable[[float], None] | None = None) -> TrainState:
    """Train, and give the state at the end; the best network is what ``learned.load`` takes from the folder.

    Raises Refused for what cannot be asked for, Unwritable if somebody else trains in the folder, Failed if a file is
    damaged or cannot be written, FloatingPointError if the loss is not finite; the checkpoints until then stay.
    """
    options.check()
    data = open_dataset(options.dataset)
    kept, held = split(data, options.validation, options.seed)
    network = Network(options.width, options.flags, data.image)
    config = _config(options, data, network)
    begun(options.folder, config)  # to refuse before anything is written
    with writing.held(options.folder):
        return _train(options, console, data, kept, held, network, config)


def _train(options: Train, console: Any, data: Dataset, kept, held, network: Network, config: dict) -> TrainState:
    """In a folder that nobody else writes."""
    going_on, over = begun(options.folder, config), devices.mesh()
    epoch = _epoch(data, kept, held, network, options, over)
    commands = jnp.asarray(_commands(data, kept))
    start = jax.jit(training.begin, static_argnums=(0, 1, 2))
    state = start(network, len(data.manifest["situations"]), options, commands)
    if not going_on:
        begin(options.folder, config)
    checkpoints = Checkpoints(options.folder, writes=True)
    state = (checkpoints.latest(state) if going_on else None) or state
    state = devices.everywhere(over, state)
    log = Log(options.folder, int(state.epoch))
    with shown(console, "training", options.epochs) as tell:
        try:
            while not _over(state, options):
                began = time.time()
                after, found, validated = epoch(state)
                state = _finite(after, found, validated, options.folder)
                number, better = int(state.epoch), int(state.best_epoch) == int(state.epoch)
                log.add({"epoch": number, "train": _told(found), "validation": _told(validated), "time": time.time()})
                if better or number % EVERY == 0 or _over(state, options):
                    checkpoints.save(state, float(validated.loss))
                best = f"best {float(state.best):.4f} after {int(state.best_epoch)}"
                note = f"loss {float(validated.loss):.4f}, {best}, {time.time() - began:.2f} s an epoch"
                tell(number, f"epoch {number} · {note}")
        finally:
            checkpoints.wait()
    return state


def _epoch(data: Dataset, kept, held, network: Network, options: Train, over) -> Callable:
    """state -> (state, Losses, Losses), with the dataset on the devices if it fits there, else from disk."""
    programs = training.programs(network, options, over)
    if data.examples * data.row_bytes <= options.on_device * _memory():
        recording = devices.everywhere(over, on_device(data.recording([*kept, *held])))
        number = sum(episode.length for episode in kept)
        rows = jnp.arange(data.examples, dtype=jnp.int32)
        odds = jnp.asarray(balance.odds(data.read(kept, ("situations",))["situations"])) if options.balance else None
        return lambda state: programs.epoch(state, recording, rows[:number], rows[number:], odds)
    if options.balance:
        raise Refused("--balance needs the dataset to fit on the device; collect less, or raise --on-device.")
    size = -(-options.batch // over.size) * over.size
    loader = Loader(data, kept, size, options.seed)
    fixed = Loader(data, held, size, options.seed, shuffle=False)

    def from_disk(state: TrainState) -> tuple[TrainState, Losses, Losses]:
        trained, found = jnp.zeros(4, jnp.float32), jnp.zeros(4, jnp.float32)
        for _, examples, weight in loader.epoch(Token(int(state.epoch))):
            state, sums = programs.update(state, examples, weight)
            trained = trained + sums
        for _, examples, weight in fixed.epoch():
            found = found + programs.measure(state, examples, weight)
        return programs.finish(state, trained, found)

    return from_disk


def _memory() -> float:
    """Bytes of the first device."""
    try:
        return float((jax.devices()[0].memory_stats() or {})["bytes_limit"])
    except (KeyError, RuntimeError, NotImplementedError):  # a CPU, or a backend that does not tell
        return FALLBACK


def _commands(data: Dataset, kept: list) -> np.ndarray:
    return data.read(kept, ("command",))["command"]


def _over(state: TrainState, options: Train) -> bool:
    done = int(state.epoch)
    return done >= options.epochs or done - int(state.best_epoch) >= options.patience


def _finite(state: TrainState, found: Losses, validated: Losses, folder: Path) -> TrainState:
    if not (math.isfinite(float(found.loss)) and math.isfinite(float(validated.loss))):
        where = f"the loss is not finite in epoch {int(state.epoch)}; {folder} keeps the checkpoints until then"
        raise FloatingPointError(f"{where}; try a lesser --learning-rate in another folder.")
    return state


def _told(losses: Losses) -> dict[str, float]:
    return {name: float(value) for name, value in losses._asdict().items()}


def _config(options: Train, data: Dataset, network: Network) -> dict[str, Any]:
    if data.examples < 2:
        raise Refused(f"{data.folder} has {data.examples} examples, too few to learn from; collect more.")
    return {
        "command": options.command,
        "width": network.width,
        "flags": network.flags,
        "image": list(network.image),
        "situations": data.manifest["situations"],
        "sources": {"planner": network.planner_sources, "controller": network.controller_sources},
        **{name: value for name, value in options.fixed().items() if name not in ("width", "flags")},
        "devices": len(jax.devices()),
        "dataset": {"fingerprint": data.fingerprint(), "command": data.manifest["command"]},
        "versions": versions(),
    }
