"""The floors of benchmarks/roofline.py: counts of programs with known needs, and what binds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import social_forces
from sean_jax.cli.bench import programs, workload
from sean_jax.social_forces import kernel, model
from support.checkout import benchmark

roofline = benchmark("roofline")


def needs(function, *arguments, platform="cpu", **turns):
    """Operations, special functions and bytes of a function."""
    found = roofline.count(jax.jit(function).trace(*arguments).jaxpr, turns, platform)
    return found["operations"], found["special"], found["bytes"]


def test_counts_of_programs():
    x = jnp.ones(7)

    def turn(x, _):
        jnp.sin(x)  # unused
        return jnp.exp(x * x) + x * x, None  # the square once

    assert needs(lambda x: jax.lax.scan(turn, x, length=3)[0], x) == (3 * 14, 3 * 7, 3 * 2 * 7 * 4)
    assert needs(lambda x: jax.vmap(lambda y: y @ y)(x[None]), x) == (14, 0, 0)
    branches = dict(cpu=lambda x: x + 1, default=lambda x: x / (x + 1))
    assert needs(lambda x: jax.lax.platform_dependent(x, **branches), x) == (7, 0, 0)
    assert needs(lambda x: jax.lax.platform_dependent(x, **branches), x, platform="gpu") == (7, 7, 0)

    def search(x):
        with jax.named_scope("search"):
            return jax.lax.while_loop(lambda x: x[0] < 9.0, lambda x: x + 1, x)

    assert needs(search, x)[0] == 7 + 1 and needs(search, x, search=2.5)[0] == 2.5 * (7 + 1)


def test_counts_of_a_kernel():
    """A test of distance for each other, and the law for those within reach: three operations and one of the sum."""

    def law(shared, own, other):
        return (own[0] - other[0]) * (own[1] - other[1])

    def sums(x):
        rows = None, jnp.ones(1), (x, x), (x, x)
        near, shared, *both = rows
        return kernel.sum_pairs(kernel.trace(law, *rows), near, jnp.ones(()), shared, *both)

    some, more = (needs(sums, jnp.ones(128), platform="gpu", within_reach=turns)[0] for turns in (5.0, 6.0))
    assert more - some == 128 * 4
    assert 128 * (128 * 6) <= some - 5 * (more - some) <= 128 * (128 * 6 + 3)
    program = programs.crowd(62, 4, 2)
    traced = program.run.trace(*program.fixed, program.carried).jaxpr
    cpu, gpu = (
        roofline.count(traced, roofline.crowd_turns(program), platform)["operations"] for platform in ("cpu", "gpu")
    )
    assert 2 * gpu < cpu < 10 * gpu


def test_the_pairs_that_floors_count():
    people, _, exact = workload.crowd(20, 0)
    forces = social_forces.preset("helbing1995")
    apart = np.linalg.norm(exact["x"][:, None] - exact["x"][None], axis=-1)
    reach = float(model.cutoff(forces))
    found = roofline.crowd_turns(programs.crowd(20, 2, 2, 0, "helbing1995"))["within_reach"]
    assert found == pytest.approx(((apart < reach).sum() - 20) / 20) and found > 0


@pytest.mark.slow
def test_what_binds():
    rates = roofline.Rates(operations=100.0, special=10.0, bytes=50.0)
    assert roofline.floor({"operations": 50.0, "special": 1.0, "bytes": 1.0}, rates) == (2.0, "operations")
    assert roofline.floor({"operations": 50.0, "special": 10.0, "bytes": 1.0}, rates, 4) == (4.0, "special")
    assert roofline.floor({"operations": 0.0, "special": 0.0, "bytes": 25.0}, rates) == (2.0, "bytes")
    measured = roofline.rates()
    assert measured.operations > measured.special > 0 < measured.bytes
