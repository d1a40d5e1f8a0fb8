"""Several processes that train together, such as one on each host: who writes, and that none goes on alone.

Every process computes the same numbers, each on its own devices; process 0 alone has the lock and the log. Where one
refuses, all must hear of it: the others would wait for it forever.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from sean_jax.errors import InputError, SeanError

Result = TypeVar("Result")


def is_first() -> bool:
    """Whether this process is the one that writes; it is, where there are no others.

    Returns:
        True or False.
    """
    return jax.process_index() == 0


def must_stop(step: int) -> bool:
    """Whether a process was sent SIGTERM, as by a scheduler that ends the job; all are told so at the same step.

    ``jax.distributed`` takes that signal for itself, unless its option ``jax_enable_preemption_service`` is off.

    Args:
        step: a number that is greater at each call, and the same in all processes.

    Returns:
        True or False.
    """
    listens = jax.config.jax_enable_preemption_service  # pyright: ignore[reportAttributeAccessIssue]
    return listens and multihost_utils.reached_preemption_sync_point(step)


def together(work: Callable[[], Result]) -> Result:
    """Work that every process does, after which each knows that all have done it.

    Raises:
        InputError: the work of another process was refused; which one is said.
        SeanError: that of the work of this process.
    """
    if jax.process_count() == 1:
        return work()
    result, refusal = None, None
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


def by_first(work: Callable[[], bool | None]) -> bool:
    """Work that process 0 does alone, while the others wait for its answer.

    Raises:
        InputError: process 0 refused.
        SeanError: that of the work, in process 0.
    """
    answer = bool(together(work if is_first() else lambda: False))
    return answer if jax.process_count() == 1 else bool(multihost_utils.broadcast_one_to_all(np.asarray(answer)))
