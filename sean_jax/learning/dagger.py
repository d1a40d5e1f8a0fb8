"""``sean train dagger``: imitation of an expert in the student's own states (dataset aggregation).

A network that imitates demonstrations drives into states in which nobody ever demonstrated. So it drives, the expert
says what should have been done there, and the next network learns from all data until then. In the folder ``round-0``
is the network of the demonstrations alone, ``data-K`` what network K - 1 drove with the expert's labels, and
``round-K`` the network of all data until then. Each of these parts goes on where it stopped.

Source: S. Ross et al., "A reduction of imitation learning and structured prediction to no-regret online learning",
AISTATS 2011, with networks that drive by themselves from the first round on.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from sean_jax import components, writing
from sean_jax.config import CollectConfig, DaggerConfig, ImitationConfig
from sean_jax.flags import command
from sean_jax.learning import choice, collection, training
from sean_jax.learning.checkpoints import check_config, write_config
from sean_jax.learning.dataset import Dataset, open_dataset
from sean_jax.learning.training import TrainState
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
    components.check_trust(_driving(options, first, 1))
    config = _config(options, first)
    training.prepare(_learning(options, [options.dataset, *options.datasets], options.pretrained, options.folder))
    choice.check(options.expert, _driving(options, first, 1), "expert")
    resumes = check_config(options.folder, config)
    with writing.folder_lock(options.folder):
        if not resumes:
            write_config(options.folder, config)
        data, before, state = [options.dataset, *options.datasets], options.pretrained, None
        for number in range(options.rounds + 1):
            if number > 0:
                data.append(options.folder / f"data-{number}")
                _say(console, f"round {number} of {options.rounds}: the network drives, {options.expert.kind} labels")
                collection.collect(_driving(options, first, number), _part(console, 2 * number - 1, options.rounds))
            out = options.folder / f"round-{number}"
            state = training.train(_learning(options, data, before, out), _part(console, 2 * number, options.rounds))
            before = out
    assert state is not None
    return state


def _driving(options: DaggerConfig, first: Dataset, number: int) -> CollectConfig:
    """What is recorded in a round: the demonstrations' scenario, with other episodes."""
    had = first.description()
    student = str(options.folder / f"round-{number - 1}")
    own = {"policy": student, "labels": options.expert, "hours": options.hours, "seed": had.seed + number}
    return had.replace(**own, out=options.folder / f"data-{number}", quiet=options.quiet)


def _learning(options: DaggerConfig, data: list[Path], before: Path | None, out: Path) -> ImitationConfig:
    """What is trained in a round."""
    shared = {name: getattr(options, name) for name in ImitationConfig.model_fields}
    own = {"method": "imitation", "dataset": data[0], "datasets": tuple(data[1:]), "pretrained": before, "out": out}
    return ImitationConfig(**(shared | own))


def _part(console: Any, part: int, rounds: int) -> Any:
    """What tells a part's progress as a share of the whole."""
    if console is None or hasattr(console, "print"):
        return console
    return lambda share: console((part + share) / (2 * rounds + 1))


def _say(console: Any, text: str) -> None:
    if console is not None and hasattr(console, "print"):
        console.print(text, markup=False)


def _config(options: DaggerConfig, first: Dataset) -> dict[str, Any]:
    return {
        "command": command("train", options),
        "method": options.method,
        **options.identity(),
        "parts": components.digests(options),
        "dataset": {"fingerprint": first.fingerprint(), "command": first.manifest["command"]},
        "versions": versions(),
    }
