"""People on Behavior Graphs by each routing, beside what recorded people do; and a robot that stands before a door.

python benchmarks/floors.py --door-draws 20 --out benchmarks/results/floors.json

Rates are per person-minute. In the draws of the door a robot stands 0.3 to 0.6 m before an opening of 1.33 m and leaves
0.67 m of it free: the longest time for which a person stays within 1 m of it, and how many pass, with and without it.
"""

import json
from pathlib import Path

import numpy as np
from options import Option, parse

import sean_jax
from sean_jax.studies.validation.floor_measures import group_life, liveliness, used_cells
from sean_jax.studies.validation.floors import door_draws, observe


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
            seen, gathered = observe(scenario, options.seconds)
            measures = liveliness(seen)._asdict() | group_life(seen, gathered)._asdict()
            values = {name: round(float(value), 4) for name, value in measures.items() if np.isfinite(value)}
            values |= {"in_groups": float((gathered.group >= 0).sum(1).mean()), "cells": len(used_cells(seen))}
            figures[f"{environment} {routing}"] = values
            print(environment, routing, json.dumps(values))
    if options.door_draws:
        figures["door"] = {name: draws._asdict() for name, draws in door_draws(options.door_draws).items()}
        for name, values in figures["door"].items():
            print(name, json.dumps(values))
    if options.out is not None:
        options.out.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
