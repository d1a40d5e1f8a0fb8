"""Other crowd simulators and sean_jax, with the same people, walls and steps: agent-steps per core-second.

pip install -e ".[peers]"; others: benchmarks/README.md
python benchmarks/peers.py                                   all installed simulators, 62 and 1000 people
python benchmarks/peers.py --people 62 --simulator my_peer.py   with your own (see peer_simulators.py)

The hall is from ``workload.py``, open or with an outer wall and eight shelves; people are discs of 0.3 m, steps last
0.01 s. A core-second is one second of one core: many cores bring no gain, and other programs on the machine no loss.
This project's crowds are ``helbing1995``, B at once; large ones look for neighbors every ten steps. Its ORCA stands
beside RVO2.
"""

import dataclasses
import importlib.util
import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import peer_simulators
from options import Option, parse
from peer_simulators import Peer
from timing import device, stopwatch, write_json

import sean_jax
from sean_jax import social_forces
from sean_jax.cli.bench import workload
from sean_jax.core.data_types import Obstacles
from sean_jax.core.geometry import build_obstacle_grid
from sean_jax.social_forces import model

STEP = 0.01  # s
RADIUS = 0.3  # m
SHELVES = 8
MOST = 1000  # steps from the start; later people have passed one another and left the hall


@dataclasses.dataclass(frozen=True)
class Hall:
    """The scene of every simulator."""

    starts: np.ndarray  # (N, 2) m
    goals: np.ndarray  # (N, 2) m
    speeds: np.ndarray  # (N,) m/s
    half: float  # m, half the side of the outer walls
    rings: list  # of each shelf four corners, (x, y) m; none in the open
    radius: float = RADIUS
    time_step: float = STEP

    @property
    def outline(self) -> list:
        """Four corners of the outer walls."""
        return [(-self.half, -self.half), (self.half, -self.half), (self.half, self.half), (-self.half, self.half)]

    @property
    def segments(self) -> list:
        """All walls as pairs of points; none in the open."""
        rings = [self.outline, *self.rings] if self.rings else []
        return [(ring[k], ring[(k + 1) % 4]) for ring in rings for k in range(4)]


def hall(people: int, walls: bool) -> Hall:
    """The hall for a number of people."""
    center, half, yaw = workload.boxes(people, 4 + SHELVES)
    exact = workload.crowd(people, 4 + SHELVES)[2]
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    rings = []
    for c, h, a in zip(center[4:], half[4:], yaw[4:], strict=True):
        turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        rings.append([tuple(c + (h * sign) @ turn) for sign in corner])
    goals = -exact["x"]
    reach = np.sqrt((half[4:] ** 2).sum(-1)) + 0.5
    for _ in range(100):  # goals inside a shelf move to the middle until they are free
        inside = (np.linalg.norm(goals[:, None] - center[None, 4:], axis=-1) < reach[None]).any(1)
        goals = np.where(inside[:, None], 0.95 * goals, goals)
    return Hall(exact["x"], goals, exact["preferred"], workload.side(people) / 2 + 1.0, rings if walls else [])


def ours(people: int, walls: bool, batch: int, steps: int) -> Callable[[], Callable[[int], None]]:
    """This project's crowd; ``advance`` takes ``steps`` steps, a multiple of ten."""
    parameters = social_forces.preset("helbing1995").tree_replace({"walking.radius": RADIUS})
    many, grid, _ = workload.crowd(people, 4 + SHELVES)
    many = workload.repeat(many, batch)

    def ten(people):
        near = model.neighbors(parameters, people, 10 * STEP)

        def one(people, _):
            walls_near = grid if walls else None
            return social_forces.integrate(parameters, people, walls_near, None, None, STEP, near=near), None

        return jax.lax.scan(one, people, length=10)[0]

    run = jax.jit(lambda many: jax.lax.scan(lambda c, _: (jax.vmap(ten)(c), None), many, length=steps // 10)[0])
    return lambda: lambda _: jax.block_until_ready(run(many))


def our_orca(people: int, walls: bool, batch: int, steps: int) -> Callable[[], Callable[[int], None]]:
    """This project's ORCA; ``advance`` takes ``steps`` steps."""
    many, grid, _ = workload.crowd(people, 4 + SHELVES)
    if not walls:
        nothing = Obstacles(jnp.zeros((0, 2)), jnp.zeros((0, 2)), jnp.zeros(0), jnp.zeros(0))
        grid = build_obstacle_grid(nothing, jnp.asarray([-1.0, -1.0, 1.0, 1.0]))
    lab = sean_jax.make("lab", model="orca", people=1)
    scenario = dataclasses.replace(
        lab, environment=dataclasses.replace(lab.environment, obstacle_grid=grid), time_step=STEP,
        forces=lab.forces.tree_replace({"walking.radius": RADIUS}),
    )  # fmt: skip
    state = sean_jax.reset(scenario, jax.random.key(0))
    state = dataclasses.replace(state, robot=dataclasses.replace(state.robot, position=jnp.asarray([1e4, 1e4])))
    many = workload.repeat(many, batch)

    def one(people):
        return scenario.move(scenario, dataclasses.replace(state, pedestrians=people))

    run = jax.jit(lambda many: jax.lax.scan(lambda c, _: (jax.vmap(one)(c), None), many, length=steps)[0])
    return lambda: lambda _: jax.block_until_ready(run(many))


def rate(begin: Callable, agents: int, steps: int, repeats: int) -> float:
    """Best agent-steps per core-second."""
    begin()(steps)
    best = 0.0
    for _ in range(repeats):
        advance = begin()
        with stopwatch(time.process_time) as watch:
            advance(steps)
        best = max(best, agents * steps / max(watch.seconds, 1e-9))
    return best


def enough(begin: Callable, seconds: float) -> int:
    """The number of steps for about this time, ``MOST`` at most."""
    steps = 1
    while True:
        advance = begin()
        with stopwatch() as watch:
            advance(steps)
        if watch.seconds > 0.3 * seconds or steps >= MOST:
            return max(1, min(MOST, int(steps * seconds / max(watch.seconds, 1e-9))))
        steps *= 4


def installed(files: list[str]) -> dict[str, Peer]:
    """The simulators that can be imported, and the simulators of the files; says which are missing."""
    simulators = {}
    for name, peer in peer_simulators.SIMULATORS.items():
        if importlib.util.find_spec(peer.module):
            simulators[name] = peer
        elif peer.crowds == 1:
            print(f"{name}: not installed; {peer.install}")
    for file in files:
        spec = importlib.util.spec_from_file_location(Path(file).stem, file)
        if spec is None or spec.loader is None or not Path(file).is_file():
            raise SystemExit(f"--simulator: {file} is no Python file; give one with a function named simulator.")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        simulators[Path(file).stem] = Peer(module.simulator)
    return simulators


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        people=[62, 1000],
        batches=Option([1, 256], "of this project's crowds"),
        simulator=Option([], "your own simulator", metavar="FILE"),
        repeats=5,
        seconds=Option(1.0, "for each repeat"),
        json=Option(None, "file to write the figures to", kind=Path),
    )
    peers = installed(chosen.simulator)
    print(f"{device()}; peers: {', '.join(peers) or 'none installed'}")
    print(f"{'hall':>6} {'N':>6}  {'simulator':<22} {'agent-steps per core-second':>28} {'ours are faster by':>19}")
    rows: list[dict] = []
    for walls in (False, True):
        for people in chosen.people:
            scene = "walls" if walls else "open"
            best = {
                "social forces": measure_ours(chosen, rows, scene, people, "sean_jax", ours, 100),
                "orca": measure_ours(chosen, rows, scene, people, "sean_jax orca", our_orca, 10),
            }
            for name, peer in peers.items():
                try:
                    begin, _ = peer.run(hall(people, walls))
                    value = rate(begin, peer.crowds * people, enough(begin, chosen.seconds), chosen.repeats)
                    share = f"{best[peer.law] / value:18.3g}x" if peer.law else ""
                    show(rows, scene, people, name, value, share)
                except Exception as error:  # a failed simulator must not hide the others
                    print(f"{scene:>6} {people:6d}  {name:<22} failed: {str(error)[:80]}")
    if chosen.json:
        write_json(chosen.json, {"device": jax.devices()[0].device_kind, "jax": jax.__version__, "rows": rows})


def show(rows: list[dict], scene: str, people: int, name: str, value: float, share: str = "") -> None:
    """Print a row, and keep it."""
    print(f"{scene:>6} {people:6d}  {name:<22} {value:28.3g} {share}", flush=True)
    rows.append(dict(hall=scene, people=people, simulator=name, rate=value))


def measure_ours(
    chosen: Namespace, rows: list[dict], scene: str, people: int, name: str, simulator: Callable, most: int
) -> float:
    """Show the rates of this project's crowds by batch; returns the best. ``most`` is a tenth of the most steps."""
    best = 0.0
    for batch in chosen.batches:
        if batch * people > 20_000:
            continue
        steps = 10 * int(np.clip(200 * most / (batch * people), 1, most))
        value = rate(simulator(people, scene == "walls", batch, steps), batch * people, steps, chosen.repeats)
        best = max(best, value)
        show(rows, scene, people, f"{name}, B = {batch}", value)
    return best


if __name__ == "__main__":
    main()
