"""How long work is interrupted: SIGTERM, by which schedulers end a job, does what Ctrl-C does."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

RETRY_INTERVAL = 0.02  # s, after which an interrupt that was put off is tried again
COMPILER_THREAD = "sean-compiler"  # name of the thread that compiles; nothing can interrupt it


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt in the main thread until the block ends.

    In a callback of ``weakref``, of which JAX's caches have many, Python would print the exception and drop it: there
    it is put off. A signal that is ignored, or that has a handler outside Python, is left alone. In other
    threads, where no signal arrives, the block runs as it is.

    Yields:
        The signals received so far.
    """
    received: list[int] = []
    pending: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if number in kinds:
            received.append(number)
        if again and _in_weakref_callback(frame):
            pending.append(number)
            signal.setitimer(signal.ITIMER_REAL, RETRY_INTERVAL)
        else:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # where no signal arrives
        yield received
        return
    kinds = (signal.SIGINT, signal.SIGTERM)
    alarmed = hasattr(signal, "setitimer") and signal.getsignal(signal.SIGALRM) is not None
    again = (signal.SIGALRM,) if alarmed else ()
    ours = [kind for kind in kinds if signal.getsignal(kind) not in (None, signal.SIG_IGN)]
    before = {kind: signal.signal(kind, stop) for kind in (*ours, *again)}
    try:
        yield received
    finally:
        if pending:  # or else a later alarm would end the process
            signal.setitimer(signal.ITIMER_REAL, 0)
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _in_weakref_callback(frame: FrameType | None) -> bool:
    while frame is not None:
        if os.path.basename(frame.f_code.co_filename) == "weakref.py":
            return True
        frame = frame.f_back
    return False
