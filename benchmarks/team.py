"""Several robots in a scenario: control steps a second of teams, beside those of the plain scenario with one robot.

python benchmarks/team.py --robots 1 2 4 --batch 16 --out benchmarks/results/team.json

A step is one control step of one scenario, with the commands of all its robots. Times are medians of the repeats; the
sizes take turns, so that another program on the machine slows all of them.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import stopwatch, write_json

import sean_jax
from sean_jax import team
from sean_jax.policies import POLICIES


def programs(arguments: argparse.Namespace) -> dict[str, tuple]:
    """Name -> compiled steps and the states with which they begin."""
    options = dict(behavior=arguments.behavior, people=arguments.people, task="random_ab_nav")
    policy, keys = POLICIES[arguments.policy], jax.random.split(jax.random.key(0), arguments.batch)
    plain = sean_jax.make(arguments.environment, **options)

    def steps(step):
        def run(states):
            return jax.lax.scan(lambda states, _: (jax.vmap(step)(states)[0], None), states, length=arguments.steps)[0]

        return jax.jit(run)

    def begin(key):
        return sean_jax.init_policy(plain, policy, sean_jax.reset(plain, key))

    runs = {"plain": (steps(lambda state: sean_jax.policy_step(plain, policy, state)), jax.jit(jax.vmap(begin))(keys))}
    for number in arguments.robots:
        names = ",".join(["kuri"] * number)
        members = sean_jax.make_team(arguments.environment, robots=names, **options)
        starts = jax.jit(jax.vmap(lambda key, m=members: team.init_policy(m, policy, team.reset(m, key))))(keys)
        runs[f"{number}"] = steps(lambda states, m=members: team.policy_step(m, policy, states)), starts
    return runs


def main() -> None:
    """Print the table, and write it."""
    arguments = parse(
        __doc__,
        environment="lab",
        behavior="random",
        people=20,
        policy=Option("go_to_goal", choices=POLICIES),
        robots=[1, 2, 4],
        batch=16,
        steps=50,
        repeats=7,
        out=Option(None, kind=Path),
    )
    runs = programs(arguments)
    for run, states in runs.values():
        jax.block_until_ready(run(states))
    seconds = {name: [] for name in runs}
    for _ in range(arguments.repeats):
        for name, (run, states) in runs.items():
            with stopwatch() as watch:
                jax.block_until_ready(jnp.asarray(run(states).tick))
            seconds[name].append(watch.seconds)
    rates = {name: arguments.batch * arguments.steps / float(np.median(times)) for name, times in seconds.items()}
    rows = {name: {"steps_per_second": rate, "share_of_plain": rate / rates["plain"]} for name, rate in rates.items()}
    for name, row in rows.items():
        print(f"{name:>6} robots  {row['steps_per_second']:10,.0f} steps/s  {row['share_of_plain']:6.2f} of plain")
    if arguments.out is not None:
        about = {key: value for key, value in vars(arguments).items() if key != "out"}
        device = f"{len(jax.devices())} x {jax.devices()[0].device_kind}"
        content = {"device": device, "options": about, "teams": rows}
        write_json(arguments.out, content, indent=2)


if __name__ == "__main__":
    main()
