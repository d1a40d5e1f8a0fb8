"""Figure 4: policies that learned among people of three behaviors, and the navigation stack, in three scenarios.

Demonstrations are collected and a network is trained for each behavior (G, R, H), and each policy, the navigation stack
with social cost layers (N) and the demonstrator itself (E) drive the same numbered episodes (section V-C).
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sean_jax import learning
from sean_jax.experiments import page, parts, rollouts, shares
from sean_jax.experiments.options import BEHAVIORS, Experiment
from sean_jax.learning import balance
from sean_jax.learning.options import Collect, Train
from sean_jax.learning.progress import shown
from sean_jax.learning.protocol import Stream, streams, who_drives
from sean_jax.metrics import Estimate, aggregate, resamples

if TYPE_CHECKING:
    from rich.console import Console

    from sean_jax.base import Policy, Scenario

LEARNED = {"G": "graph", "R": "random", "H": "handcrafted"}
BALANCED, NAVIGATION, DEMONSTRATOR = "B", "N", "E"
BATCH = {"cpu": 32}  # episodes at once, by kind of device
BATCH_ELSEWHERE = 4096
INTIMATE = "intimate_robot_on_person", "intimate_person_on_robot"
KEPT = "completed", "seconds", "time_not_moving", *INTIMATE, "collision_robot_on_person", "collision_person_on_robot"


@dataclasses.dataclass
class Found:
    """What the page tells."""

    MEASURES: ClassVar[dict[str, str]] = {
        "completed": "completed tasks",
        "time_not_moving": "time not moving, s",
        "violations": "intimate distance violations",
        "collisions": "collisions with people",
    }
    policies: tuple[str, ...]
    episodes: int
    values: dict[str, dict[str, dict[str, np.ndarray]]]  # policy -> behavior -> measure -> (E,)
    situations: dict[str, dict[str, np.ndarray]]  # policy -> behavior -> (E, 5) violations in each situation
    trained: dict[str, dict[str, Any]]
    claims: list[dict[str, Any]] = dataclasses.field(default_factory=list)

    @property
    def by_situation(self) -> dict[str, dict[str, np.ndarray]]:
        """policy -> behavior -> (5,) violations per episode."""
        return {p: {b: each.mean(0) for b, each in by.items()} for p, by in self.situations.items()}

    @property
    def cells(self) -> dict[str, dict[str, dict[str, Estimate]]]:
        """policy -> behavior -> measure -> mean with interval; of completed tasks the number."""
        return {
            policy: {
                behavior: {
                    name: _scaled(aggregate(values), self.episodes if name == "completed" else 1)
                    for name, values in measured.items()
                }
                for behavior, measured in by_behavior.items()
            }
            for policy, by_behavior in self.values.items()
        }


def run(options: Experiment, console: Console | None = None) -> Path:
    """Collect, train and drive what is missing, and write the report; the folder.

    Raises Refused for what cannot be asked for, Failed for damaged files, FloatingPointError for numbers that are not
    finite; what was finished before stays.
    """
    options = options.settled()
    who_drives(options.driver)
    folder = parts.begin(options)
    trained = {name: _train(options, folder, behavior, console) for name, behavior in LEARNED.items()}
    trained[BALANCED] = _train(options, folder, "graph", console, balanced=True)
    policies = (*LEARNED, BALANCED, NAVIGATION, DEMONSTRATOR)
    measured: dict[str, dict[str, dict[str, Any]]] = {policy: {} for policy in policies}
    with shown(console, "driving", len(policies) * len(BEHAVIORS)) as tell:
        for row, behavior in enumerate(BEHAVIORS):
            kinds, tasks = streams(Collect(**_asked(options, behavior)))
            programs = rollouts.Numbered(tasks)
            for column, policy in enumerate(policies):
                done, what = len(policies) * row + column, f"{policy} in {behavior}"

                def watch(share: float, done: int = done, what: str = what) -> None:
                    tell(done + share, what)

                watch(0.0)
                measured[policy][behavior] = _drive(options, folder, policy, behavior, kinds, programs, watch)
    found = _found(options, policies, measured, trained)
    write(options, folder, found)
    return folder


def _asked(options: Experiment, behavior: str) -> dict[str, Any]:
    return dict[str, Any](
        behavior=behavior, environment=options.environment, robot=options.robot, dynamics=options.dynamics,
        people=None if behavior == "handcrafted" else options.people, time_limit=options.time_limit,
    )  # fmt: skip


def _train(
    options: Experiment, folder: Path, behavior: str, console: Console | None, balanced: bool = False
) -> dict[str, Any]:
    """Demonstrations and a network of that behavior, in folders of their own, which go on by themselves."""
    name = f"{behavior}-balanced" if balanced else behavior
    done = folder / f"trained-{name}.json"
    if (told := parts.saved(done)) is not None:
        return told
    image: dict[str, Any] = dict(width=32, height=24) if options.quick else {}
    collect = Collect(
        **_asked(options, behavior), driver=options.driver, hours=options.hours or 1.0, seed=options.seed,
        out=folder / f"demonstrations-{behavior}", **image,
    )  # fmt: skip
    data = learning.collect(collect, console)
    batch = 256 if options.quick else 1024
    train = Train(
        method="imitation", dataset=collect.folder, epochs=options.epochs or 1000, seed=options.seed, batch=batch,
        balance=balanced, out=folder / f"policy-{name}",
    )  # fmt: skip
    began = time.perf_counter()
    state = learning.train(train, console)
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
        made = "graph-balanced" if policy == BALANCED else LEARNED[policy]
        # Of one name, for a driver of another name is compiled anew.
        return dataclasses.replace(learning.load(folder / f"policy-{made}", scenario), name="learned")
    return who_drives("social_costmap" if policy == NAVIGATION else options.driver)


def _drive(
    options: Experiment,
    folder: Path,
    policy: str,
    behavior: str,
    kinds: list[Stream],
    programs: rollouts.Numbered,
    watch: Callable,
) -> dict[str, Any]:
    """The measures of each episode as lists, as saved in the folder or driven; streams take turns.

    The learned policies share what ``programs`` compile.
    """
    import jax

    file = folder / f"episodes-{policy}-{behavior}.json"
    if (told := parts.saved(file)) is not None:
        return told
    metrics = _metrics()
    scenario = dataclasses.replace(kinds[0].scenario, metrics=metrics)
    driver = _policy(options, folder, policy, scenario)
    number = options.episodes or 1
    each = math.ceil(number / len(kinds))
    batch = min(each, BATCH.get(jax.default_backend(), BATCH_ELSEWHERE))
    found: list[list[rollouts.Episodes]] = []
    total = math.ceil(each / batch) * len(kinds) * options.time_limit
    for turn, kind in enumerate(kinds):
        scenario, parts_of = dataclasses.replace(kind.scenario, metrics=metrics), []
        for first in range(0, each, batch):
            before = (turn * math.ceil(each / batch) + first // batch) * options.time_limit
            numbers = np.arange(first, first + batch) * len(kinds) + turn
            tell = lambda seconds, before=before: watch(min(1.0, (before + seconds) / total))  # noqa: E731
            parts_of.append(programs.episodes(driver, scenario, options.seed + 1, kind.turn, numbers, tell))
        found.append(parts_of)
    told = {name: _in_turns(found, name, each, number) for name in KEPT}
    if not all(np.isfinite(np.asarray(told[name])).all() for name in ("completed", "seconds", *INTIMATE)):
        raise FloatingPointError(f"{policy} in {behavior}: a metric is not finite; nothing of it is written.")
    parts.save(file, {name: np.nan_to_num(np.asarray(values, float)).tolist() for name, values in told.items()})
    return parts.saved(file)


def _metrics() -> tuple:
    from sean_jax.metrics import METRICS

    return tuple((name, METRICS[name]) for name in KEPT if name in METRICS)


def _in_turns(found: list[list[rollouts.Episodes]], name: str, each: int, number: int) -> np.ndarray:
    """(number, ...) the values of all episodes in the order of their numbers."""
    columns = []
    for batches in found:
        values = [getattr(b, name) if name in ("completed", "seconds") else b.metrics[name] for b in batches]
        columns.append(np.concatenate(values)[:each])
    return np.stack(columns, 1).reshape(-1, *columns[0].shape[1:])[:number]


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


def claims(found: Found) -> list[dict[str, Any]]:
    """What the paper says of its figure: statement, its numbers, ours, whether it holds and in how many resamples."""
    weights = resamples(found.episodes, seed=0)
    weights = np.concatenate([np.full((1, found.episodes), 1.0), weights])
    weights = weights / weights.sum(1, keepdims=True)

    def of(policy: str, behavior: str, name: str) -> np.ndarray:
        return weights @ found.values[policy][behavior][name]

    wait = {p: np.mean([of(p, b, "time_not_moving") for b in BEHAVIORS], 0) for p in found.policies}
    harm = {b: np.mean([of(p, b, "violations") for p in (*LEARNED, NAVIGATION)], 0) for b in BEHAVIORS}
    done = {p: found.episodes * np.mean([of(p, b, "completed") for b in BEHAVIORS], 0) for p in found.policies}
    paths = np.mean([weights @ found.situations[p]["graph"][:, :2].sum(1) for p in (*LEARNED, NAVIGATION)], 0)
    paths = paths / np.maximum(harm["graph"], 1e-9)
    worst = int(found.by_situation["G"]["graph"].argmax())
    worse, mended = (weights @ found.situations[p]["graph"][:, worst] for p in ("G", BALANCED))
    less = 1 - of("G", "graph", "time_not_moving") / np.maximum(of("H", "graph", "time_not_moving"), 1e-9)
    told: list[tuple] = [
        ("N stands longest, s", "28.7 against 11 to 22", _listed(wait),
         wait["N"] > np.max([wait[p] for p in LEARNED], 0)),
        ("G stands less than R, s", "11 < 16.3", f"{wait['G'][0]:.1f}, {wait['R'][0]:.1f}", wait["G"] < wait["R"]),
        ("R stands less than H, s", "16.3 < 22", f"{wait['R'][0]:.1f}, {wait['H'][0]:.1f}", wait["R"] < wait["H"]),
        ("in graph, G stands less than H by half", "-55 %", f"{-100 * less[0]:.0f} %", less >= 0.5),
        ("violations: graph at least random", "2.5, 1.9", f"{harm['graph'][0]:.2f}, {harm['random'][0]:.2f}",
         harm["graph"] >= harm["random"]),
        ("violations: random above handcrafted", "1.9, 1.0", f"{harm['random'][0]:.2f}, {harm['handcrafted'][0]:.2f}",
         harm["random"] > harm["handcrafted"]),
        ("violations in graph are mostly in cross or down path", "mainly", f"{100 * paths[0]:.0f} %", paths > 0.5),
        ("G and H complete equally many, within 5 %", "112.7, 112.7", f"{done['G'][0]:.1f}, {done['H'][0]:.1f}",
         np.abs(done["G"] - done["H"]) <= 0.05 * found.episodes),
        ("the learned complete 80 % of what the demonstrator does", "not reported", _listed(done),
         np.min([done[p] for p in LEARNED], 0) >= 0.8 * done[DEMONSTRATOR]),
        ("balanced examples lower the violations in G's worst situation", "suggested",
         f"{shares.NAMES[worst].replace('_', ' ')}: {worse[0]:.2f} to {mended[0]:.2f}", mended < worse),
    ]  # fmt: skip
    return [
        {"statement": words, "paper": paper, "ours": ours, "holds": bool(held[0]), "share": float(held[1:].mean())}
        for words, paper, ours, held in told
    ]


def _listed(values: dict[str, np.ndarray]) -> str:
    return ", ".join(f"{name} {each[0]:.1f}" for name, each in values.items())


def _scaled(estimate: Estimate, by: float) -> Estimate:
    return estimate._replace(mean=estimate.mean * by, low=estimate.low * by, high=estimate.high * by)


def write(options: Experiment, folder: Path, found: Found) -> None:
    """figure4.csv, claims.csv and report.html."""
    lines = ["policy,behavior,measure,mean,low,high"]
    for policy, by_behavior in found.cells.items():
        for behavior, measured in by_behavior.items():
            for name, cell in measured.items():
                lines.append(f"{policy},{behavior},{name},{cell.mean:.5f},{cell.low:.5f},{cell.high:.5f}")
            for k, situation in enumerate(shares.NAMES):
                value = found.by_situation[policy][behavior][k]
                lines.append(f"{policy},{behavior},violations_{situation},{value:.5f},,")
    parts.save(folder / "figure4.csv", "\n".join(lines) + "\n")
    held = ["statement,paper,ours,holds,share_of_resamples"]
    for row in found.claims:
        held.append(f'"{row["statement"]}","{row["paper"]}","{row["ours"]}",{row["holds"]},{row["share"]:.4f}')
    parts.save(folder / "claims.csv", "\n".join(held) + "\n")
    parts.save(folder / "report.html", page.figure4(options, found))
