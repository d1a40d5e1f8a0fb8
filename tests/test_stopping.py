"""Ctrl-C and SIGTERM stop the work, wherever it is."""

import signal
import time
import weakref

import pytest

from sean_jax import stopping


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
    with stopping.stoppable() as received:
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
