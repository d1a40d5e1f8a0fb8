"""Draws the pictures of docs/worlds.md, docs/pictures/worlds-*.png: python docs/worlds.py.

Five floors of each family.
"""

from pathlib import Path

from sean_jax import drawing
from sean_jax.graph import annotation
from sean_jax.world import generated

PICTURES = Path(__file__).resolve().parent / "pictures"

for family in generated.FAMILIES:
    made = [generated.generate(family, seed) for seed in range(5)]
    sheet = drawing.floors_sheet([(world.environment, annotation.build_graph(world.graph, None)) for world in made])
    sheet.savefig(PICTURES / f"worlds-{family}.png", dpi=95, pil_kwargs={"optimize": True})
