"""Interrupts of long work: SIGTERM, by which schedulers end a job, acts as Ctrl-C."""

import atexit
import contextlib
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

RETRY_INTERVAL = 0.02  # s, after which an interrupt that was put off is tried again
COMPILER_THREAD = "sean-compiler"  # name of a thread that compiles; nothing can interrupt it


def compile_in_thread(work: Callable[[], None]) -> threading.Thread:
    """Run work of XLA's compiler in a thread; the interpreter waits for it before it exits.

    An interpreter that exits unwinds its other threads, and XLA's C++ answers that with ``abort``.
    """
    atexit.unregister(_wait_for_compiler)
    atexit.register(_wait_for_compiler)  # as the last one, so before JAX frees what the compiler uses
    thread = threading.Thread(target=work, name=COMPILER_THREAD, daemon=True)
    thread.start()
    return thread


def is_compiling() -> bool:
    """Whether a thread of ``compile_in_thread`` runs."""
    return any(thread.name == COMPILER_THREAD for thread in threading.enumerate())


def _wait_for_compiler() -> None:
    try:
        while is_compiling():
            time.sleep(RETRY_INTERVAL)
    except KeyboardInterrupt:
        os._exit(128 + signal.SIGINT)


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt in the main thread within the block.

    Python prints and drops an exception in a callback of ``weakref``, of which JAX's caches have many, or of the
    garbage collector, and in ``__del__``: there the interrupt is delayed. It is also delayed until a loop of
    ``asyncio`` in the block has ended: orbax reads and writes in one, and its remaining threads would complain of a
    closed loop. Signals that are ignored, or have a handler outside Python, are left alone. Other threads receive
    no signals: there the block simply runs.
    """
    received: list[int] = []
    pending: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        if number in kinds:
            received.append(number)
        if again and _has_to_wait(frame, owner):
            pending.append(number)
            signal.setitimer(signal.ITIMER_REAL, RETRY_INTERVAL)
        else:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # where no signal arrives
        yield received
        return
    owner = sys._getframe(2)  # of the block; 1 is contextlib's
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


@contextlib.contextmanager
def deferred() -> Iterator[list[int]]:
    """Delay the first Ctrl-C or SIGTERM to the end of the block, which reads it in the list; a second acts at once.

    Signals that are ignored, or have a handler outside Python, are left alone.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():  # where no signal arrives
        yield received
        return
    handlers = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)}
    before = {kind: handler for kind, handler in handlers.items() if callable(handler)}

    def put_off(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            before[signal.Signals(number)](number, frame)

    for kind in before:
        signal.signal(kind, put_off)
    try:
        yield received
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
    if received:
        before[signal.Signals(received[0])](received[0], None)


@contextlib.contextmanager
def unwrapped() -> Iterator[None]:
    """Raise the block's KeyboardInterrupt as itself, where code in C has turned it into another exception.

    An interrupt can come while JAX's C++ compares two objects by their ``__eq__`` in Python; it raises a SystemError or
    ValueError, whose cause is the interrupt.

    Raises:
        KeyboardInterrupt: the block was interrupted.
    """
    try:
        yield
    except Exception as error:
        cause = error.__cause__
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        if cause is None:
            raise
        raise KeyboardInterrupt from error


def _has_to_wait(frame: FrameType | None, owner: FrameType) -> bool:
    """Whether Python would drop the exception there, or an event loop is open in the owner's block."""
    callbacks = [getattr(callback, "__code__", None) for callback in gc.callbacks]
    while frame is not None and frame is not owner:
        code = frame.f_code
        if os.path.basename(code.co_filename) == "weakref.py" or code.co_name == "__del__" or code in callbacks:
            return True
        if code.co_name == "run_until_complete":
            return True
        frame = frame.f_back
    return False
