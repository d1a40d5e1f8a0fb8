"""Steps with depth images on a GPU, by the kernel and by loops of XLA, on an idle and on a busy host.

    python benchmarks/rays_on_host.py                      # on a GPU, about two minutes
    python benchmarks/rays_on_host.py --batches 2 --seconds 0.1

Loops of XLA end on the host, so they wait for it: a busy host has one process on each of its cores that computes
without results. Before that, the images of both forms are compared.
"""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from options import Option, parse
from timing import Stopwatch, device, stopwatch

import sean_jax
from sean_jax import sensors
from sean_jax.cli import bench
from sean_jax.cli.bench import programs
from sean_jax.cli.bench.programs import Program
from sean_jax.core import gpu_kernels
from sean_jax.simulation.scenario_stack import Stack

FORMS = "loops", "kernel"
COMPARED = 256  # scenarios whose images are compared


def choose(form: str) -> None:
    """Use this form of rays on a GPU in all programs traced from now on."""
    jax.clear_caches()
    gpu_kernels.available = lambda: form == "kernel"


@contextlib.contextmanager
def busy_host() -> Iterator[int]:
    """Every core of this process also runs another process."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    others = [subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"]) for _ in range(cores)]
    try:
        time.sleep(0.5)  # until they run
        yield cores
    finally:
        for other in others:
            other.kill()
            other.wait()


def compare(scenario: Any) -> None:
    """Print the difference of the images of the two forms."""
    camera = sensors.camera(scenario, "depth", width=bench.IMAGE[0], height=bench.IMAGE[1])
    keys = jax.random.split(jax.random.key(0), COMPARED)
    states = jax.jit(jax.vmap(sean_jax.reset, (None, 0)))(scenario, keys)
    images = []
    for form in FORMS:
        choose(form)
        images.append(np.asarray(jax.jit(jax.vmap(lambda state: sensors.depth(scenario, state, camera)))(states)))
    apart = np.abs(images[0] - images[1])
    print(
        f"{COMPARED} images: {100 * (apart == 0).mean():.3f} % of the pixels are equal to the bit, "
        f"{(apart > 1e-4 * images[0]).sum()} of {apart.size} differ by more than 1e-4 of themselves, "
        f"at most {apart.max():.2g} m; {100 * (images[0] < camera.far).mean():.0f} % see something",
        flush=True,
    )


def steps_per_second(run: Callable, program: Program, carried: Any, seconds: float) -> tuple[float, Any]:
    """Median of five timings, and the state for the next call."""
    carried = jax.block_until_ready(run(*program.fixed, carried))
    with stopwatch() as watch:
        carried = jax.block_until_ready(run(*program.fixed, carried))
    calls = max(1, round(seconds / watch.seconds))
    spent = []
    for _ in range(5):
        with stopwatch() as watch:
            for _ in range(calls):
                carried = run(*program.fixed, carried)
            jax.block_until_ready(carried)
        spent.append(watch.seconds / calls)
    return program.count * program.turns / float(np.median(spent)), carried


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        environment="warehouse",
        batches=[1, 1024, 8192],
        people=62,
        dynamics=Option("twin", choices=("twin", "mjx")),
        seconds=Option(0.25, "of each of five timings, about"),
    )
    watch = Stopwatch()
    scenario = sean_jax.make(chosen.environment, people=chosen.people, dynamics=chosen.dynamics)
    print(f"{device()}, {chosen.environment}, {chosen.people} people")
    compare(scenario)
    timed, floors = {}, Stack(scenario, {})
    for batch in chosen.batches:
        timed[batch] = programs.stepping(floors, batch, min(bench.turns(batch), 100), bench.IMAGE)
    runs = compile_all(timed)
    print(f"compiled after {watch.seconds:.0f} s", flush=True)

    carried = {batch: program.carried for batch, program in timed.items()}
    speeds: dict[tuple[int, str, str], float] = {}

    def measure(host: str) -> None:
        for batch, program in timed.items():
            for form in FORMS:
                run = runs[batch, form]
                speed, carried[batch] = steps_per_second(run, program, carried[batch], chosen.seconds)
                speeds[batch, form, host] = speed
                print(f"{host} host, B = {batch}, {form}: {speed:.4g} steps/s", flush=True)

    measure("idle")
    with busy_host() as cores:
        measure("busy")
    print(f"{'B':>7}  {'form':<8}{'steps/s, idle':>15}{f'{cores} cores busy':>16}{'share':>8}{'idle / loops':>14}")
    for batch in timed:
        for form in FORMS:
            idle, busy = speeds[batch, form, "idle"], speeds[batch, form, "busy"]
            gain = idle / speeds[batch, "loops", "idle"]
            print(f"{batch:7d}  {form:<8}{idle:15.4g}{busy:16.4g}{busy / idle:8.2f}{gain:14.2f}")
    print(f"{watch.seconds:.0f} s in all")


def compile_all(timed: dict[int, Program]) -> dict[tuple[int, str], Any]:
    """The compiled programs by batch and form; XLA compiles them in parallel."""
    compiled: dict[tuple[int, str], Future] = {}
    with ThreadPoolExecutor() as pool:
        for form in FORMS:
            choose(form)
            for batch, program in timed.items():
                lowered = program.run.lower(*program.fixed, program.carried)
                compiled[batch, form] = pool.submit(lowered.compile)
    return {name: future.result() for name, future in compiled.items()}


if __name__ == "__main__":
    main()
