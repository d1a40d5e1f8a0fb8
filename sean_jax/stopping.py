"""How long work is stopped: SIGTERM, by which schedulers end a job, does what Ctrl-C does."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

AGAIN = 0.02  # s


@contextlib.contextmanager
def stoppable() -> Iterator[list[int]]:
    """Until the block ends Ctrl-C and SIGTERM raise KeyboardInterrupt in the main thread; the signals received.

    In a callback of ``weakref``, of which JAX's caches have many, Python would tell of the exception and forget it:
    there it is put off.
    """
    received: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if number in kinds:
            received.append(number)
        if hasattr(signal, "setitimer") and _in_a_callback(frame):
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        else:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # where no signal arrives
        yield received
        return
    kinds = (signal.SIGINT, signal.SIGTERM)
    again = (signal.SIGALRM,) if hasattr(signal, "setitimer") else ()
    before = {kind: signal.signal(kind, stop) for kind in (*kinds, *again)}
    try:
        yield received
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _in_a_callback(frame: FrameType | None) -> bool:
    while frame is not None:
        if os.path.basename(frame.f_code.co_filename) == "weakref.py":
            return True
        frame = frame.f_back
    return False
