"""How long work is stopped: SIGTERM, by which schedulers end a job, does what Ctrl-C does."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

AGAIN = 0.02  # s
COMPILER = "sean-compiler"  # name of the thread that compiles, which nothing stops


@contextlib.contextmanager
def stoppable() -> Iterator[list[int]]:
    """Until the block ends Ctrl-C and SIGTERM raise KeyboardInterrupt in the main thread; the signals received.

    In a callback of ``weakref``, of which JAX's caches have many, Python would tell of the exception and forget it:
    there it is put off. A signal that is ignored, or that somebody handles outside Python, stays so.
    """
    received: list[int] = []
    put_off: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if number in kinds:
            received.append(number)
        if again and _in_a_callback(frame):
            put_off.append(number)
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
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
        if put_off:  # else an alarm that comes later would end the process
            signal.setitimer(signal.ITIMER_REAL, 0)
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _in_a_callback(frame: FrameType | None) -> bool:
    while frame is not None:
        if os.path.basename(frame.f_code.co_filename) == "weakref.py":
            return True
        frame = frame.f_back
    return False
