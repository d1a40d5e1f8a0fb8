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

import jax
import jax.numpy as jnp
import numpy as np
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
        last, (events, there) = sean_jax.rollout(scenario, policy, key, steps, record)
        return {
            "violations": events.sum(0),
            "minutes": there.sum(0) * scenario.time_step / 60.0,
            "completed": last.completed.astype(float),
        }

    size = AT_ONCE.get(jax.default_backend(), AT_ONCE_ELSEWHERE)

    @jax.jit
    def all_of(agent, keys):
        policy = agent_policy(network, agent, observed)
        return jax.lax.map(lambda key: episode(policy, key), keys, batch_size=size)

    return lambda agent, keys: jax.tree.map(np.asarray, all_of(agent, keys))


def difference(one: dict, other: dict, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(1 + S,) difference of violations per minute in the same episodes, first minus second, with an interval."""
    takes = np.concatenate([np.ones((1, weights.shape[1])), weights])
    rates = [(takes @ each["violations"]) / np.maximum(takes @ each["minutes"], 1e-9) for each in (one, other)]
    gap = rates[0] - rates[1]
    return gap[0], *bootstrap.interval(gap[1:])


def picture(path: Path, names: list[str], worst: str, found: dict[str, bootstrap.Estimate]) -> None:
    """Violations per minute of each agent in each situation, with intervals."""
    from matplotlib.figure import Figure

    figure = Figure((8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for turn, (label, each) in enumerate(found.items()):
        x = np.arange(len(names)) + 0.25 * (turn - 1)
        spread = np.abs(np.stack([each.mean - each.low, each.high - each.mean]))
        axes.bar(x, each.mean, 0.23, yerr=spread, label=label, capsize=2)
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
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("agent", help="folder of `sean train ppo`, or the name of an agent of the package")
    arguments.add_argument("--out", type=Path, default=Path("runs/mended"), help="folder of trainings and figures")
    arguments.add_argument("--steps", type=count, default=500_000, help="additional scenario-steps of each training")
    arguments.add_argument("--scenarios", type=count, help="that step together; by default the agent's")
    arguments.add_argument("--learning-rate", type=float, help="at the beginning; by default half of the agent's")
    arguments.add_argument("--curriculum", default="situations", choices=["situations", "regret"])
    arguments.add_argument("--every", type=count, default=20, help="updates between two draws of new starts")
    arguments.add_argument("--episodes", type=count, default=512, help="of each measurement")
    arguments.add_argument("--seeds", type=count, default=1, help="trainings of each kind")
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


def report(chosen: argparse.Namespace, names: list[str], worst: int, measured: dict[str, list[dict]]) -> None:
    """Print the table, and write it with a picture."""
    weights = bootstrap.resamples(chosen.episodes)
    # An episode combines all seeds, so that intervals are over episodes.
    pooled = {kind: jax.tree.map(lambda *each: np.mean(each, 0), *each) for kind, each in measured.items()}
    found = {
        kind: bootstrap.aggregate_ratio(each["violations"], each["minutes"], weights=weights)
        for kind, each in pooled.items()
    }
    gaps = {kind: difference(pooled[chosen.curriculum], pooled[kind], weights) for kind in ("before", "none")}
    print(f"violations per minute, {chosen.episodes} episodes, 95 % intervals; * is the worst situation before")
    titles = ["before", "no curriculum", chosen.curriculum, *(f"{chosen.curriculum} - {other}" for other in gaps)]
    print(f"{'':14}" + "".join(f"{title:>24}" for title in titles))
    for row, name in enumerate(names):
        cells = [f"{each.mean[row]:.2f} ({each.low[row]:.2f} to {each.high[row]:.2f})" for each in found.values()]
        cells += [f"{gap[row]:+.2f} ({low[row]:+.2f} to {high[row]:+.2f})" for gap, low, high in gaps.values()]
        print(f"{name + (' *' if row == worst else ''):14}" + "".join(f"{cell:>24}" for cell in cells))
    kept = {
        kind: {"mean": each.mean.tolist(), "low": each.low.tolist(), "high": each.high.tolist()}
        for kind, each in found.items()
    }
    kept |= {
        f"{chosen.curriculum} less {other}": {"mean": gap.tolist(), "low": low.tolist(), "high": high.tolist()}
        for other, (gap, low, high) in gaps.items()
    }
    for label, column in (("completed", np.s_[:]), ("minutes", np.s_[:, 0])):
        means = {kind: bootstrap.aggregate(each[label][column], weights=weights) for kind, each in pooled.items()}
        for kind, x in means.items():
            kept[kind][label] = float(x.mean)
        print(f"{label:14}" + "".join(f"{f'{x.mean:.3f} ({x.low:.3f} to {x.high:.3f})':>24}" for x in means.values()))
    for kind in ("none", chosen.curriculum):
        rates = [each["violations"][:, worst].sum() / each["minutes"][:, worst].sum() for each in measured[kind]]
        kept[kind]["by seed"] = [float(rate) for rate in rates]
        if chosen.seeds > 1:
            print(f"{kind}, {names[worst]}, by seed: " + ", ".join(f"{rate:.2f}" for rate in rates))
    said = [
        verdict(gaps[kind][1][worst], gaps[kind][2][worst], other)
        for kind, other in (("before", "before"), ("none", "without a curriculum"))
    ]
    print(f"{names[worst]} after training with curriculum {chosen.curriculum}: {said[0]}, {said[1]}")
    made = {name: str(value) for name, value in vars(chosen).items()}
    told = {"options": made, "columns": names, "worst": names[worst], **kept}
    # By the name of the curriculum: another curriculum may share the folder and the trainings without a curriculum.
    (chosen.out / f"{chosen.curriculum}.json").write_text(json.dumps(told, indent=1))
    picture(
        chosen.out / f"{chosen.curriculum}.png", names, names[worst], dict(zip(titles, found.values(), strict=False))
    )
    print(chosen.out / f"{chosen.curriculum}.png")


if __name__ == "__main__":
    main()
