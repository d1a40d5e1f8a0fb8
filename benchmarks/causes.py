"""Causes of orderings of Table I and Figure 4 that do not hold here (section V): behavior of people and robots.

    python benchmarks/causes.py --table1 runs/table1 --figure4 runs/figure4   # their parts, and all below
    python benchmarks/causes.py --only crowds groups stacks facing            # people, groups, the navigation stack

All figures are for 62 people in the warehouse, except handcrafted sets. Compared runs have equal keys.
"""

import argparse
import functools
import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from options import Option, parse
from timing import device

import sean_jax
from sean_jax.classifiers import SITUATIONS
from sean_jax.core.data_types import Policy, PolicyLike, Scenario, State, as_policy
from sean_jax.metrics import METRICS
from sean_jax.policies import POLICIES, social_costmap
from sean_jax.policies.ros_move_base import default_params
from sean_jax.simulation.episodes import init_policy, simulate
from sean_jax.simulation.making import with_task
from sean_jax.tasks import TASKS
from sean_jax.world import environment

NEAR, SLOW = 2.4, 0.05  # m, D of the paper; m/s, below which a robot stands
METRICS_USED = tuple(
    (n, METRICS[n]) for n in ("time_not_moving", "intimate_robot_on_person", "intimate_person_on_robot")
)


def recorder(scenario: Scenario) -> Callable:
    """The function for the record of a step."""

    def record(before: State, after: State, action: jax.Array) -> dict[str, jax.Array]:
        robot, people = after.robot, after.pedestrians
        gap = jnp.where(people.present[:, None], people.position - robot.position, 1e3)
        speed = jnp.sqrt((people.velocity**2).sum(1))
        goal = after.task.goal - robot.position
        return {
            "active": ~(before.completed | before.timed_out),
            "speeds": jnp.where(people.present, speed, jnp.nan),
            "distance": jnp.sqrt((gap**2).sum(1)),
            "along": (people.velocity * robot.heading).sum(1) / jnp.maximum(speed, 1e-6),
            "situations": after.situations,
            "robot": jnp.abs(robot.speed),
            "pose": jnp.concatenate([robot.position, robot.heading]),
            "command": action,
            "gap": environment.clearance(scenario.environment, robot.position[None])[0] - scenario.robot.radius,
            "to_goal": jnp.sqrt((goal**2).sum()),
        }

    return record


def drive(scenario: Scenario, policy: PolicyLike, episodes: int, seconds: float, seed: int) -> tuple[dict, dict]:
    """(E, T, ...) records of each step, and (E,) results. Tasks and parameters share the compiled program."""
    scenario, policy = replace(scenario, metrics=METRICS_USED), as_policy(policy)
    keys = jax.random.split(jax.random.key(seed), episodes)
    starts = jax.jit(jax.vmap(sean_jax.reset, in_axes=(None, 0)))(scenario, keys)
    same = replace(scenario, task=TASKS["random_ab_nav"], task_name="")  # no step reads them
    frames, results = _episodes(same, policy, starts, round(seconds / scenario.time_step))
    return jax.tree.map(np.asarray, (frames, results))


@functools.partial(jax.jit, static_argnums=3)
def _episodes(scenario: Scenario, policy: Policy, starts: State, steps: int) -> tuple:
    def one(state: State) -> tuple:
        state, record = init_policy(scenario, policy, state), recorder(scenario)
        last, frames = simulate(scenario, policy, state, steps, record)
        return frames, sean_jax.results(scenario, last) | {"completed": last.completed}

    return jax.vmap(one)(starts)


def over_all(values: np.ndarray) -> np.ndarray:
    """(E,) of (E,) or (E, 1 + S)."""
    return values.reshape(len(values), -1)[:, 0]


def mean(values: np.ndarray, digits: int = 2) -> str:
    """A mean over episodes with twice its standard error."""
    return f"{np.mean(values):.{digits}f} +- {2 * np.std(values) / len(values) ** 0.5:.{digits}f}"


def crowds(options: argparse.Namespace) -> None:
    """Speeds of people, their number near the navigation stack, their approach to it, and the free floor."""
    for behavior, task in (("random", "random_ab_nav"), ("graph", "join_group"), ("graph", "leave_group")):
        scenario = sean_jax.make("warehouse", behavior=behavior, task=task)
        floor = np.random.default_rng(0).uniform(-20, 20, (20000, 2)).astype(np.float32)
        room = np.asarray(jax.jit(environment.clearance)(scenario.environment, jnp.asarray(floor)))
        frames, _ = drive(scenario, social_costmap, options.episodes, 120.0, options.seed)
        print(f"\n{behavior}, {task}: free floor {1600 * (room > 0.2).mean():.0f} m2, {scenario.people} people")

        active = frames["active"]
        speeds, near = frames["speeds"][active], frames["distance"][active] < NEAR
        walk = speeds > 0.4
        faster = ", ".join(f"{speed} m/s {percent(speeds > speed):.1f} %" for speed in (1.4, 1.2, 1.0, 0.4))
        print(f"  walk faster than {faster}")
        print(
            f"  within 2.4 m of the robot: {near.sum(1).mean():.2f} people, {(near & walk).sum(1).mean():.2f} walk; "
            f"nobody {percent(~near.any(1)):.1f} % of {0.1 * active.sum(1).mean():.1f} s"
        )
        for limit in (1.2, 0.45):
            print_approaches(frames, limit)


def print_approaches(frames: dict[str, np.ndarray], limit: float) -> None:
    """Print how people came within a distance [m] of the robot."""
    active = frames["active"]
    near = frames["distance"] <= limit
    entered = near[:, 1:] & ~near[:, :-1] & active[:, 1:, None]  # (E, T - 1, N)
    along, walks = frames["along"][:, 1:][entered], frames["speeds"][:, 1:][entered] > 0.4
    narrow = np.broadcast_to(frames["gap"][:, 1:, None] < 0.5, entered.shape)[entered]
    print(
        f"  came within {limit} m: {entered.sum() / len(active):.2f} an episode; walking against the robot "
        f"{percent(walks & (along < -0.7)):.0f} %, across {percent(walks & (abs(along) <= 0.7)):.0f} %, along "
        f"{percent(walks & (along > 0.7)):.0f} %; obstacle within 0.5 m {percent(narrow):.0f} %",
        flush=True,
    )


def percent(flags: np.ndarray) -> float:
    """The share of flags that are set, in percent."""
    return 100 * float(np.mean(flags))


def groups(options: argparse.Namespace) -> None:
    """Join and leave group: time of the robot near the group, and its speed."""
    join = sean_jax.make("warehouse", behavior="graph", task="join_group")
    names = list(SITUATIONS)
    heads = f"{'episodes':>9} {'never %':>8} {'s near':>8} {'m/s there':>10} {'s in all':>9} {'at obstacle %':>14}"
    print(f"\n{'near the group':28} {heads}")
    for name in ("expert", "go_to_goal", "social_costmap"):
        for task in ("join_group", "leave_group"):
            scenario = with_task(join, task)
            frames, _ = drive(scenario, POLICIES[name], options.episodes, 120.0, options.seed)
            active = frames["active"]
            near = frames["situations"][..., names.index(task)] & active
            seconds = 0.1 * near.sum(1)
            print(f"{name + ', ' + task:28} {len(near):9d} {100 * (seconds == 0).mean():8.1f} {seconds.mean():8.2f} "
                  f"{frames['robot'][near].mean():10.2f} {0.1 * active.sum(1).mean():9.1f} "
                  f"{100 * (frames['gap'][active] < 0.1).mean():14.2f}", flush=True)  # fmt: skip


def stacks(options: argparse.Namespace) -> None:
    """The navigation stack among people who give way to it, and among people who ignore it."""
    scenario = sean_jax.make("warehouse", behavior="graph", task="join_group")
    tiny = jnp.asarray(1e-3, jnp.float32)
    forces = scenario.forces.tree_replace({"robot_repulsion.factor_min": tiny, "robot_repulsion.factor_max": tiny})
    blind = replace(scenario, forces=forces)
    wide = replace(social_costmap, params=default_params(covariance=0.25))
    print()
    for name, place, policy in (
        ("N", scenario, social_costmap),
        ("N, people do not mind it", blind, social_costmap),
        ("N, covariance 0.25 m2", scenario, wide),
        ("N, both", blind, wide),
    ):
        _, results = drive(place, policy, options.episodes, 120.0, options.seed)
        harm = over_all(results["intimate_robot_on_person"] + results["intimate_person_on_robot"])
        print(f"{name:26} stands {mean(over_all(results['time_not_moving']))} s, completed "
              f"{100 * results['completed'].mean():.1f} %, violations {mean(harm)}", flush=True)  # fmt: skip


def facing(options: argparse.Namespace) -> None:
    """Violations in cross path and down path, with down path as in the paper and as in SEAN's code."""
    print()
    for situations in ("paper", "sean2"):
        scenario = sean_jax.make("warehouse", behavior="graph", task="join_group", situations=situations)
        frames, results = drive(scenario, social_costmap, options.episodes, 120.0, options.seed)
        harm = (results["intimate_robot_on_person"] + results["intimate_person_on_robot"]).sum(0)
        shared = " ".join(
            f"{name} {100 * violations / harm[0]:.0f} %" for name, violations in zip(SITUATIONS, harm[1:], strict=True)
        )
        none = ~frames["situations"][frames["active"]].any(1)
        print(f"{situations}: {harm[0]:.0f} violations of N, in {shared}; in no situation {100 * none.mean():.1f} % "
              "of the time", flush=True)  # fmt: skip


def standing(options: argparse.Namespace) -> None:
    """Places where learned policies stand still, and their commands there."""
    from sean_jax import learning

    join = sean_jax.make("warehouse", behavior="graph", task="join_group")
    names = "graph", "random", "handcrafted", "graph-balanced"
    for task, name in itertools.product(("join_group", "leave_group"), names):
        scenario = with_task(join, task)
        policy = replace(learning.load(options.figure4 / f"policy-{name}-0-0", scenario), name="learned")
        frames, results = drive(scenario, policy, options.episodes, 120.0, options.seed)
        done = results["completed"]
        still = (frames["robot"] < SLOW) & frames["active"]
        print(
            f"\n{name}, {task}: completed {done.sum()} of {len(done)}; seconds slower than {SLOW} m/s: "
            f"{0.1 * still[done].sum(1).mean():.1f} of those, {0.1 * still[~done].sum(1).mean():.1f} of others"
        )
        lasting = still & ~done[:, None]  # of robots that never arrive
        if lasting.any():
            print_standing(scenario, frames, lasting)


def print_standing(scenario: Scenario, frames: dict[str, np.ndarray], lasting: np.ndarray) -> None:
    """Print where robots stand and what their policies command there, at steps (E, T) of robots that never arrive."""
    person, gap = frames["distance"].min(2)[lasting], frames["gap"][lasting]
    command = np.abs(frames["command"][lasting])
    print(
        f"  others stand: {percent(gap < 0.1):.0f} % within 0.1 m of an obstacle, "
        f"{percent(person < 1.2):.0f} % within 1.2 m of a person, "
        f"{percent((gap >= 0.1) & (person >= 1.2)):.0f} % with neither"
    )
    print(
        f"  command there: {np.median(command[:, 0]):.3f} m/s, {np.median(command[:, 1]):.3f} rad/s in the "
        f"median; {percent(command[:, 0] > 0.1):.0f} % above 0.1 m/s (it pushes)"
    )

    at_end = lasting[:, -50:].all(1)  # stand for 5 s
    side, height = _touched(scenario, frames["pose"][at_end, -1])
    distance = np.median(np.round(frames["to_goal"][at_end, -1], 1))
    print(
        f"  at the end {at_end.sum()} stand: goal at {distance:.1f} m in the median, the obstacle within 10 degrees of "
        f"ahead in {percent(np.round(side) <= 10.0):.0f} %, lower than 1 m in {percent(height < 1.0):.0f} %",
        flush=True,
    )


def _touched(scenario: Scenario, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direction of the nearest obstacle of each pose (E, 4), in degrees from ahead, and its height [m]."""
    boxes = scenario.environment.obstacles
    center, half, yaw = (np.asarray(array) for array in (boxes.center, boxes.half_extent, boxes.yaw))
    axes = np.stack([np.stack([np.cos(yaw), np.sin(yaw)], -1), np.stack([-np.sin(yaw), np.cos(yaw)], -1)], -2)
    local = np.einsum("wij,ewj->ewi", axes, poses[:, None, :2] - center)
    away = np.einsum("wij,ewi->ewj", axes, np.clip(local, -half, half) - local)
    nearest = np.linalg.norm(away, axis=-1).argmin(1)
    to = away[np.arange(len(poses)), nearest]
    turned = np.arctan2(to[:, 1], to[:, 0]) - np.arctan2(poses[:, 3], poses[:, 2])
    return np.abs(np.rad2deg((turned + np.pi) % (2 * np.pi) - np.pi)), np.asarray(boxes.height)[nearest]


def _streams(behavior: str) -> list[str]:
    """The parts of the protocol, in the order of the experiments."""
    if behavior != "handcrafted":
        return {"random": ["random_ab_nav"], "graph": ["join_group", "leave_group"]}[behavior]
    return list(dict.fromkeys(sean_jax.make("warehouse", behavior=behavior, task=behavior).behavior.data.situations))


def fifths(options: argparse.Namespace) -> None:
    """Table I by part of the protocol: shares in percent; an example in several situations counts for each in part."""
    print(f"\n{'Table I':46} {' '.join(f'{name:>11}' for name in SITUATIONS)} {'none':>11}")
    for behavior in ("handcrafted", "graph"):
        names = _streams(behavior)
        for policy in ("go_to_goal", "social_costmap", "expert"):
            with np.load(options.table1 / f"{behavior}-{policy}.npz") as arrays:
                flags = np.unpackbits(arrays["flags"], axis=-1, count=len(SITUATIONS)).astype(bool)[0]
            for name, part in zip(names, np.split(flags, len(names)), strict=True):
                number = part.sum(-1, keepdims=True)
                values = [*(part / np.maximum(number, 1)).mean((0, 1)), (number == 0).mean()]
                cells = " ".join(f"{100 * value:11.1f}" for value in values)
                print(f"{f'{behavior}, {policy}, {name}':46} {cells}")


def episodes(options: argparse.Namespace) -> None:
    """Figure 4 by part of the protocol: episodes that were not completed, and violations per minute."""
    print(f"\n{'Figure 4':34} {'not completed':>14} {'their s still':>13} {'violations/min':>15}")
    for file in sorted(options.figure4.glob("episodes-*.json")):
        policy, behavior = file.stem.removeprefix("episodes-").rsplit("-", 1)
        figures = {name: np.array(values) for name, values in json.loads(file.read_text(encoding="utf-8")).items()}
        harm = figures["intimate_robot_on_person"] + figures["intimate_person_on_robot"]
        late, still = figures["completed"] == 0, over_all(figures["time_not_moving"])
        names = _streams(behavior)
        apart = 100 * still[late].sum() / still.sum()
        print(f"{policy}, {behavior}: {apart:.0f} % of the time not moving is in episodes that were not completed")
        for k, name in enumerate(names):
            chosen = slice(k, None, len(names))
            not_done, seconds = late[chosen], still[chosen]
            mean = seconds[not_done].mean() if not_done.any() else 0
            rate = 60 * harm[chosen, 0].sum() / figures["seconds"][chosen].sum()
            print(f"{f'  {name}':34} {f'{not_done.sum()} of {not_done.size}':>14} {mean:13.1f} {rate:15.2f}")


def main() -> None:
    """Print all."""
    needs = {fifths: "table1", episodes: "figure4", standing: "figure4"}
    parts = {part.__name__: part for part in (fifths, episodes, crowds, groups, stacks, facing, standing)}
    options = parse(
        __doc__,
        episodes=64,
        seed=1,
        table1=Option(None, "folder of sean experiment table1", kind=Path),
        figure4=Option(None, "folder of sean experiment figure4, with its policies", kind=Path),
        only=Option(list(parts), choices=list(parts)),
    )
    print(f"{device()}, {options.episodes} episodes, seed {options.seed}")
    for name, part in parts.items():
        if name in options.only and (part not in needs or getattr(options, needs[part])):
            part(options)


if __name__ == "__main__":
    main()
