"""How long work is stopped: SIGTERM, by which schedulers end a job, does what Ctrl-C does."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def terminated_as_by_ctrl_c() -> Iterator[list[int]]:
    """Until the block ends SIGTERM raises KeyboardInterrupt in the main thread; gives the list of those received."""
    received: list[int] = []

    def stop(number: int, _: Any) -> None:
        received.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # where no signal arrives
        yield received
        return
    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield received
    finally:
        signal.signal(signal.SIGTERM, before)
