"""Processes of one training: what one of them does for all, and what all decide together."""

from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from sean_jax.core.errors import InputError, SeanError

Result = TypeVar("Result")


def is_first_process() -> bool:
    """Whether this process writes."""
    return jax.process_index() == 0


def must_stop(step: int) -> bool:
    """Whether a process got SIGTERM, as from a scheduler that ends the job; all processes agree on the step.

    ``jax.distributed`` takes that signal for itself, unless its option ``jax_enable_preemption_service`` is off.

    Args:
        step: greater at each call, and equal in all processes.
    """
    listens = jax.config.jax_enable_preemption_service  # pyright: ignore[reportAttributeAccessIssue]
    return listens and multihost_utils.reached_preemption_sync_point(step)


def on_all_processes(work: Callable[[], Result]) -> Result:
    """The result of work that every process does, after all have done it.

    Raises:
        InputError: another process refused; the message has its number.
        SeanError: this process refused.
    """
    if jax.process_count() == 1:
        return work()
    result = None
    refusal = None
    try:
        result = work()
    except SeanError as error:
        refusal = error
    refused = np.asarray(multihost_utils.process_allgather(np.asarray(refusal is not None)))
    if refusal is not None:
        raise refusal
    if refused.any():
        raise InputError(f"process {int(refused.argmax())} of {refused.size} has refused; see its message.")
    return result  # pyright: ignore[reportReturnType]


def on_first_process(work: Callable[[], bool | None]) -> bool:
    """The result of work that process 0 does alone, while the others wait.

    Raises:
        InputError: process 0 refused.
        SeanError: the error of the work, in process 0.
    """
    result = bool(on_all_processes(work if is_first_process() else lambda: False))
    return result if jax.process_count() == 1 else bool(multihost_utils.broadcast_one_to_all(np.asarray(result)))


# ------------------------------------------------------------------ log
