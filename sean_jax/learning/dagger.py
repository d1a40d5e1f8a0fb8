"""Dataset aggregation: imitation of an expert in the student's own states.

``train`` is ``sean train dagger``: in rounds, the network drives, the expert labels, and the next network learns from
all data until then. The folder has ``round-0``, the network of the demonstrations alone, ``data-K``, what network K - 1
drove with the expert's labels, and ``round-K``, the network of all data until then; each part is resumed.

Source: S. Ross, G. Gordon & J. Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011, with networks that drive by themselves from the first round on.
"""

from pathlib import Path
from typing import Any

from sean_jax.config import CollectConfig, DaggerConfig, ImitationConfig, Named, user_parts, validate
from sean_jax.io import writing
from sean_jax.io.progress import ProgressLike, say
from sean_jax.learning import collection, imitation
from sean_jax.learning.dataset import Dataset, open_dataset
from sean_jax.learning.policy import check_policy
from sean_jax.learning.trainer import TrainState, check_config, method_config, write_config


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
    collecting = _collect_options(options, first, 1)
    user_parts.check_trust(collecting)
    facts = {"fingerprint": first.fingerprint(), "command": first.manifest["command"]}
    config = method_config(options, dataset=facts)
    datasets = [options.dataset, *options.datasets]
    pretrained = options.pretrained
    imitation.prepare(_train_options(options, datasets, pretrained, options.folder))
    check_policy(options.expert, collecting, "expert")
    resumes = check_config(options.folder, config)

    with writing.folder_lock(options.folder):
        if not resumes:
            write_config(options.folder, config)
        state = imitation.train(*_round(options, datasets, pretrained, 0, console))
        for number in range(1, options.rounds + 1):
            say(console, f"round {number} of {options.rounds}: the network drives, {options.expert.kind} labels")
            share = _share_of_progress(console, 2 * number - 1, options.rounds)
            collection.collect(_collect_options(options, first, number), share)
            datasets.append(options.folder / f"data-{number}")
            pretrained = options.folder / f"round-{number - 1}"
            state = imitation.train(*_round(options, datasets, pretrained, number, console))
    return state


def _round(
    options: DaggerConfig, datasets: list[Path], pretrained: Path | None, number: int, console: ProgressLike
) -> tuple[ImitationConfig, ProgressLike]:
    """The training of a round, and its share of the progress."""
    out = options.folder / f"round-{number}"
    share = _share_of_progress(console, 2 * number, options.rounds)
    return _train_options(options, datasets, pretrained, out), share


def _collect_options(options: DaggerConfig, first: Dataset, number: int) -> CollectConfig:
    """The collection of a round: the demonstrations' scenario, with other episodes."""
    described = first.description()
    student = str(options.folder / f"round-{number - 1}")
    changed = {
        "policy": Named(kind=student),
        "labels": options.expert,
        "hours": options.hours,
        "seed": described.seed + number,
    }
    return described.replace(**changed, out=options.folder / f"data-{number}", quiet=options.quiet)


def _train_options(options: DaggerConfig, datasets: list[Path], pretrained: Path | None, out: Path) -> ImitationConfig:
    shared = {name: getattr(options, name) for name in ImitationConfig.model_fields}
    first, *others = datasets
    changed = {"method": "imitation", "dataset": first, "datasets": tuple(others), "pretrained": pretrained, "out": out}
    return validate(ImitationConfig, shared | changed)


def _share_of_progress(console: Any, part: int, rounds: int) -> Any:
    """A function that maps the share of a part to the share of the whole; a console is unchanged."""
    if console is None or hasattr(console, "print"):
        return console
    return lambda share: console((part + share) / (2 * rounds + 1))
