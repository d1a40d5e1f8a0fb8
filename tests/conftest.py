"""What all tests share: strict array rules, one compilation cache, a small scenario, a folder of recordings."""

import ctypes
import functools
import gc
import importlib.metadata
import os
import signal
import tempfile
from pathlib import Path

# Before jax is imported, and inherited by the programs that tests start. Compiled programs depend on the machine,
# so they are kept in its temporary folder and not in a home folder that machines may share; CI keeps them elsewhere.
_USER = os.getuid() if hasattr(os, "getuid") else os.getlogin()
_CACHE = Path(os.environ.get("SEAN_JAX_TEST_CACHE") or Path(tempfile.gettempdir()) / f"sean_jax-tests-{_USER}")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(_CACHE))
os.environ.setdefault("XDG_CACHE_HOME", str(_CACHE / "user"))  # the user's own tables are left alone
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
# Half of what the tests take is compiling, for arrays so small that it does not pay to have loops unrolled. Code of
# level 0 is compiled in half the time and runs 3 times as long: the slow tests, which take more steps, use level 1.
_LEVEL = os.environ.get("SEAN_JAX_TEST_OPTIMIZATION", "0")
_QUICK = f"--xla_backend_optimization_level={_LEVEL} --xla_backend_extra_options=xla_cpu_disable_loop_unrolling"
if importlib.metadata.version("jaxlib").startswith("0.10."):  # later ones stop at a flag that they do not know
    _QUICK += " --xla_cpu_use_fusion_emitters=false"
if os.environ["JAX_PLATFORMS"] == "cpu":
    os.environ.setdefault("XLA_FLAGS", _QUICK)
# A script's background has Ctrl-C ignored, and so would whatever the tests start and interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
gc.set_threshold(50_000, 20, 20)  # a fifth of tracing went into looking for cycles among what stays

import jax  # noqa: E402
import pytest  # noqa: E402

pytest.register_assert_rewrite("support")  # a failed assertion there says as much as one in a test

from support import shapes  # noqa: E402
from support.sharding import pytest_collection_modifyitems, pytest_configure  # noqa: E402, F401

shapes.install("sean_jax")  # before anything of it is imported

# Silent broadcasting of (N,) against (N, N), and silent changes of type, are errors here.
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


MOST = 4e9  # bytes of a process, beyond which it forgets its programs: two processes of slow tests would take 24 GB


@pytest.fixture(autouse=True, scope="module")
def bounded_memory():
    """Compiled programs go after a module that leaves the process large; those on the disk are read again."""
    yield
    statm = Path("/proc/self/statm")
    if statm.is_file() and int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > MOST:
        jax.clear_caches()
        gc.collect()
        getattr(ctypes.CDLL(None), "malloc_trim", id)(0)  # glibc keeps what is freed


@pytest.fixture(scope="session")
def scenario():
    """A warehouse with 16 people and the closed-form robot: small, and compiled once for all tests that share it."""
    import sean_jax

    return sean_jax.make("warehouse", behavior="graph", task="join_group", robot="kuri", people=16, dynamics="twin")


@pytest.fixture(scope="session")
def whole_scenario():
    """The same, whose people walk from goal to goal along whole paths, as in the paper."""
    import sean_jax

    options = {"behavior": "graph", "routing": "whole", "task": "join_group", "robot": "kuri"}
    return sean_jax.make("warehouse", **options, people=16, dynamics="twin")


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of recorded real trajectories, which are other people's work and not part of this repository."""
    folder = os.environ.get("SEAN_JAX_DATA")
    if not folder:
        pytest.skip("set SEAN_JAX_DATA to a folder of recorded trajectories")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"SEAN_JAX_DATA={folder} is not a folder")
    return path


@pytest.fixture
def on_a_gpu(monkeypatch):
    """The forms of the social forces for a GPU, with their kernels interpreted on whatever is here."""
    from sean_jax.social_forces import kernel

    monkeypatch.setattr(jax.lax, "platform_dependent", lambda *given, cpu, default: default(*given))
    for call in "_call", "_call_search", "_call_obstacles":
        monkeypatch.setattr(kernel, call, functools.partial(getattr(kernel, call), interpret=True))
