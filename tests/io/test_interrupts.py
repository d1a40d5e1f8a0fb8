"""Ctrl-C and SIGTERM stop the work, wherever it is."""

import asyncio
import gc
import signal
import subprocess
import sys
import time
import weakref
from types import SimpleNamespace
from typing import Any

import jax
import pytest

from sean_jax.io import interrupts


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_not_lost_in_a_callback(kind):
    """As when a cache forgets what is no longer there: what is raised then, Python tells and forgets."""

    class Key:
        pass

    class Sender(dict):
        def __delitem__(self, key):
            super().__delitem__(key)
            signal.raise_signal(kind)

    before = signal.getsignal(kind)
    with interrupts.interruptible() as received:
        cache, key = weakref.WeakKeyDictionary(), Key()
        cache.data = Sender()
        cache[key] = 1
        with pytest.raises(KeyboardInterrupt):
            del key
            assert not len(cache) and received == [kind]
            time.sleep(60)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(kind)
        assert received == [kind, kind]
    assert signal.getsignal(kind) == before


def test_a_signal_is_not_lost_while_memory_is_swept():
    """In a callback of the garbage collector, of which JAX has one, and where an object is deleted."""

    class Deleted:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def callback(phase, info):
        if phase == "stop":
            signal.raise_signal(signal.SIGINT)

    def collect():
        gc.callbacks.append(callback)
        gc.collect()
        gc.callbacks.remove(callback)

    with interrupts.interruptible() as received:
        for number, sweep in enumerate((Deleted, collect), start=1):
            with pytest.raises(KeyboardInterrupt):
                sweep()
                assert received == [signal.SIGINT] * number
                time.sleep(60)


def test_a_signal_waits_for_an_open_loop():
    """As when orbax reads a checkpoint: what runs in the loop comes to its end, and the interrupt after it."""
    done = []

    async def read():
        signal.raise_signal(signal.SIGINT)
        await asyncio.sleep(3 * interrupts.RETRY_INTERVAL)
        done.append("read")

    def block():
        with interrupts.interruptible() as received, pytest.raises(KeyboardInterrupt):
            loop = asyncio.new_event_loop()
            loop.run_until_complete(read())
            loop.close()
            done.append("closed")
            assert received == [signal.SIGINT]
            time.sleep(60)

    block()
    assert done[0] == "read"

    async def notebook():
        """A loop that was there before the block, as in Jupyter, is none of its own."""
        with interrupts.interruptible(), pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    asyncio.new_event_loop().run_until_complete(notebook())


class Metadata:
    """Of a pytree; Ctrl-C comes while it is compared."""

    def __eq__(self, other):
        signal.raise_signal(signal.SIGINT)
        return True

    __hash__ = object.__hash__


@jax.tree_util.register_pytree_node_class
class Node:
    def tree_flatten(self):
        return (), Metadata()

    @classmethod
    def tree_unflatten(cls, metadata, leaves):
        return cls()


def test_an_interrupt_of_c_code_is_an_interrupt():
    """JAX makes a ValueError of what is raised while it compares."""
    compare = lambda: jax.tree.structure(Node()) == jax.tree.structure(Node())  # noqa: E731
    with interrupts.interruptible():
        with pytest.raises(ValueError, match="equality"):
            compare()
        with pytest.raises(KeyboardInterrupt), interrupts.unwrapped():
            compare()
    with pytest.raises(OSError, match="full"), interrupts.unwrapped():  # what goes wrong while one stops is told
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise OSError("full")  # noqa: B904


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no alarms")
def test_an_alarm_does_not_outlive_the_block():
    with interrupts.interruptible() as received:
        stop: Any = signal.getsignal(signal.SIGINT)
        frame = SimpleNamespace(f_code=SimpleNamespace(co_filename="/lib/weakref.py"), f_back=None)
        stop(signal.SIGINT, frame)
    assert received == [signal.SIGINT] and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    time.sleep(2 * interrupts.RETRY_INTERVAL)


def test_an_ignored_signal_stays_ignored():
    """As nohup, or a shell in the background, starts a program."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts.interruptible() as received:
            signal.raise_signal(signal.SIGINT)
        assert received == [] and signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_handler_that_is_not_pythons_is_left_alone(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patched:
        patched.setattr(signal, "getsignal", lambda kind: None)
        with interrupts.interruptible():
            patched.undo()
            assert signal.getsignal(signal.SIGINT) is before


# A program whose main thread ends while another one compiles, which takes seconds.
COMPILING = """
import signal, sys
import jax, jax.numpy as jnp
from sean_jax.cli import command_line; from sean_jax.core import errors; from sean_jax.io import interrupts

def long(x):
    for k in range(100):
        x = jnp.sort(x * k)
    return x

jax.config.update("jax_enable_compilation_cache", False)

def work(*options):
    interrupts.compile_in_thread(jax.jit(long).lower(jnp.zeros(8)).compile)
    print("compiling")
    {end}

{begin}
"""
ENDS = [  # of a program of a user's, and of the command line
    ("raise ValueError('mine')", "work()", 1, "mine"),
    ("raise errors.InputError('no such thing')", "", 2, "sean: no such thing"),
    *(
        pytest.param(*each, marks=pytest.mark.slow)
        for each in (
            ("sys.exit(3)", "work()", 3, ""),
            ("signal.raise_signal(signal.SIGINT)", "work()", -signal.SIGINT, "KeyboardInterrupt"),
            ("raise ValueError('ours')", "", 1, "ours"),
            ("signal.raise_signal(signal.SIGINT)", "", 130, "sean: stopped"),
            ("signal.raise_signal(signal.SIGTERM)", "", 143, "sean: stopped"),
        )
    ),
]


@pytest.mark.parametrize(("end", "begin", "code", "text"), ENDS)
def test_an_error_while_xla_compiles_ends_in_its_own_code(end, begin, code, text):
    """An interpreter that ends unwinds the threads that are left, which XLA answers with ``abort``."""
    begin = begin or "command_line.DO['list'] = work; sys.argv = ['sean', 'list']; sys.exit(command_line.main())"
    program = COMPILING.format(end=end, begin=begin)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert ended.returncode == code, ended.stderr
    assert text in ended.stderr and "terminate called" not in ended.stderr
    assert ended.stdout == "compiling\n"


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_waits_for_the_end_of_a_block_and_the_second_does_not(kind):
    before, done = signal.getsignal(kind), []
    with interrupts.interruptible() as received:
        outer = signal.getsignal(kind)
        with pytest.raises(KeyboardInterrupt), interrupts.deferred() as waiting:
            signal.raise_signal(kind)
            assert waiting == [kind] and received == []
            done.append("block")
        assert done == ["block"] and received == [kind] and signal.getsignal(kind) == outer
        with pytest.raises(KeyboardInterrupt), interrupts.deferred():
            signal.raise_signal(kind)
            signal.raise_signal(kind)
            done.append("never")
        with pytest.raises(OSError, match="full"), interrupts.deferred():
            signal.raise_signal(kind)
            raise OSError("full")  # which says more than the signal
        with interrupts.deferred() as waiting:
            assert waiting == []
    assert done == ["block"] and signal.getsignal(kind) == before
