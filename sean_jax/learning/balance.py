"""Balanced examples: drawn so that each social situation is as frequent as any other.

The paper suggests to train more on situations in which a policy does badly (section V-C). Situations overlap, so an
example cannot be drawn for one of them alone; odds are found by iterative proportional fitting (Deming & Stephan 1940):
each turn scales the odds of an example by how much its situations are short of an equal share.
"""

import numpy as np

TURNS = 500


def odds(situations: np.ndarray) -> np.ndarray:
    """(R,) float32 that add up to one, for examples with these situations (R, S) bool.

    An example in several situations is shared equally by them. Examples in none keep the share that they have, and what
    never occurs is left out.
    """
    held = np.asarray(situations, np.float64)
    number = held.sum(1)
    some = number > 0
    if not some.any():
        return np.full(len(held), 1 / len(held), np.float32)
    shared = held[some][:, held.any(0)] / number[some][:, None]
    found = np.ones(len(shared))
    for _ in range(TURNS):
        share = found @ shared
        found = found * (shared @ (1.0 / np.maximum(share, 1e-12)))
        found = found / found.sum()
    whole = np.full(len(held), 1.0 / len(held))
    whole[some] = found * some.mean()
    return (whole / whole.sum()).astype(np.float32)
