"""Speed of the sensors: depth images, pictures and scans per second, at several batches and sizes.

python benchmarks/sensors.py --batches 1 64                     on a CPU
python benchmarks/sensors.py --batches 1 --sizes 640x480        in full, on a CPU
python benchmarks/sensors.py --batches 1024 8192 --only depth   on a GPU
python benchmarks/sensors.py --batches 64 256 --only vlp16      on a GPU

Each scenario is reset with its own key, so robots and people stand in different places.
"""

import argparse
import time

import jax
import numpy as np

import sean_jax
from sean_jax import sensors


def cases(scenario, sizes: list[str]) -> dict:
    """name -> (state -> array)."""
    found = {}
    for size in sizes:
        width, height = map(int, size.split("x"))
        for name in ("depth", "first_person", "overhead"):
            camera = sensors.camera(scenario, name, width=width, height=height)
            found[f"{name} {size}"] = _image(scenario, camera)
    lidar = sensors.lidar(scenario)
    found["lidar 360"] = lambda state: sensors.scan(scenario, state, lidar)
    for count in (360, 1800):
        rings = sensors.lidar(scenario, **{**sensors.VLP16, "count": count})
        found[f"vlp16 16x{count}"] = lambda state, rings=rings: sensors.scan(scenario, state, rings)
    return found


def _image(scenario, camera):
    if camera.name == "depth":
        return lambda state: sensors.depth(scenario, state, camera)
    return lambda state: sensors.render(scenario, state, camera).rgb


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--environment", default="warehouse")
    arguments.add_argument("--batches", nargs="+", type=int, default=[1, 64])
    arguments.add_argument("--sizes", nargs="+", default=["64x48", "160x120"], help="of pictures, such as 640x480")
    arguments.add_argument("--people", type=int, default=62)
    arguments.add_argument("--only", default="", help="beginning of the names of the cases")
    arguments.add_argument("--repeats", type=int, default=5)
    chosen = arguments.parse_args()
    scenario = sean_jax.make(chosen.environment, people=chosen.people)
    device = jax.devices()[0]
    jax.config.update("jax_enable_compilation_cache", False)  # so compile times are those of a first run
    print(f"{device.device_kind}, jax {jax.__version__}, {chosen.environment}, {chosen.people} people")
    print(f"{'case':22}{'B':>7}{'compile s':>11}{'us a call':>12}{'images/s':>12}{'temporary MiB':>15}")
    for batch in chosen.batches:
        states = jax.jit(jax.vmap(lambda key: sean_jax.reset(scenario, key)))(
            jax.random.split(jax.random.key(0), batch)
        )
        for name, function in cases(scenario, chosen.sizes).items():
            if not name.startswith(chosen.only):
                continue
            start = time.perf_counter()
            compiled = jax.jit(jax.vmap(function)).lower(states).compile()
            compiling = time.perf_counter() - start
            analysis = compiled.memory_analysis()
            memory = analysis.temp_size_in_bytes / 2**20 if analysis else float("nan")
            jax.block_until_ready(compiled(states))
            times = []
            for _ in range(chosen.repeats):
                start = time.perf_counter()
                for _ in range(5):
                    image = compiled(states)
                jax.block_until_ready(image)
                times.append((time.perf_counter() - start) / 5)
            seconds = float(np.median(times))
            print(
                f"{name:22}{batch:7d}{compiling:11.1f}{1e6 * seconds:12.0f}{batch / seconds:12.3g}{memory:15.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
