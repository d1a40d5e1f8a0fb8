"""Crowd speed: agent-steps per second of the social force step, beside a float64 numpy loop of the same law.

python benchmarks/crowd.py                        (1, 62), (256, 62) and (1, 1000) people, open and with walls
python benchmarks/crowd.py --sizes 8192x62        any B x N
"""

import argparse
import resource
import time
from dataclasses import replace

import crowd_loop
import jax
import jax.numpy as jnp
import numpy as np
import workload

from sean_jax import social_forces

STEP = 0.05  # s


def timed(call, repeats: int = 5) -> float:
    """Median wall seconds of a call that has run once before."""
    spent = []
    for _ in range(repeats):
        begun = time.perf_counter()
        jax.block_until_ready(call())
        spent.append(time.perf_counter() - begun)
    return float(np.median(spent))


def batch_of(people, size: int):
    """The crowd repeated ``size`` times, each copy's velocities turned a little so that no two are alike."""
    angle = jnp.linspace(0.0, 0.3, size, dtype=jnp.float32)
    cosine, sine = jnp.cos(angle)[:, None], jnp.sin(angle)[:, None]
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (size, *leaf.shape)), people)
    vx, vy = many.velocity[..., 0], many.velocity[..., 1]
    return replace(many, velocity=jnp.stack([cosine * vx - sine * vy, sine * vx + cosine * vy], -1))


def measure(batch: int, people: int, walls: int, preset: str) -> dict:
    """Speed, compile time and peak temporary memory of one size."""
    parameters = social_forces.preset(preset)
    crowd, nearby, _ = workload.crowd(people, walls)
    steps = int(np.clip(4e8 / (batch * people * (people + walls)), 50, 1000))  # fewer would time the dispatch

    def run(many):
        def step(carry, _):
            one = lambda p: social_forces.advance(parameters, p, nearby, None, None, STEP)  # noqa: E731
            return jax.vmap(one)(carry), None

        return jax.lax.scan(step, many, length=steps)[0]

    many = batch_of(crowd, batch)
    begun = time.perf_counter()
    compiled = jax.jit(run).lower(many).compile()
    compile_seconds = time.perf_counter() - begun
    jax.block_until_ready(compiled(many))
    seconds = timed(lambda: compiled(many))
    memory = compiled.memory_analysis()
    return dict(
        rate=batch * people * steps / seconds,
        microseconds=1e6 * seconds / steps,
        compile=compile_seconds,
        temporary=getattr(memory, "temp_size_in_bytes", 0) / 2**20,
    )


def loop(people: int, walls: int, preset: str, steps: int = 2) -> float:
    """Agent-steps per second of the float64 loop."""
    p, law, state, boxes = exact(people, walls, preset)
    begun = time.perf_counter()
    for _ in range(steps):
        state = crowd_loop.step(*state, boxes, p, law, STEP) + state[3:]
    return people * steps / (time.perf_counter() - begun)


def exact(people: int, walls: int, preset: str):
    """Constants, sight law, state and boxes of the workload in float64."""
    parameters = social_forces.preset(preset)
    laws = ("repulsion", "sight")
    p = {k: None if v is None else float(v) for k, v in vars(parameters).items() if k not in laws}
    e = workload.crowd(people, walls)[2]
    state = e["x"], e["v"], e["heading"], e["desired"], e["preferred"]
    return p, parameters.sight.__name__, state, (e["center"], e["half"], e["yaw"])


def errors(people: int, walls: int, preset: str, steps: int) -> float:
    """Relative error of positions and velocities against the loop after that many steps."""
    p, law, state, boxes = exact(people, walls, preset)
    crowd, nearby, _ = workload.crowd(people, walls)
    parameters = social_forces.preset(preset)
    advance = jax.jit(lambda c: social_forces.advance(parameters, c, nearby, None, None, STEP))
    for _ in range(steps):
        state = crowd_loop.step(*state, boxes, p, law, STEP) + state[3:]
        crowd = advance(crowd)
    ours = np.concatenate([crowd.position, crowd.velocity])
    theirs = np.concatenate(state[:2])
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--sizes", nargs="+", default=["1x62", "256x62", "1x1000"], metavar="BxN")
    arguments.add_argument("--walls", nargs="+", type=int, default=[0, 32])
    arguments.add_argument("--presets", nargs="+", default=["helbing1995", "sean2"])
    arguments.add_argument("--no-loop", action="store_true", help="leave out the float64 loop")
    chosen = arguments.parse_args()
    print(f"{jax.devices()[0].device_kind}, jax {jax.__version__}, step {STEP} s")
    print(f"{'preset':>13} {'B':>6} {'N':>6} {'walls':>5} {'agent-steps/s':>14} {'us/step':>10} "
          f"{'compile s':>9} {'temp MiB':>9} {'loop /s':>9} {'error 1':>9} {'error 20':>9}")  # fmt: skip
    for preset in chosen.presets:
        for size in chosen.sizes:
            batch, people = (int(part) for part in size.split("x"))
            for walls in chosen.walls:
                row = measure(batch, people, walls, preset)
                extra = f"{'-':>9} {'-':>9} {'-':>9}"
                if not chosen.no_loop and batch == 1:
                    twenty = f"{errors(people, walls, preset, 20):9.1e}" if people <= 100 else f"{'-':>9}"
                    extra = f"{loop(people, walls, preset):9.3g} {errors(people, walls, preset, 1):9.1e} {twenty}"
                print(f"{preset:>13} {batch:6d} {people:6d} {walls:5d} {row['rate']:14.3g} {row['microseconds']:10.1f} "
                      f"{row['compile']:9.2f} {row['temporary']:9.1f} {extra}", flush=True)  # fmt: skip
    print(f"peak resident memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
