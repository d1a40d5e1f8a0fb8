"""Figure 4: policies that learned among people of three behaviors, and the navigation stack, in three scenarios.

For each behavior (G, R, H) several datasets of demonstrations are collected, and several networks are trained on each.
These policies, one with balanced examples (B), the navigation stack with social cost layers (N) and the demonstrator
(E) are evaluated on the same numbered episodes (section V-C), of which each network drives its share.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sean_jax import learning, writing
from sean_jax.config import CollectConfig, ExperimentConfig, Named, ScenarioConfig, TrainConfig
from sean_jax.errors import InputError
from sean_jax.experiments import page, parts, pictures, shares, table1
from sean_jax.experiments.claims import BALANCED, DEMONSTRATOR, FOUR, LEARNED, NAVIGATION, Results, Training, claims
from sean_jax.experiments.shares import BEHAVIORS
from sean_jax.experiments.together import Part, together
from sean_jax.files import listed
from sean_jax.learning import choice, protocol
from sean_jax.learning.loader import balanced_probabilities
from sean_jax.learning.protocol import streams
from sean_jax.runner import Runner, Watch
from sean_jax.scenario import results

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Policy, Scenario
    from sean_jax.learning.training import TrainState
    from sean_jax.metrics import Estimate

BATCH = {"cpu": 32}  # episodes at once, by kind of device
BATCH_ELSEWHERE = 4096
LOADING = threading.Lock()
INTIMATE = "intimate_robot_on_person", "intimate_person_on_robot"
METRIC_NAMES = (
    "completed", "seconds", "time_not_moving", *INTIMATE, "collision_robot_on_person", "collision_person_on_robot",
)  # fmt: skip
Columns = dict[str, list]  # metric -> its value in each episode, E values or E lists of them


def run(options: ExperimentConfig, console: Console | None = None) -> Path:
    """Collect, train and evaluate what the folder lacks, and write the report.

    Args:
        options: of the experiment.
        console: shows progress; None shows nothing.

    Returns:
        The folder.

    Raises:
        InputError: the options are wrong, or the folder holds another experiment.
        WriteError: another process writes in the folder.
        IncompleteError: a file in the folder is damaged.
        FloatingPointError: a metric is not finite. Finished parts stay.

    Source: section V-C, Figure 4.
    """
    options = options.complete()
    for behavior in BEHAVIORS:
        protocol.check(_collect_config(options, options.folder, behavior, 0))
    for name in others(options):
        choice.check(name, ScenarioConfig(), "--others")
    folder = options.folder
    parts.has_started(options)
    with writing.folder_lock(folder):
        _run(options, folder, console)
    return folder


def others(options: ExperimentConfig) -> list[str]:
    """Drivers beside those of the paper, N and E.

    Args:
        options: of the experiment.

    Returns:
        Names, folders or FILE.py:NAME, each once.

    Raises:
        InputError: one has the name of a column.
    """
    names = [name for name in dict.fromkeys(listed(options.others)) if name != "none"]
    for name in names:
        if name in (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR):
            raise InputError(f"--others: '{name}' is a column of the figure already; give another driver's name.")
    return names


def _run(options: ExperimentConfig, folder: Path, console: Console | None) -> None:
    policies = (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR, *others(options))
    places = {
        behavior: list(streams(CollectConfig(**_description(options, behavior))).values()) for behavior in BEHAVIORS
    }
    parts.start(options)  # after all checks, so that wrong options leave no files
    outcomes = together(_parts(options, folder, places), console, "figure 4")
    measured = {
        policy: {behavior: outcomes[_part_name(policy, behavior)][policy] for behavior in BEHAVIORS}
        for policy in policies
    }
    training = {policy: _mean(outcomes[f"training {policy}"]) for policy in (*LEARNED, BALANCED)}
    write(options, folder, _results(options, policies, measured, training))


def _part_name(policy: str, behavior: str) -> str:
    """The name of the part that simulates the policy. Learned policies have one part, since they share programs."""
    return f"{'learned' if policy in LEARNED or policy == BALANCED else policy} in {behavior}"


def _parts(options: ExperimentConfig, folder: Path, places: dict[str, list[Scenario]]) -> list[Part]:
    """The parts of the experiment, in an order in which they could run one by one."""
    learned = (*LEARNED, BALANCED)
    datasets = [(behavior, dataset) for behavior in reversed(BEHAVIORS) for dataset in range(options.datasets or 1)]
    data = {pair: f"demonstrations in {pair[0]}, {pair[1]}" for pair in datasets}  # graph first: two policies need it
    jobs: list[Part] = []
    for pair in datasets:
        jobs.append(Part(data[pair], functools.partial(_collect, options, folder, *pair)))
    for policy in (DEMONSTRATOR, NAVIGATION, *others(options)):
        for behavior in BEHAVIORS:
            work = functools.partial(_drive, options, folder, (policy,), behavior, places[behavior])
            jobs.append(Part(_part_name(policy, behavior), work))
    before: tuple[str, ...] = ()
    for policy in learned:  # one after the other: orbax mixes up what several threads save
        behavior = LEARNED.get(policy, "graph")
        needed = (name for (origin, _), name in data.items() if origin == behavior)
        work = functools.partial(_train, options, folder, policy)
        jobs.append(Part(f"training {policy}", work, (*needed, *before)))
        before = (jobs[-1].name,)
    for behavior in BEHAVIORS:
        work = functools.partial(_drive, options, folder, learned, behavior, places[behavior])
        jobs.append(Part(_part_name("G", behavior), work, before))  # the last of the trainings
    return jobs


def _networks(options: ExperimentConfig) -> list[tuple[int, int]]:
    """(dataset, seed) of each network of a learned policy."""
    return [(dataset, seed) for dataset in range(options.datasets or 1) for seed in range(options.trainings or 1)]


def _sizes(options: ExperimentConfig) -> tuple[int, int, int]:
    """Datasets, trainings on each, and episodes of each network, enough to make what was asked for."""
    datasets, trainings = options.datasets or 1, options.trainings or 1
    return datasets, trainings, math.ceil((options.episodes or 1) / (datasets * trainings))


def _mean(summaries: list[Training]) -> Training:
    return cast(Training, {name: float(np.mean([each[name] for each in summaries])) for name in summaries[0]})


def _description(options: ExperimentConfig, behavior: str) -> dict[str, Any]:
    return {"preset": options.preset, **table1.fields(options, behavior, options.people)}


def _collect_config(options: ExperimentConfig, folder: Path, behavior: str, dataset: int) -> CollectConfig:
    image: dict[str, Any] = dict(width=32, height=24) if options.quick else {}
    return CollectConfig(
        **_description(options, behavior), policy=Named(kind=options.demonstrator), hours=options.hours or 1.0,
        seed=options.seed + dataset, out=folder / f"demonstrations-{behavior}-{dataset}", **image,
    )  # fmt: skip


def _network_name(policy: str, network: tuple[int, int]) -> str:
    return f"{'graph-balanced' if policy == BALANCED else LEARNED[policy]}-{network[0]}-{network[1]}"


def _collect(
    options: ExperimentConfig, folder: Path, behavior: str, dataset: int, watch: Callable[[float], None]
) -> None:
    """Collect demonstrations in a folder of their own, or continue it, if a network still needs them."""
    learners = [policy for policy in (*LEARNED, BALANCED) if LEARNED.get(policy, "graph") == behavior]
    names = [_network_name(policy, (dataset, seed)) for policy in learners for seed in range(options.trainings or 1)]
    if any(parts.load(folder / f"trained-{name}.json") is None for name in names):
        learning.collect(_collect_config(options, folder, behavior, dataset), watch)


def _train(options: ExperimentConfig, folder: Path, policy: str, watch: Callable[[float], None]) -> list[Training]:
    """Train the networks of a policy that are missing, side by side, each in a folder of its own."""
    files = {network: folder / f"trained-{_network_name(policy, network)}.json" for network in _networks(options)}
    missing = [network for network, file in files.items() if parts.load(file) is None]
    if missing:
        asked = [_train_config(options, folder, policy, network) for network in missing]
        began = time.perf_counter()
        states = learning.ensemble.train(asked, watch)
        seconds = (time.perf_counter() - began) / len(missing)
        for network, own, state in zip(missing, asked, states, strict=True):
            parts.save(files[network], _summary(own, state) | {"seconds": seconds})
    return [cast(Training, parts.load(file)) for file in files.values()]


def _train_config(options: ExperimentConfig, folder: Path, policy: str, network: tuple[int, int]) -> TrainConfig:
    dataset, seed = network
    return TrainConfig(
        method="imitation", epochs=options.epochs or 1000, seed=options.seed + seed,
        dataset=_collect_config(options, folder, LEARNED.get(policy, "graph"), dataset).folder,
        batch=256 if options.quick else 1024, balance=policy == BALANCED,
        out=folder / f"policy-{_network_name(policy, network)}",
    )  # fmt: skip


def _summary(trained: TrainConfig, state: TrainState) -> dict[str, Any]:
    data = learning.open_dataset(trained.dataset)
    flags = data.read(data.episodes, ("situations",))["situations"]
    odds = balanced_probabilities(flags) if trained.balance else np.full(len(flags), 1 / len(flags))
    shared = odds @ (flags / np.maximum(flags.sum(1, keepdims=True), 1))
    return {
        "examples": int(data.example_count),
        "entropy": float(shares.normalised_entropy(shared)),
        "epochs": int(state.epoch),
        "best_epoch": int(state.best_epoch),
        "loss": float(state.best),
    }


def _policy(
    options: ExperimentConfig, folder: Path, policy: str, networks: Sequence[tuple[int, int]], scenario: Scenario
) -> Policy:
    """A driver; of a learned policy its networks, with a leading axis."""
    import jax
    import jax.numpy as jnp

    if networks:
        with LOADING:
            several = [learning.load(folder / f"policy-{_network_name(policy, each)}", scenario) for each in networks]
        # All have one name, since a policy of another name would be compiled again.
        several = [dataclasses.replace(each, name="learned") for each in several]
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *several)
    names = {NAVIGATION: "social_costmap", DEMONSTRATOR: options.demonstrator}
    return choice.policy(names.get(policy, policy), scenario)


def _drive(
    options: ExperimentConfig,
    folder: Path,
    policies: tuple[str, ...],
    behavior: str,
    kinds: list[Scenario],
    watch: Callable[[float], None],
) -> dict[str, Columns]:
    """policy -> measures of each episode, from the file in the folder or simulated.

    Policies that differ only in their parameters share compiled programs.
    """
    import jax

    kinds = [dataclasses.replace(kind, metrics=_metrics()) for kind in kinds]
    *_, each = _sizes(options)
    networks = _networks(options)
    max_size = BATCH.get(jax.default_backend(), BATCH_ELSEWHERE)
    runner = None
    by_policy: dict[str, Columns] = {}
    for turn, policy in enumerate(policies):
        file = folder / f"episodes-{_file_name(policy)}-{behavior}.json"
        if parts.load(file) is None:
            learned = policy in LEARNED or policy == BALANCED  # others are the same driver in all episodes
            shared = _together(len(networks), each, max_size) if learned else None  # networks that drive at once
            number = each * (shared or len(networks))
            turns = [networks[first : first + shared] for first in range(0, len(networks), shared)] if shared else [()]
            measured = []
            for index, several in enumerate(turns):
                tell = functools.partial(_tell, watch, turn * len(turns) + index, len(policies) * len(turns))
                now = _policy(options, folder, policy, several, kinds[0])
                if runner is None:
                    size = number if shared and shared > 1 else _even(number, max_size)
                    runner = Runner(kinds, now, size, "figure4", drivers=shared)
                runner.policy = now  # of the same structure, so nothing is compiled again
                measured.append(_measure(runner, options.seed, index * number, number, tell))
            columns = {
                name: np.concatenate([np.asarray(one[name], float) for one in measured]) for name in METRIC_NAMES
            }
            if not all(np.isfinite(columns[name]).all() for name in ("completed", "seconds", *INTIMATE)):
                raise FloatingPointError(f"{policy} in {behavior}: a metric is not finite; nothing of it is written.")
            parts.save(file, {name: np.nan_to_num(values).tolist() for name, values in columns.items()})
        by_policy[policy] = parts.load(file)
    return by_policy


def _file_name(policy: str) -> str:
    """A folder or FILE.py:NAME as a part of a file's name."""
    return policy.strip("./").replace("/", "-").replace("\\", "-").replace(":", "-")


def _together(networks: int, each: int, max_size: int) -> int:
    """How many networks drive at once: as many as a batch has room for, and as share it evenly."""
    import jax

    fitting = (n for n in range(2, networks + 1) if networks % n == 0 and n * each <= max_size)
    return max((n for n in fitting if n * each % jax.device_count() == 0), default=1)


def _even(number: int, max_size: int) -> int:
    """The size of equal batches that together have ``number`` episodes or a few more."""
    return math.ceil(number / math.ceil(number / max_size))


def _measure(
    runner: Runner, seed: int, begin: int, number: int, tell: Callable[[float], None]
) -> dict[str, np.ndarray]:
    """Metrics (E, ...) of ``number`` episodes from ``begin`` on, each run to its end."""
    import jax

    end, limit = begin + number, runner.scenarios[0].time_limit
    batches, starts = [], range(begin, end, runner.size)
    compute = jax.jit(jax.vmap(results, (None, 0)))
    for index, first in enumerate(starts):
        watch = Watch(advanced=lambda seconds, _, index=index: tell((index + seconds / limit) / len(starts)))
        batch = runner.run(seed, first, min(runner.size, end - first), watch=watch)
        seconds = batch.steps * runner.scenarios[0].time_step
        figures = compute(runner.scenarios[0], batch.states)
        batches.append({"completed": np.asarray(batch.states.completed), "seconds": seconds, **figures})
    return jax.tree.map(lambda *each: np.concatenate([np.asarray(one) for one in each]), *batches)


def _tell(watch: Callable[[float], None], turn: int, turns: int, share: float) -> None:
    watch((turn + share) / turns)


def _metrics() -> tuple:
    from sean_jax.metrics import METRICS

    return tuple((name, METRICS[name]) for name in METRIC_NAMES if name in METRICS)


def _results(
    options: ExperimentConfig,
    policies: tuple[str, ...],
    measured: dict[str, dict[str, Columns]],
    training: dict[str, Training],
) -> Results:
    values: dict = {policy: {} for policy in policies}
    situations: dict = {policy: {} for policy in policies}
    for policy in policies:
        for behavior in BEHAVIORS:
            columns = {name: np.asarray(value, float) for name, value in measured[policy][behavior].items()}
            violations = columns[INTIMATE[0]] + columns[INTIMATE[1]]
            collisions = columns["collision_robot_on_person"] + columns["collision_person_on_robot"]
            waiting = columns["time_not_moving"]
            values[policy][behavior] = {
                "completed": columns["completed"],
                "time_not_moving": waiting[:, 0] if waiting.ndim == 2 else waiting,
                "violations": violations[:, 0],
                "collisions": collisions[:, 0] if collisions.ndim == 2 else collisions,
            }
            situations[policy][behavior] = violations[:, 1:]
    results = Results(policies, _sizes(options), values, situations, training)
    results.claims = claims(results)
    return results


def _by_situation(policy: str, behavior: str, cells: Estimate) -> list[str]:
    return [
        f"{policy},{behavior},violations_{situation},{cells.mean[k]:.5f},{cells.low[k]:.5f},{cells.high[k]:.5f}"
        for k, situation in enumerate(shares.NAMES)
    ]


def write(options: ExperimentConfig, folder: Path, results: Results) -> None:
    """Write figure4.csv, claims.csv, the figure and report.html.

    Args:
        options: of the experiment.
        folder: to be written.
        results: measures of all policies.

    Raises:
        WriteError: another process writes one of the files.
    """
    lines = ["policy,behavior,measure,mean,low,high"]
    for policy, by_behavior in results.cells.items():
        for behavior, measured in by_behavior.items():
            for name, cell in measured.items():
                lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
            lines += _by_situation(policy, behavior, results.by_situation[policy][behavior])
    apart = [(policy, "mean", measured) for policy, measured in results.means.items()]
    apart += [(f"{BALANCED}-G", behavior, measured) for behavior, measured in results.more.items()]
    apart += [("".join(FOUR), behavior, {"violations": cell}) for behavior, cell in results.harm.items()]
    for policy, behavior, measured in apart:
        for name, cell in measured.items():
            lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
    for policy, by_behavior in results.waiting.items():
        for behavior, cell in by_behavior.items():
            if cell.episodes:
                interval = f"{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}"
                lines.append(f"{policy},{behavior},time_not_moving_of_completed,{interval}")
    for behavior, less in results.balancing.items():
        lines += _by_situation(f"{BALANCED}-G", behavior, less)
    parts.save(folder / "figure4.csv", "\n".join(lines) + "\n")
    claim_lines = ["statement,paper,ours,holds,share_of_resamples"]
    for row in results.claims:
        claim_lines.append(f'"{row["statement"]}","{row["paper"]}","{row["ours"]}",{row["holds"]},{row["share"]:.4f}')
    parts.save(folder / "claims.csv", "\n".join(claim_lines) + "\n")
    grids = pictures.grids(results)
    pictures.save(folder, {"figure4-grids": grids})
    parts.save(folder / "report.html", page.figure4(options, results, grids))
