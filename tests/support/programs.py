"""Programs that tests share: each is compiled once for all scenarios that differ in their numbers alone."""

import functools
import warnings

import jax

import sean_jax
from sean_jax.world import environment

reset = jax.jit(sean_jax.reset)
resets = jax.jit(jax.vmap(sean_jax.reset, (None, 0)))
steps = jax.jit(jax.vmap(sean_jax.step, (None, 0, None)))  # states, and one action
observe = jax.jit(sean_jax.observe)
results = jax.jit(sean_jax.results)
rollout = jax.jit(sean_jax.rollout, static_argnames=("policy", "steps"))  # of policies that are functions
clearance = jax.jit(environment.clearance)


def lowered_for_gpu(function, *arguments):
    """The program as XLA gets it for an H200; nothing that jax will remove may be in it."""
    h200 = jax.sharding.AbstractDevice(device_kind="NVIDIA H200", num_cores=None, platform="cuda")
    mesh = jax.sharding.AbstractMesh((), (), abstract_device=h200)
    with warnings.catch_warnings(), jax.sharding.use_abstract_mesh(mesh):
        warnings.simplefilter("error", DeprecationWarning)
        return jax.jit(function).trace(*arguments).lower(lowering_platforms=("cuda",)).as_text()


def jit_once(function):
    """``jax.jit`` of a function that is traced once: with the second trace the test fails, and says what differs."""
    seen = []

    @functools.wraps(function)
    def traced(*arguments, **named):
        seen.append(jax.tree.map(jax.typeof, (arguments, named)))
        assert len(seen) == 1, f"{function.__name__} is traced again, for {seen[1]} after {seen[0]}"
        return function(*arguments, **named)

    return jax.jit(traced)
