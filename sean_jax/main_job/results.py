"""What a run found, episode by episode."""

import dataclasses

import numpy as np

from sean_jax.base import Frame


@dataclasses.dataclass
class Results:
    """Everything that a run knows, as numpy arrays; E episodes, S situations."""

    situations: tuple[str, ...]
    tasks: list[str]  # per episode
    completed: np.ndarray  # (E,) bool
    timed_out: np.ndarray  # (E,) bool
    seconds: np.ndarray  # (E,) s, until the episode ended
    metrics: dict[str, np.ndarray]  # name -> (E,) or (E, 1 + S): overall, then by situation
    counts: tuple[str, ...]  # the metrics that count events
    heat: np.ndarray  # (rows, columns) s that people spent in each cell
    walks: np.ndarray  # (M, M) people who walked the edge from the row's node to the column's, (0, 0) without a graph
    together: np.ndarray  # (2 ** S,) s of robot time per set of situations
    penetration: float  # m
    group_size: np.ndarray  # (G,) most members
    frames: list[Frame]  # of the first episodes, (T, ...) each
    compile_seconds: float
    run_seconds: float
    wanted: int  # episodes asked for; fewer are here after Ctrl-C
