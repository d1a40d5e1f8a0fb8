"""The kernels of a step on a GPU, with the bytes that they move and their instructions, without a GPU.

    python benchmarks/kernels.py                    # a step of the crowd alone, for an H200
    python benchmarks/kernels.py --part step        # the whole step
    python benchmarks/kernels.py --part gradient    # reverse mode of a control step of the crowd, by its constants
    python benchmarks/kernels.py --part picture --batch 1024    # color pictures of 160 x 120 pixels

XLA compiles for a described GPU. That needs JAX's CUDA plugin and NVIDIA's assembler, but no driver:
`pip install jax-cuda12-plugin jax-cuda12-pjrt nvidia-cuda-nvcc-cu12`, in the version of jax. Kernels inside a loop
count once. Instructions are PTX's, about as many as the GPU's own.
"""

import importlib.util
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from options import Option, parse

H200 = """
gpu_device_info {
  threads_per_block_limit: 1024 threads_per_warp: 32 shared_memory_per_block: 49152 shared_memory_per_core: 233472
  threads_per_core_limit: 2048 core_count: 132 fpus_per_core: 128 block_dim_limit_x: 2147483647
  block_dim_limit_y: 65535 block_dim_limit_z: 65535 memory_bandwidth: 4800000000000 l2_cache_size: 52428800
  clock_rate_ghz: 1.98 device_memory_size: 150000000000 shared_memory_per_block_optin: 232448
  cuda_compute_capability { major: 9 } registers_per_core_limit: 65536 registers_per_block_limit: 65536
}
platform_name: "CUDA"
dnn_version_info { major: 9 minor: 8 }
device_description_str: "sm_90"
"""
BYTES = {"pred": 1, "s8": 1, "u8": 1, "c64": 8, "f64": 8, "s64": 8, "u64": 8}  # of a number; of all others 4
KERNELS = ("fusion", "reduce", "custom-call", "copy", "sort", "scatter", "gather", "dynamic-update-slice")
SHOWN = 14  # kernels of a loop


def gpu(folder: str) -> Any:
    """The described GPU; XLA dumps its programs to the folder. Call it before JAX is imported elsewhere."""
    try:
        import nvidia.cuda_nvcc

        missing = importlib.util.find_spec("jax_plugins.xla_cuda12") is None
    except ImportError:
        missing = True
    if missing:
        sys.exit("CUDA's compiler is missing; pip install jax-cuda12-plugin jax-cuda12-pjrt nvidia-cuda-nvcc-cu12.")
    tools = Path(nvidia.cuda_nvcc.__path__[0])
    os.environ["PATH"] = f"{tools / 'bin'}{os.pathsep}{os.environ['PATH']}"
    flags = (
        f"--xla_gpu_cuda_data_dir={tools} --xla_gpu_autotune_level=0 --xla_dump_to={folder} --xla_dump_emitter_re=.*"
    )
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags} --xla_gpu_dump_llvmir"
    os.environ["JAX_PLATFORMS"] = "cpu"
    import jax
    import jax_plugins.xla_cuda12
    from jax.experimental import topologies

    jax.devices()
    try:
        jax_plugins.xla_cuda12.initialize()
    except jax.errors.JaxRuntimeError as error:
        if "ALREADY_EXISTS" not in str(error):
            raise
    device = topologies.get_topology_desc("", "cuda", target_config=H200, topology="1x1x1").devices[0]
    return jax.sharding.SingleDeviceSharding(device)


def program(part: str, batch: int, people: int, forces: str) -> tuple[Callable, tuple]:
    """The function, and shapes of its arguments."""
    import jax
    import jax.numpy as jnp

    import sean_jax
    from sean_jax.simulation import scenario as stages

    scenario = sean_jax.make("warehouse", behavior="graph", people=people, forces=forces)

    def reset(key: Any) -> Any:
        return jax.vmap(lambda key: sean_jax.reset(scenario, key))(jax.random.split(key, batch))

    states = jax.eval_shape(reset, jax.random.key(0))
    if part == "step":
        action = jnp.asarray((0.3, 0.1), float)
        return jax.vmap(lambda state: sean_jax.step(scenario, state, action)), (states,)
    if part == "picture":
        camera = sean_jax.sensors.camera(scenario, "first_person", width=160, height=120)
        return jax.vmap(lambda state: sean_jax.sensors.render(scenario, state, camera).rgb), (states,)
    if part == "crowd":
        grid, step = scenario.environment.obstacle_grid, scenario.time_step / scenario.substeps
        move = lambda people: sean_jax.social_forces.integrate(scenario.forces, people, grid, None, None, step)  # noqa: E731
        return jax.vmap(move), (states.pedestrians,)

    def total(forces: Any, states: Any) -> Any:
        people = jax.vmap(lambda state: stages.move_pedestrians(scenario.replace(forces=forces), state))(states)
        return people.pedestrians.position.sum()

    constants = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), scenario.forces)
    return jax.grad(total), (constants, states)


def size(shapes: str) -> int:
    """Bytes of all arrays in a text such as f32[8,2]."""
    total = 0
    for kind, dimensions in re.findall(r"\b([a-z]+\d*)\[([\d,]*)\]", shapes):
        number = BYTES.get(kind, 4)
        for length in filter(None, dimensions.split(",")):
            number *= int(length)
        total += number
    return total


def report(text: str, instructions: dict[str, int]) -> None:
    """Print the kernels of each computation that is not a kernel."""
    for block in text.split("\n\n"):
        lines = block.strip().splitlines()
        if not lines or lines[0].startswith(("%fused", "%wrapped", "HloModule")):
            continue
        shapes, rows = {}, []
        for line in lines:
            instruction = re.match(r"\s*(?:ROOT )?%([\w.\-]+) = (.*?) ([\w\-]+)\((.*)", line)
            if not instruction:
                continue
            name, shape, kind, arguments = instruction.groups()
            shapes[name] = shape
            if kind in KERNELS:
                operands = re.findall(r"%([\w.\-]+)", arguments.split("), ")[0])
                read = sum(size(shapes.get(operand, "")) for operand in operands)
                rows.append((size(shape) + read, size(shape), name))
        if rows:
            print(f"\n{lines[0].split(' ')[0]}: {len(rows)} kernels, {sum(row[0] for row in rows) / 1e6:,.1f} MB")
            for moved, written, name in sorted(rows, reverse=True)[:SHOWN]:
                count = instructions.get(name.replace(".", "_"), 0)
                print(f"{moved / 1e6:12,.1f} MB, written {written / 1e6:10,.1f} MB {count or '':>6}  {name}")


def counted(folder: str) -> dict[str, int]:
    """Instructions of each kernel."""
    instructions: dict[str, int] = {}
    for file in Path(folder).glob("*.ptx"):
        for name, body in re.findall(r"\.entry (\w+)\((.*?)\n\}", file.read_text(), re.S):
            instructions[name] = len(re.findall(r"^\s+(?:@!?%p\d+ )?[a-z][\w.]*\s.*;$", body, re.M))
    return instructions


def main() -> None:
    """Print the kernels."""
    chosen = parse(
        __doc__,
        part=Option("crowd", choices=("crowd", "step", "gradient", "picture")),
        batch=8192,
        people=62,
        forces="calibrated",
    )
    with tempfile.TemporaryDirectory() as folder:
        device = gpu(folder)
        import jax

        function, shapes = program(chosen.part, chosen.batch, chosen.people, chosen.forces)
        compiled = jax.jit(function, in_shardings=device, out_shardings=device).lower(*shapes).compile()
        print(f"{chosen.part} of {chosen.batch} scenarios of {chosen.people} people, jax {jax.__version__}, H200")
        report(compiled.as_text(), counted(folder))


if __name__ == "__main__":
    main()
