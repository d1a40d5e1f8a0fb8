"""Ten simulated minutes of each environment and behavior: people who overlap obstacles or people, or are stuck.

    python benchmarks/ten_minutes.py [--environments warehouse] [--behaviors graph] [--minutes 10] [--seed 0]

"overlaps" is the share of person-steps with the center of another person nearer than 0.3 m, "stuck" the share of
person-time that ends 20 s in which the person moved less than 0.05 m. Both leave out standing members of groups.
"""

import jax
import numpy as np
from options import parse

import sean_jax
from sean_jax.core.data_types import Array, Scenario, State
from sean_jax.people.behaviors import BEHAVIORS
from sean_jax.policies import go_to_goal
from sean_jax.world.environment import available, clearance

OVERLAP_DISTANCE = 0.3  # m between the centers of two people who overlap
STUCK_DISTANCE = 0.05  # m: people who move less than this in ...
WINDOW = 20.0  # s, are stuck


def record(before: State, after: State, action: Array) -> tuple[Array, Array, Array, Array]:
    """Positions, groups and presence of people, and the robot's position."""
    people = after.pedestrians
    return people.position, people.group, people.present, after.robot.position


def conduct(scenario: Scenario, minutes: float, seed: int = 0) -> dict[str, float]:
    """Measurements of a run of a scenario with the go_to_goal robot: clearance [m], and shares between 0 and 1."""
    steps = round(60 * minutes / scenario.time_step)
    run = jax.jit(lambda key: sean_jax.rollout(scenario, go_to_goal, key, steps, record)[1])
    position, group, present, robot = (np.asarray(part) for part in run(jax.random.key(seed)))
    gaps = jax.jit(lambda rows: jax.lax.map(lambda row: clearance(scenario.environment, row), rows, batch_size=64))
    to_obstacle = np.asarray(gaps(position))[present]
    walking = present & (group < 0)
    to_robot = np.linalg.norm(position - robot[:, None], axis=-1)[present]
    return {
        "people": float(present.sum(1).mean()),
        "clearance": float(to_obstacle.min()),
        "inside": float((to_obstacle <= 0).mean()),
        "overlaps": overlaps(position, present, walking) / max(int(walking.sum()), 1),
        "stuck": stuck(position, walking, round(WINDOW / scenario.time_step)),
        "grouped": float((present & (group >= 0)).sum() / present.sum()),
        "robot": float(to_robot.min()),
    }


def overlaps(position: np.ndarray, present: np.ndarray, walking: np.ndarray) -> int:
    """The number of steps of walking people with somebody nearer than ``OVERLAP_DISTANCE``."""
    number = 0
    for places, visible, walks in zip(position, present, walking, strict=True):
        gap = np.linalg.norm(places[:, None] - places[None], axis=-1)
        gap[np.eye(len(gap), dtype=bool) | ~visible[None, :] | ~visible[:, None]] = np.inf
        number += int((gap.min(1) < OVERLAP_DISTANCE)[walks].sum())
    return number


def stuck(position: np.ndarray, walking: np.ndarray, window: int) -> float:
    """The share of windows (in steps), of people who walk throughout, in which they hardly move."""
    still = np.linalg.norm(position[window:] - position[:-window], axis=-1) < STUCK_DISTANCE
    steps_walked = np.cumsum(np.concatenate([np.zeros((1, walking.shape[1]), int), walking]), 0)
    throughout = steps_walked[window + 1 :] - steps_walked[: -window - 1] == window
    throughout &= walking[:-window]
    return float(still[throughout].mean()) if throughout.any() else 0.0


def main() -> None:
    """Print the table."""
    options = parse(
        __doc__,
        environments=sorted(available()),
        behaviors=[name for name in BEHAVIORS if name != "playback"],
        minutes=10.0,
        seed=0,
    )
    columns = ("environment", "behavior", "people", "minimum clearance m", "inside %", "overlaps %", "stuck %")
    columns += ("in groups %", "nearest to robot m")
    print("| " + " | ".join(columns) + " |\n" + "|---" * len(columns) + "|")
    for environment in options.environments:
        for behavior in options.behaviors:
            scenario = sean_jax.make(environment, behavior=behavior, task="random_ab_nav")
            figures = conduct(scenario, options.minutes, options.seed)
            shares = " | ".join(f"{100 * figures[name]:.3f}" for name in ("inside", "overlaps", "stuck", "grouped"))
            print(
                f"| {environment} | {behavior} | {figures['people']:.1f} | {figures['clearance']:.3f} | {shares} "
                f"| {figures['robot']:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
