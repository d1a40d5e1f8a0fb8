"""Figure 4: policies that learned among people of three behaviors, and the navigation stack, in three scenarios.

Demonstrations are collected and a network is trained for each behavior (G, R, H), and each policy, the navigation stack
with social cost layers (N) and the demonstrator itself (E) drive the same numbered episodes (section V-C).
"""

from __future__ import annotations

import dataclasses
import functools
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sean_jax import learning, writing
from sean_jax.experiments import page, parts, pictures, rollouts, shares
from sean_jax.experiments.claims import BALANCED, DEMONSTRATOR, FOUR, LEARNED, NAVIGATION, Found, claims
from sean_jax.experiments.options import BEHAVIORS, Experiment
from sean_jax.experiments.together import Part, together
from sean_jax.learning import balance, protocol
from sean_jax.learning.options import Collect, Train
from sean_jax.learning.protocol import streams, who_drives

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Policy, Scenario
    from sean_jax.metrics import Estimate

BATCH = {"cpu": 32}  # episodes at once, by kind of device
BATCH_ELSEWHERE = 4096
LOADING = threading.Lock()
INTIMATE = "intimate_robot_on_person", "intimate_person_on_robot"
KEPT = "completed", "seconds", "time_not_moving", *INTIMATE, "collision_robot_on_person", "collision_person_on_robot"


def run(options: Experiment, console: Console | None = None) -> Path:
    """Collect, train and drive what is missing, and write the report; the folder.

    Raises Refused for what cannot be asked for, Unwritable if somebody else writes in the folder, Failed for damaged
    files, FloatingPointError for numbers that are not finite; what was finished before stays.
    """
    options = options.settled()
    for behavior in BEHAVIORS:
        protocol.check(_collecting(options, options.folder, behavior))
    folder = options.folder
    parts.begun(options)
    with writing.held(folder):
        _run(options, folder, console)
    return folder


def _run(options: Experiment, folder: Path, console: Console | None) -> None:
    policies = (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR)
    places = {behavior: streams(Collect(**_asked(options, behavior))) for behavior in BEHAVIORS}
    parts.begin(options)  # now that nothing is refused any more
    found = together(_parts(options, folder, places), console, "figure 4")
    measured = {
        policy: {behavior: found[_driven(policy, behavior)][policy] for behavior in BEHAVIORS} for policy in policies
    }
    trained = {name: found[f"training {name}"] for name in (*LEARNED, BALANCED)}
    write(options, folder, _found(options, policies, measured, trained))


def _driven(policy: str, behavior: str) -> str:
    """The name of the part in which that policy drives; learned ones take turns, for they share programs."""
    return f"{policy if policy in (NAVIGATION, DEMONSTRATOR) else 'learned'} in {behavior}"


def _parts(options: Experiment, folder: Path, places: dict[str, tuple]) -> list[Part]:
    """What there is to do, in an order in which it can be done one by one."""
    learned = (*LEARNED, BALANCED)
    data = {behavior: f"demonstrations in {behavior}" for behavior in BEHAVIORS}
    made: list[Part] = []
    for behavior in reversed(BEHAVIORS):  # the graph is needed by two
        made.append(Part(data[behavior], functools.partial(_collect, options, folder, behavior)))
    for policy in (DEMONSTRATOR, NAVIGATION):
        for behavior in BEHAVIORS:
            work = functools.partial(_drive, options, folder, (policy,), behavior, places[behavior])
            made.append(Part(_driven(policy, behavior), work))
    before: tuple[str, ...] = ()
    for policy in learned:  # one after the other: orbax mixes up what several threads save
        work = functools.partial(_train, options, folder, policy)
        made.append(Part(f"training {policy}", work, (data[LEARNED.get(policy, "graph")], *before)))
        before = (made[-1].name,)
    for behavior in BEHAVIORS:
        work = functools.partial(_drive, options, folder, learned, behavior, places[behavior])
        made.append(Part(_driven("G", behavior), work, tuple(f"training {policy}" for policy in learned)))
    return made


def _asked(options: Experiment, behavior: str) -> dict[str, Any]:
    return dict[str, Any](
        behavior=behavior, environment=options.environment, robot=options.robot, dynamics=options.dynamics,
        people=None if behavior == "handcrafted" else options.people, time_limit=options.time_limit,
    )  # fmt: skip


def _collecting(options: Experiment, folder: Path, behavior: str) -> Collect:
    image: dict[str, Any] = dict(width=32, height=24) if options.quick else {}
    return Collect(
        **_asked(options, behavior), driver=options.driver, hours=options.hours or 1.0, seed=options.seed,
        out=folder / f"demonstrations-{behavior}", **image,
    )  # fmt: skip


def _trained(policy: str) -> str:
    return "graph-balanced" if policy == BALANCED else LEARNED[policy]


def _collect(options: Experiment, folder: Path, behavior: str, watch: Callable) -> None:
    """Demonstrations in a folder of their own, which goes on by itself, if a network has yet to learn from them."""
    learners = [_trained(policy) for policy in (*LEARNED, BALANCED) if LEARNED.get(policy, "graph") == behavior]
    if any(parts.saved(folder / f"trained-{name}.json") is None for name in learners):
        learning.collect(_collecting(options, folder, behavior), watch)


def _train(options: Experiment, folder: Path, policy: str, watch: Callable) -> dict[str, Any]:
    """A network in a folder of its own, which goes on by itself."""
    name, balanced = _trained(policy), policy == BALANCED
    done = folder / f"trained-{name}.json"
    if (told := parts.saved(done)) is not None:
        return told
    collected = _collecting(options, folder, LEARNED.get(policy, "graph")).folder
    train = Train(
        method="imitation", dataset=collected, epochs=options.epochs or 1000, seed=options.seed,
        batch=256 if options.quick else 1024, balance=balanced, out=folder / f"policy-{name}",
    )  # fmt: skip
    began = time.perf_counter()
    state = learning.train(train, watch)
    data = learning.open_dataset(collected)
    flags = data.read(data.episodes, ("situations",))["situations"]
    odds = balance.odds(flags) if balanced else np.full(len(flags), 1 / len(flags))
    shared = odds @ (flags / np.maximum(flags.sum(1, keepdims=True), 1))
    told = {
        "examples": int(data.examples),
        "entropy": float(shares.normalised_entropy(shared)),
        "epochs": int(state.epoch),
        "best_epoch": int(state.best_epoch),
        "loss": float(state.best),
        "seconds": time.perf_counter() - began,
    }
    parts.save(done, told)
    return told


def _policy(options: Experiment, folder: Path, policy: str, scenario: Scenario) -> Policy:
    if policy in LEARNED or policy == BALANCED:
        with LOADING:  # Of one name, for a driver of another name is compiled anew.
            return dataclasses.replace(learning.load(folder / f"policy-{_trained(policy)}", scenario), name="learned")
    return who_drives("social_costmap" if policy == NAVIGATION else options.driver)


def _drive(
    options: Experiment, folder: Path, policies: tuple[str, ...], behavior: str, place: tuple, watch: Callable
) -> dict[str, dict[str, Any]]:
    """policy -> the measures of each episode as lists, as saved in the folder or driven.

    The policies, which differ in what they learned, share what is compiled.
    """
    import jax

    kinds, tasks = place
    metrics = _metrics()
    kinds = [dataclasses.replace(k, scenario=dataclasses.replace(k.scenario, metrics=metrics)) for k in kinds]
    programs, number = rollouts.Numbered(tasks), options.episodes or 1
    most = BATCH.get(jax.default_backend(), BATCH_ELSEWHERE)
    found = {}
    for turn, policy in enumerate(policies):
        file = folder / f"episodes-{policy}-{behavior}.json"
        if parts.saved(file) is None:
            tell = functools.partial(_tell, watch, turn, len(policies))
            driver = _policy(options, folder, policy, kinds[0].scenario)
            ended = programs.episodes(driver, kinds, options.seed, number, most, tell)
            measured = {"completed": ended.completed, "seconds": ended.seconds, **ended.metrics}
            if not all(np.isfinite(measured[name]).all() for name in ("completed", "seconds", *INTIMATE)):
                raise FloatingPointError(f"{policy} in {behavior}: a metric is not finite; nothing of it is written.")
            told = {name: np.nan_to_num(np.asarray(measured[name], float)).tolist() for name in KEPT}
            parts.save(file, told)
        found[policy] = parts.saved(file)
    return found


def _tell(watch: Callable, turn: int, turns: int, share: float) -> None:
    watch((turn + share) / turns)


def _metrics() -> tuple:
    from sean_jax.metrics import METRICS

    return tuple((name, METRICS[name]) for name in KEPT if name in METRICS)


def _found(options: Experiment, policies: tuple, measured: dict, trained: dict) -> Found:
    values: dict = {policy: {} for policy in policies}
    situations: dict = {policy: {} for policy in policies}
    for policy in policies:
        for behavior in BEHAVIORS:
            told = {name: np.asarray(value, float) for name, value in measured[policy][behavior].items()}
            violations = told[INTIMATE[0]] + told[INTIMATE[1]]
            collisions = told["collision_robot_on_person"] + told["collision_person_on_robot"]
            waiting = told["time_not_moving"]
            values[policy][behavior] = {
                "completed": told["completed"],
                "time_not_moving": waiting[:, 0] if waiting.ndim == 2 else waiting,
                "violations": violations[:, 0],
                "collisions": collisions[:, 0] if collisions.ndim == 2 else collisions,
            }
            situations[policy][behavior] = violations[:, 1:]
    found = Found(policies, options.episodes or 1, values, situations, trained)
    found.claims = claims(found)
    return found


def _by_situation(policy: str, behavior: str, cells: Estimate) -> list[str]:
    return [
        f"{policy},{behavior},violations_{situation},{cells.mean[k]:.5f},{cells.low[k]:.5f},{cells.high[k]:.5f}"
        for k, situation in enumerate(shares.NAMES)
    ]


def write(options: Experiment, folder: Path, found: Found) -> None:
    """figure4.csv, claims.csv, the figure and report.html."""
    lines = ["policy,behavior,measure,mean,low,high"]
    for policy, by_behavior in found.cells.items():
        for behavior, measured in by_behavior.items():
            for name, cell in measured.items():
                lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
            lines += _by_situation(policy, behavior, found.by_situation[policy][behavior])
    apart = [(policy, "mean", measured) for policy, measured in found.means.items()]
    apart += [(f"{BALANCED}-G", behavior, measured) for behavior, measured in found.more.items()]
    apart += [("".join(FOUR), behavior, {"violations": cell}) for behavior, cell in found.harm.items()]
    for policy, behavior, measured in apart:
        for name, cell in measured.items():
            lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
    for policy, by_behavior in found.waiting.items():
        for behavior, cell in by_behavior.items():
            if cell.episodes:
                told = f"{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}"
                lines.append(f"{policy},{behavior},time_not_moving_of_completed,{told}")
    for behavior, less in found.balancing.items():
        lines += _by_situation(f"{BALANCED}-G", behavior, less)
    parts.save(folder / "figure4.csv", "\n".join(lines) + "\n")
    held = ["statement,paper,ours,holds,share_of_resamples"]
    for row in found.claims:
        held.append(f'"{row["statement"]}","{row["paper"]}","{row["ours"]}",{row["holds"]},{row["share"]:.4f}')
    parts.save(folder / "claims.csv", "\n".join(held) + "\n")
    grids = pictures.grids(found)
    pictures.save(folder, {"figure4-grids": grids})
    parts.save(folder / "report.html", page.figure4(options, found, grids))
