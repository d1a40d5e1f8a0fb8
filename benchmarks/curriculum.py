"""Mending the worst situation of an agent: where it violates people's space most, before and after more training.

The agent of a folder drives in fresh episodes, and its worst situation is the one with the most violations a minute.
Its training goes on twice, for as many steps: with a curriculum, and without one. All three are measured in other
episodes, the same for all, with 95 % bootstrap intervals. A violation is somebody within 0.45 m, by whose fault ever.

python benchmarks/curriculum.py runs/ppo --steps 500000 --out runs/mended
python benchmarks/curriculum.py runs/ppo --steps 2e7 --scenarios 4096 --episodes 2048 --seeds 3 --curriculum regret
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import sean_jax
from sean_jax import mdp, prng
from sean_jax.learning import agents, driving, reinforcement, trained
from sean_jax.metrics import bootstrap

VIOLATIONS = ("intimate_robot_on_person", "intimate_person_on_robot")
FEWEST = 30  # episodes in which a situation occurs, for it to be called the worst
AT_ONCE = 256  # episodes


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

    @jax.jit
    def all_of(agent, keys):
        policy = driving.policy(network, agent, observed)
        return jax.lax.map(lambda key: episode(policy, key), keys, batch_size=AT_ONCE)

    return lambda agent, keys: jax.tree.map(np.asarray, all_of(agent, keys))


def difference(one: dict, other: dict, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(1 + S,) violations a minute of one less those of the other, in the same episodes, with an interval."""
    takes = np.concatenate([np.ones((1, weights.shape[1])), weights])
    rates = [(takes @ each["violations"]) / np.maximum(takes @ each["minutes"], 1e-9) for each in (one, other)]
    gap = rates[0] - rates[1]
    return gap[0], *bootstrap.interval(gap[1:])


def picture(path: Path, names: list[str], found: dict[str, bootstrap.Estimate]) -> None:
    """Violations a minute of each agent in each situation, with intervals."""
    from matplotlib.figure import Figure

    figure = Figure((8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for turn, (label, each) in enumerate(found.items()):
        x = np.arange(len(names)) + 0.25 * (turn - 1)
        spread = np.abs(np.stack([each.mean - each.low, each.high - each.mean]))
        axes.bar(x, each.mean, 0.23, yerr=spread, label=label, capsize=2)
    axes.set_xticks(np.arange(len(names)), [name.replace("_", " ") for name in names])
    axes.set_ylabel("violations per minute")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure, train twice, measure again, and print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path, help="of `sean train ppo`")
    arguments.add_argument("--out", type=Path, default=Path("runs/mended"), help="folder of trainings and figures")
    arguments.add_argument("--steps", type=float, default=500_000, help="scenario-steps of each further training")
    arguments.add_argument("--scenarios", type=int, help="that step together; as in the folder unless given")
    arguments.add_argument("--learning-rate", type=float, help="at the beginning; half of the folder's unless given")
    arguments.add_argument("--curriculum", default="situations", choices=["situations", "regret"])
    arguments.add_argument("--every", type=int, default=20, help="updates between two draws of new starts")
    arguments.add_argument("--episodes", type=int, default=512, help="of each measurement")
    arguments.add_argument("--seeds", type=int, default=1, help="trainings of each kind")
    chosen = arguments.parse_args()

    options = agents.read_options(chosen.folder)
    scenario = reinforcement.build(options)[0]
    load = agents.load if agents.is_packed(chosen.folder) else trained.load
    network, given, observed = load(chosen.folder, scenario)
    measure = measurement(scenario, network, observed)
    names = ["overall", *(name for name, _ in scenario.situations)]
    keys = jax.random.split(prng.key("run", 0), chosen.episodes)
    # Chosen in episodes of its own: the worst of the same ones would look worse than it is.
    first = measure(given, jax.random.split(prng.key("run", 1), chosen.episodes))
    enough = (first["minutes"] > 0).sum(0) >= min(FEWEST, chosen.episodes // 4)
    rate = bootstrap.aggregate_ratio(first["violations"], first["minutes"]).mean
    worst = 1 + int(np.where(enough, rate, -1.0)[1:].argmax())
    measured = {"before": [measure(given, keys)]}
    for kind in ("none", chosen.curriculum):
        measured[kind] = []
        for seed in range(chosen.seeds):
            further = options.replace(
                pretrained=chosen.folder, steps=int(chosen.steps), curriculum=kind, curriculum_every=chosen.every,
                scenarios=chosen.scenarios or options.scenarios, seed=options.seed + 1 + seed, seeds=1,
                learning_rate=chosen.learning_rate or options.learning_rate / 2, out=chosen.out / f"{kind}-{seed}",
                sweep=(), quiet=True,
            )  # fmt: skip
            last = reinforcement.train(further).agent  # the best is chosen by its return, not by violations
            agent = jax.tree.map(lambda part: part[0], last)
            measured[kind].append(measure(agent, keys))
            print(f"trained {kind}, seed {further.seed}", flush=True)

    weights = bootstrap.resamples(chosen.episodes)
    # An episode is that of all seeds together, so that intervals are of episodes.
    pooled = {kind: jax.tree.map(lambda *each: np.mean(each, 0), *each) for kind, each in measured.items()}
    found = {
        kind: bootstrap.aggregate_ratio(each["violations"], each["minutes"], weights=weights)
        for kind, each in pooled.items()
    }
    gap, low, high = difference(pooled[chosen.curriculum], pooled["none"], weights)
    print(f"violations per minute, {chosen.episodes} episodes, 95 % intervals; worst situation before: {names[worst]}")
    print(f"{'':14}" + "".join(f"{kind:>24}" for kind in found) + f"{'curriculum less none':>26}")
    for row, name in enumerate(names):
        cells = [f"{each.mean[row]:.2f} ({each.low[row]:.2f} to {each.high[row]:.2f})" for each in found.values()]
        last = f"{gap[row]:+.2f} ({low[row]:+.2f} to {high[row]:+.2f})"
        print(f"{name + (' *' if row == worst else ''):14}" + "".join(f"{cell:>24}" for cell in cells) + f"{last:>26}")
    for label, numbers in (
        ("completed", {kind: each["completed"] for kind, each in pooled.items()}),
        ("minutes", {kind: each["minutes"][:, 0] for kind, each in pooled.items()}),
    ):
        means = [bootstrap.aggregate(each, weights=weights) for each in numbers.values()]
        print(f"{label:14}" + "".join(f"{f'{x.mean:.3f} ({x.low:.3f} to {x.high:.3f})':>24}" for x in means))
    if chosen.seeds > 1:
        for kind in ("none", chosen.curriculum):
            rates = [each["violations"][:, worst].sum() / each["minutes"][:, worst].sum() for each in measured[kind]]
            print(f"{kind}, {names[worst]}, by seed: " + ", ".join(f"{rate:.2f}" for rate in rates))
    chosen.out.mkdir(parents=True, exist_ok=True)
    kept = {kind: {"mean": each.mean.tolist(), "low": each.low.tolist(), "high": each.high.tolist()}
            for kind, each in found.items()}  # fmt: skip
    kept["difference"] = {"mean": gap.tolist(), "low": low.tolist(), "high": high.tolist()}
    (chosen.out / "mended.json").write_text(json.dumps({"situations": names, "worst": names[worst], **kept}, indent=1))
    picture(chosen.out / "mended.png", names, found)
    print(chosen.out / "mended.png")


if __name__ == "__main__":
    main()
