"""Effects of the social forces on people, by preset: the tables of docs/results/social_forces.md.

python benchmarks/forces.py                     all experiments, with every preset
python benchmarks/forces.py passing robot       passing, robot, bottleneck, walking_groups
"""

import jax
import jax.numpy as jnp
import numpy as np
from options import parser
from timing import import_from_tests

import sean_jax
from sean_jax import social_forces

import_from_tests()  # the tests assert what is printed here
from support.walkers import (  # noqa: E402
    bottleneck,
    doorway,
    flow,
    in_scenario,
    in_the_open,
    right_share,
    robot_gaps,
    side_preference,
    together,
)

PREFERENCES = {
    "sidestep.preference": (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2, 1.6),  # m/s2
    "evasion.side": (0.0, 0.01, 0.02, 0.03, 0.05, 0.1, 0.15, 0.2, 0.3),  # m
}
FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0)  # of the repulsion by the robot


def print_passing(presets) -> None:
    """Share of right-hand passes by side preference."""
    print("passing: share of head-on meetings in which both keep right, by side preference (1000 each)")
    for name in presets:
        parameters = social_forces.preset(name)
        side = side_preference(parameters)
        term, field = side.split(".")
        print(f"{side:>20}" + "".join(f"{value:7.2f}" for value in PREFERENCES[side]) + "   own value")
        for sign in (1.0, -1.0):
            share = np.nanmean(right_share(parameters, sign * np.array(PREFERENCES[side])), axis=1)
            shares = "".join(f"{value:7.3f}" for value in share)
            if sign > 0:
                print(f"{name:>20}{shares}   {float(getattr(getattr(parameters, term), field)):9.2f}")
            else:
                print(f"{'  mirrored':>20}{shares}")


def print_robot(presets) -> None:
    """Closest approach by robot distance, and for drawn distances."""
    print("robot: mean closest approach [m] of a walker and a robot at 0.5 m/s, by the factor f of its repulsion,")
    print("that is by a robot_distance of range * ln(f); then with the distances drawn per person, and their effect")
    print(f"{'':>14}" + "".join(f"{value:7.1f}" for value in FACTORS) + f"{'drawn':>12}{'correlation':>13}")
    gaps = jax.jit(robot_gaps, static_argnames="crossings")
    for name in presets:
        parameters = social_forces.preset(name)
        distances = parameters.repulsion.range * jnp.log(jnp.asarray(FACTORS))
        by_factor = np.asarray(gaps(parameters, distances, crossings=400)).mean(1)
        drawn = social_forces.draw_traits(parameters, jax.random.key(9), 400)[1]
        gap = np.asarray(gaps(parameters, drawn[None], crossings=400))[0]
        print(f"{name:>14}" + "".join(f"{gap_by_factor:7.3f}" for gap_by_factor in by_factor)
              + f"{gap.mean():7.2f}+-{gap.std():.2f}{np.corrcoef(gap, np.asarray(drawn))[0, 1]:13.2f}")  # fmt: skip


def print_bottleneck(presets, seeds: int = 4) -> None:
    """Flow and overlap by preset and step."""
    print("bottleneck: 60 people through 1.2 m, 60 s, mean of 4 crowds; measured: 1.9 w = 2.28 people/s")
    print(f"{'':>14}{'step s':>8}{'out':>6}{'people/s':>10}{'/ width':>9}{'overlap cm':>11}{'99.9 %':>8}{'longest':>9}")
    table = doorway(1.2)
    for name in presets:
        parameters = social_forces.preset(name)
        longest = social_forces.longest_step(parameters)
        for time_step in (0.05, 0.02, 0.01, 0.005):
            runs = [bottleneck(parameters, table, 1.2, jax.random.key(k), time_step=time_step) for k in range(seeds)]
            overlap = 100 * np.stack([np.asarray(run[1]) for run in runs])
            people = np.mean([np.isfinite(np.asarray(run[0])).sum() for run in runs])
            rate = np.mean([flow(run[0]) for run in runs])
            print(f"{name:>14}{time_step:8.3f}{people:6.1f}{rate:10.2f}{rate / 1.2:9.2f}"
                  f"{overlap.max():11.1f}{np.quantile(overlap, 0.999):8.1f}{longest:9.3f}")  # fmt: skip


def print_walking_groups(presets) -> None:
    """Speeds and spacing of walking groups, in the open and in the warehouse."""
    print("walking groups: while faster than 0.5 m/s, singles / pairs / triples; measured: spacing .71-.92 m, beside")
    print(".63-.89, pairs .04-.15 m/s slower than singles, triples slower than pairs")
    print(f"{'':>14}{'':>10}{'speed m/s':>19}{'spacing m':>12}{'beside':>11}{'over 2 m apart':>16}")
    for name in presets:
        parameters = social_forces.preset(name)
        rows = {"open": {size: together(*in_the_open(parameters, size)).get(size, {}) for size in (1, 2, 3)}}
        for behavior, task in (("random", "random_ab_nav"), ("graph", "join_group")):
            scenario = sean_jax.make(
                "warehouse", behavior=behavior, task=task, forces=parameters, walking_groups=(0.3, 0.3)
            )
            rows[behavior] = together(*in_scenario(scenario))
        for place, pairs in rows.items():
            cells = [
                " ".join(f"{pairs.get(size, {}).get(key, np.nan):5.2f}" for size in sizes)
                for key, sizes in (("speed", (1, 2, 3)), ("spacing", (2, 3)), ("beside", (2, 3)), ("apart", (2, 3)))
            ]
            print(f"{name:>14}{place:>10}{cells[0]:>19}{cells[1]:>12}{cells[2]:>11}{cells[3]:>16}", flush=True)


EXPERIMENTS = {
    "passing": print_passing,
    "robot": print_robot,
    "bottleneck": print_bottleneck,
    "walking_groups": print_walking_groups,
}


def main() -> None:
    """Print the tables."""
    arguments = parser(__doc__, presets=list(social_forces.PRESETS))
    arguments.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help=", ".join(EXPERIMENTS))
    chosen = arguments.parse_args()
    for name in chosen.experiments or EXPERIMENTS:
        EXPERIMENTS[name](chosen.presets)


if __name__ == "__main__":
    main()
