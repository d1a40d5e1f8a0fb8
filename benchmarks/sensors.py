"""Speed of the sensors: depth images, pictures and scans per second, at several batches and sizes.

python benchmarks/sensors.py --batches 1 64                     on a CPU
python benchmarks/sensors.py --batches 1 --sizes 640x480        in full, on a CPU
python benchmarks/sensors.py --batches 1024 8192 --only depth   on a GPU
python benchmarks/sensors.py --batches 64 256 --only vlp16      on a GPU

Each scenario is reset with its own key, so robots and people stand in different places.
"""

from functools import partial

import jax
from options import Option, parse
from timing import compiled, device, median, temporary

import sean_jax
from sean_jax import sensors


def cases(scenario, sizes: list[str]) -> dict:
    """name -> (state -> array)."""
    functions = {}
    for size in sizes:
        width, height = map(int, size.split("x"))
        for name in ("depth", "first_person", "overhead"):
            camera = sensors.camera(scenario, name, width=width, height=height)
            functions[f"{name} {size}"] = _image(scenario, camera)
    lidar = sensors.lidar(scenario)
    functions["lidar 360"] = lambda state: sensors.scan(scenario, state, lidar)
    for count in (360, 1800):
        rings = sensors.lidar(scenario, **{**sensors.VLP16, "count": count})
        functions[f"vlp16 16x{count}"] = lambda state, rings=rings: sensors.scan(scenario, state, rings)
    return functions


def _image(scenario, camera):
    if camera.name == "depth":
        return lambda state: sensors.depth(scenario, state, camera)
    return lambda state: sensors.render(scenario, state, camera).rgb


def main() -> None:
    """Print the table."""
    chosen = parse(
        __doc__,
        environment="warehouse",
        batches=[1, 64],
        sizes=Option(["64x48", "160x120"], "of pictures, such as 640x480"),
        people=62,
        only=Option("", "beginning of the names of the cases"),
        repeats=5,
    )
    scenario = sean_jax.make(chosen.environment, people=chosen.people)
    jax.config.update("jax_enable_compilation_cache", False)  # so compile times are those of a first run
    print(f"{device()}, {chosen.environment}, {chosen.people} people")
    print(f"{'case':22}{'B':>7}{'compile s':>11}{'us a call':>12}{'images/s':>12}{'temporary MiB':>15}")
    for batch in chosen.batches:
        states = jax.jit(jax.vmap(lambda key: sean_jax.reset(scenario, key)))(
            jax.random.split(jax.random.key(0), batch)
        )
        for name, function in cases(scenario, chosen.sizes).items():
            if not name.startswith(chosen.only):
                continue
            run, compiling = compiled(jax.vmap(function), states)
            seconds = median(partial(run, states), chosen.repeats, calls=5)
            speed = f"{1e6 * seconds:12.0f}{batch / seconds:12.3g}"
            print(f"{name:22}{batch:7d}{compiling:11.1f}{speed}{temporary(run):15.0f}", flush=True)


if __name__ == "__main__":
    main()
