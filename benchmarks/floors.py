"""People on Behavior Graphs by each routing, beside what recorded people do; and a robot that stands before a door.

python benchmarks/floors.py --door-draws 20 --out benchmarks/results/floors.json

Rates are per person-minute. In the draws of the door a robot stands 0.44 m before an opening of 1.33 m and leaves
0.67 m of it free: the longest time for which a person stays within 1 m of it, and how many pass, with and without it.
"""

import json
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse

import sean_jax
from sean_jax.studies.validation.floor_measures import liveliness, used_cells
from sean_jax.studies.validation.floors import NOWHERE, observe, watch
from sean_jax.world import generated

WORLD = ("rooms", 3, {"door": 1.33})
PEOPLE = 27  # 2.5 times those of the world
DOOR_LEFT, DOOR_RIGHT, DOOR_Y = 14.36, 15.69, 6.636  # m, of one of its doors
ROBOT = (15.19, 7.14)  # m
NEAR = 1.0  # m
SECONDS = 90.0


def longest_near(position: np.ndarray, present: np.ndarray, time_step: float) -> float:
    """The longest time [s] that a person (T, N, 2) m stays within ``NEAR`` of the robot's place."""
    near = present & (np.linalg.norm(position - np.array(ROBOT), axis=-1) < NEAR)
    longest = np.zeros(near.shape[1], int)
    current = np.zeros(near.shape[1], int)
    for row in near:
        current = np.where(row, current + 1, 0)
        longest = np.maximum(longest, current)
    return round(float(longest.max() * time_step), 1)


def passes(position: np.ndarray, present: np.ndarray) -> int:
    """How often people (T, N, 2) m pass the door."""
    x, y = np.moveaxis(position, -1, 0)
    in_door = (x > DOOR_LEFT) & (x < DOOR_RIGHT) & present
    beyond = y > DOOR_Y
    return int(((beyond[1:] != beyond[:-1]) & in_door[1:] & in_door[:-1]).sum())


def door(draws: int) -> dict:
    """The figures of a door with and without a robot."""
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        generated.save(generated.generate(*WORLD), Path(folder) / "rooms")
        scenario = sean_jax.make(f"{folder}/rooms", behavior="graph", routing="trips", people=PEOPLE, robot="kuri")
    keys = jax.random.split(jax.random.key(5), draws)
    run = jax.jit(lambda place: jax.vmap(lambda key: watch(scenario, key, place, SECONDS))(keys))
    for name, place in (("robot", ROBOT), ("nobody", (NOWHERE, NOWHERE))):
        seen = jax.tree.map(np.asarray, run(jnp.asarray(place, float)))
        rows = list(zip(seen.position, seen.present, strict=True))
        figures[name] = {
            "longest": [longest_near(*row, scenario.time_step) for row in rows],
            "passes": [passes(*row) for row in rows],
        }
        print(name, json.dumps(figures[name]))
    return figures


def main() -> None:
    """Print the figures of each floor and routing."""
    options = parse(
        __doc__,
        environments=["warehouse", "lab", "outdoor"],
        routings=["whole", "trips"],
        seconds=120.0,
        door_draws=0,
        out=Option(None, kind=Path),
    )
    figures = {}
    for environment in options.environments:
        for routing in options.routings:
            scenario = sean_jax.make(environment, behavior="graph", routing=routing)
            seen, group = observe(scenario, options.seconds)
            values = {name: round(float(value), 4) for name, value in liveliness(seen)._asdict().items()}
            values |= {"in_groups": float((group >= 0).sum(1).mean()), "cells": len(used_cells(seen))}
            figures[f"{environment} {routing}"] = values
            print(environment, routing, json.dumps(values))
    if options.door_draws:
        figures["door"] = door(options.door_draws)
    if options.out is not None:
        options.out.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
