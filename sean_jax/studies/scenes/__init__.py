"""Scenes: walls, people with routes through gates, sources and sinks, periodic corridors, in a few lines.

    scene = Scene(
        walls=room((0, 0), (10, 10), doors=[((10, 5.6), (10, 4.4))]),
        gates=(Gate((10, 5.6), (10, 4.4)),),
        walkers=walkers(spread((1, 1), (6, 9), 60, seed=0), route=(0,)),
        seconds=120.0,
    )
    tracks = simulate(scene)[0]

People move by the ordinary simulator, with any forces or pedestrian model; a robot is optional.
"""

from sean_jax.studies.scenes.scene import (
    Model,
    Periodic,
    Scene,
    box,
    corridor,
    environment,
    model,
    room,
    scenario_of,
    stage,
    wall,
)
from sean_jax.studies.scenes.simulation import simulate
from sean_jax.studies.scenes.walkers import Gate, Walkers, join, source, spread, walkers, walkers_behavior

__all__ = [
    "Gate",
    "Model",
    "Periodic",
    "Scene",
    "Walkers",
    "box",
    "corridor",
    "environment",
    "join",
    "model",
    "room",
    "scenario_of",
    "simulate",
    "source",
    "spread",
    "stage",
    "wall",
    "walkers",
    "walkers_behavior",
]
