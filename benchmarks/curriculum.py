"""The worst situation of an agent, with the most violations of people's space, before and after more training.

The agent of a folder drives in new episodes, and its worst situation has the most violations per minute.
Its training continues twice, for as many steps: with and without a curriculum. All three are measured in other
episodes, the same for all, with 95 % bootstrap intervals. A violation is a person within 0.45 m, by anyone's fault.
Intervals cover the variation between episodes, not between trainings (``--seeds``).

python benchmarks/curriculum.py runs/ppo --steps 3000000 --scenarios 256 --seeds 4 --out runs/mended
python benchmarks/curriculum.py ppo --steps 2e7 --scenarios 4096 --episodes 2048 --seeds 3 --out runs/long

The second command uses an agent of the package, on a GPU. The same command resumes an interrupted run.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parser
from rich.console import Console

import sean_jax
from sean_jax import mdp
from sean_jax.core import random_streams
from sean_jax.core.errors import SeanError
from sean_jax.learning import reinforcement
from sean_jax.learning.policy import AGENTS, agent_policy, load_agent, read_options
from sean_jax.metrics import bootstrap

VIOLATIONS = ("intimate_robot_on_person", "intimate_person_on_robot")
FEWEST = 30  # minimum number of episodes with a situation, for the worst situation
AT_ONCE = {"cpu": 256}  # episodes, by kind of device
AT_ONCE_ELSEWHERE = 2048


def measurement(scenario, network, observed):
    """(agent, keys) -> of each episode: violations and minutes (E, 1 + S), overall and by situation; completed (E,)."""
    scenario = replace(scenario, metrics=())
    steps = round(scenario.time_limit / scenario.time_step)
    terms = [term for name in VIOLATIONS if (term := mdp.of_metric(name).step)]

    def record(before, after, _):
        going = jnp.where(before.completed | before.timed_out, 0.0, 1.0)
        columns = going * jnp.concatenate([jnp.ones(1), after.situations.astype(float)])
        return sum(term(scenario, before, after) for term in terms) * columns, columns

    def episode(policy, key):
        last, (events, minutes_in) = sean_jax.rollout(scenario, policy, key, steps, record)
        return {
            "violations": events.sum(0),
            "minutes": minutes_in.sum(0) * scenario.time_step / 60.0,
            "completed": last.completed.astype(float),
        }

    size = AT_ONCE.get(jax.default_backend(), AT_ONCE_ELSEWHERE)

    @jax.jit
    def all_of(agent, keys):
        policy = agent_policy(network, agent, observed)
        return jax.lax.map(lambda key: episode(policy, key), keys, batch_size=size)

    return lambda agent, keys: jax.tree.map(np.asarray, all_of(agent, keys))


def difference(first: dict, second: dict, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(1 + S,) difference of violations per minute in the same episodes, first minus second, with an interval."""
    takes = np.concatenate([np.ones((1, weights.shape[1])), weights])  # (1 + R, E)

    def rates(episodes: dict) -> np.ndarray:
        return (takes @ episodes["violations"]) / np.maximum(takes @ episodes["minutes"], 1e-9)

    gap = rates(first) - rates(second)
    return gap[0], *bootstrap.interval(gap[1:])


def picture(path: Path, names: list[str], worst: str, rates: dict[str, bootstrap.Estimate]) -> None:
    """Violations per minute of each agent in each situation, with intervals."""
    from matplotlib.figure import Figure

    figure = Figure((8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for turn, (label, rate) in enumerate(rates.items()):
        x = np.arange(len(names)) + 0.25 * (turn - 1)
        spread = np.abs(np.stack([rate.mean - rate.low, rate.high - rate.mean]))
        axes.bar(x, rate.mean, 0.23, yerr=spread, label=label, capsize=2)
    labels = [name.replace("_", " ") + ("\nworst before" if name == worst else "") for name in names]
    axes.set_xticks(np.arange(len(names)), labels)
    axes.set_ylabel("violations per minute")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def count(text: str) -> int:
    """A whole number of 1 or more, as the command line gives it, such as 500000 or 5e5."""
    if not float(text) >= 1 or float(text) % 1:
        raise argparse.ArgumentTypeError(f"{text} must be a whole number of 1 or more")
    return int(float(text))


def worst_situation(names: list[str], measured: dict) -> int:
    """The column with the most violations per minute, among situations that occur in enough episodes."""
    enough = (measured["minutes"] > 0).sum(0) >= min(FEWEST, len(measured["minutes"]) / 4)
    enough[0] = False  # the column of all situations together
    rate = bootstrap.aggregate_ratio(measured["violations"], measured["minutes"]).mean
    if not (enough & (rate > 0)).any():
        sys.exit(f"no violation in {', '.join(names[1:])}: nothing to mend; take more --episodes or another agent.")
    return int(np.where(enough, rate, -1.0).argmax())


def verdict(low: float, high: float, other: str) -> str:
    """The meaning of an interval of a difference."""
    if low <= 0.0 <= high:
        return f"no decided difference from {other}"
    return f"{'fewer' if high < 0.0 else 'more'} violations than {other}"


def main() -> None:
    """Train twice, measure three times, and print the table."""
    arguments = parser(
        __doc__,
        out=Option(Path("runs/mended"), "folder of trainings and figures", kind=Path),
        steps=Option(500_000, "additional scenario-steps of each training", kind=count),
        scenarios=Option(None, "that step together; by default the agent's", kind=count),
        learning_rate=Option(None, "at the beginning; by default half of the agent's", kind=float),
        curriculum=Option("situations", choices=["situations", "regret"]),
        every=Option(20, "updates between two draws of new starts", kind=count),
        episodes=Option(512, "of each measurement", kind=count),
        seeds=Option(1, "trainings of each kind", kind=count),
    )
    arguments.add_argument("agent", help="folder of `sean train ppo`, or the name of an agent of the package")
    chosen = arguments.parse_args()
    try:
        mend(chosen, Console(stderr=True))
    except (SeanError, ValueError) as error:  # the latter of pydantic, too: an option is impossible
        arguments.error(str(error))


def mend(chosen: argparse.Namespace, console: Console) -> None:
    """``main`` with parsed options."""
    folder = Path(chosen.agent)
    folder = folder if folder.exists() else AGENTS.get(chosen.agent, folder)
    options = read_options(folder)
    (scenario, *_), _, _ = reinforcement.build(options)
    network, given, observed = load_agent(folder, scenario)
    trainings = {"none": [], chosen.curriculum: []}
    for kind, several in trainings.items():
        for seed in range(options.seed + 1, options.seed + 1 + chosen.seeds):
            console.print(f"training, curriculum {kind}, seed {seed}")
            further = options.replace(
                pretrained=folder, steps=chosen.steps, curriculum=kind, seed=seed, seeds=1, sweep=(),
                curriculum_every=options.curriculum_every if kind == "none" else chosen.every,
                scenarios=chosen.scenarios or options.scenarios, imitate=None, noise=None,
                learning_rate=chosen.learning_rate or options.learning_rate / 2,
                out=chosen.out / f"{kind}-{seed - options.seed - 1}",
            )  # fmt: skip
            last = reinforcement.train(further, console).agent  # the best is chosen by its return, not by violations
            several.append(jax.tree.map(lambda part: part[0], last))

    console.print(f"measuring {2 + 2 * chosen.seeds} times {chosen.episodes} episodes")
    measure = measurement(scenario, network, observed)
    names = ["overall", *(name for name, _ in scenario.situations)]
    # Chosen in separate episodes: the worst of the same episodes would be biased.
    worst = worst_situation(names, measure(given, jax.random.split(random_streams.key("run", 1), chosen.episodes)))
    keys = jax.random.split(random_streams.key("run", 0), chosen.episodes)
    measured = {"before": [measure(given, keys)]}
    for kind, several in trainings.items():
        measured[kind] = [measure(agent, keys) for agent in several]
    report(chosen, names, worst, measured)


class Figures(NamedTuple):
    """Violations per minute of all situations, by kind of training."""

    rates: dict[str, bootstrap.Estimate]
    gaps: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]  # the curriculum less another kind, and its interval


def report(chosen: argparse.Namespace, names: list[str], worst: int, measured: dict[str, list[dict]]) -> None:
    """Print the table, and write it with a picture."""
    # An episode combines all seeds, so that intervals are over episodes.
    weights = bootstrap.resamples(chosen.episodes)
    pooled = {kind: jax.tree.map(lambda *seeds: np.mean(seeds, 0), *agents) for kind, agents in measured.items()}
    rates, gaps = {}, {}
    for kind, episodes in pooled.items():
        rates[kind] = bootstrap.aggregate_ratio(episodes["violations"], episodes["minutes"], weights=weights)
    for kind in ("before", "none"):
        gaps[kind] = difference(pooled[chosen.curriculum], pooled[kind], weights)
    figures = Figures(rates, gaps)
    titles = ["before", "no curriculum", chosen.curriculum]
    print_rates(chosen, names, worst, titles, figures)

    results: dict[str, dict] = {kind: listed(rate.mean, rate.low, rate.high) for kind, rate in rates.items()}
    results |= {f"{chosen.curriculum} less {kind}": listed(*gap) for kind, gap in gaps.items()}
    for label, column in (("completed", np.s_[:]), ("minutes", np.s_[:, 0])):
        means = {
            kind: bootstrap.aggregate(episodes[label][column], weights=weights) for kind, episodes in pooled.items()
        }
        print_row(label, [f"{mean.mean:.3f} ({mean.low:.3f} to {mean.high:.3f})" for mean in means.values()])
        for kind, mean in means.items():
            results[kind][label] = float(mean.mean)
    for kind in ("none", chosen.curriculum):
        by_seed = [float(worst_rate(episodes, worst)) for episodes in measured[kind]]
        results[kind]["by seed"] = by_seed
        if chosen.seeds > 1:
            print(f"{kind}, {names[worst]}, by seed: " + ", ".join(f"{rate:.2f}" for rate in by_seed))
    print_verdict(chosen, names[worst], worst, figures)

    # By the name of the curriculum: another curriculum may share the folder and the trainings without a curriculum.
    options = {name: str(value) for name, value in vars(chosen).items()}
    content = {"options": options, "columns": names, "worst": names[worst], **results}
    (chosen.out / f"{chosen.curriculum}.json").write_text(json.dumps(content, indent=1))
    path = chosen.out / f"{chosen.curriculum}.png"
    picture(path, names, names[worst], dict(zip(titles, rates.values(), strict=False)))
    print(path)


def print_rates(chosen: argparse.Namespace, names: list[str], worst: int, titles: list[str], figures: Figures) -> None:
    """Print a row of violations per minute for each situation."""
    print(f"violations per minute, {chosen.episodes} episodes, 95 % intervals; * is the worst situation before")
    print_row("", [*titles, *(f"{chosen.curriculum} - {kind}" for kind in figures.gaps)])
    for row, name in enumerate(names):
        cells = []
        for rate in figures.rates.values():
            cells.append(f"{rate.mean[row]:.2f} ({rate.low[row]:.2f} to {rate.high[row]:.2f})")
        for gap, low, high in figures.gaps.values():
            cells.append(f"{gap[row]:+.2f} ({low[row]:+.2f} to {high[row]:+.2f})")
        print_row(f"{name} *" if row == worst else name, cells)


def print_verdict(chosen: argparse.Namespace, name: str, worst: int, figures: Figures) -> None:
    """Print whether the worst situation is better than before and than without a curriculum."""
    words = []
    for kind, other in (("before", "before"), ("none", "without a curriculum")):
        _, low, high = figures.gaps[kind]
        words.append(verdict(low[worst], high[worst], other))
    print(f"{name} after training with curriculum {chosen.curriculum}: {', '.join(words)}")


def print_row(label: str, cells: list[str]) -> None:
    """Print a row of the table."""
    print(f"{label:14}" + "".join(f"{cell:>24}" for cell in cells))


def listed(mean: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict[str, list[float]]:
    """An estimate as a file of results has it."""
    return {"mean": mean.tolist(), "low": low.tolist(), "high": high.tolist()}


def worst_rate(episodes: dict, worst: int) -> float:
    """Violations per minute of the worst situation."""
    return episodes["violations"][:, worst].sum() / episodes["minutes"][:, worst].sum()


if __name__ == "__main__":
    main()
