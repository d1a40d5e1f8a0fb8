"""Waiting for what another thread or process does."""

import time


def wait(condition, seconds: float = 60.0) -> None:
    """Until the condition holds; the test fails where it does not in time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"it does not happen within {seconds} s"
        time.sleep(0.005)
