"""Programs that tests share: each is compiled once for all scenarios that differ in their numbers alone."""

import jax

import sean_jax
from sean_jax import environment

reset = jax.jit(sean_jax.reset)
resets = jax.jit(jax.vmap(sean_jax.reset, (None, 0)))
steps = jax.jit(jax.vmap(sean_jax.step, (None, 0, None)))  # states, and one action
observe = jax.jit(sean_jax.observe)
results = jax.jit(sean_jax.results)
rollout = jax.jit(sean_jax.rollout, static_argnames=("policy", "steps"))  # of policies that are functions
clearance = jax.jit(environment.clearance)
