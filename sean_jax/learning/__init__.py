"""Learning to drive, from demonstrations (section V) and from rewards: collect, train, let it drive.

Names are imported at first use, so that the command line, which only needs the options, answers at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sean_jax.learning import agents, dagger, ensemble, reinforcement
    from sean_jax.learning.choice import load
    from sean_jax.learning.collection import collect
    from sean_jax.learning.dataset import Dataset, open_dataset
    from sean_jax.learning.examples import Example, Recording, example
    from sean_jax.learning.learned import policy
    from sean_jax.learning.lerobot import export
    from sean_jax.learning.loader import Loader, Token
    from sean_jax.learning.network import Network
    from sean_jax.learning.packing import pack
    from sean_jax.learning.recorder import record
    from sean_jax.learning.training import train

_HOMES = {
    "Dataset": "dataset",
    "Example": "examples",
    "Loader": "loader",
    "Network": "network",
    "Recording": "examples",
    "Token": "loader",
    "collect": "collection",
    "example": "examples",
    "export": "lerobot",
    "load": "choice",
    "open_dataset": "dataset",
    "pack": "packing",
    "policy": "learned",
    "record": "recorder",
    "train": "training",
}

ROOMS = "agents", "dagger", "ensemble", "reinforcement"  # public as a whole

__all__ = [
    "Dataset", "Example", "Loader", "Network", "Recording", "Token", "agents", "collect", "dagger", "ensemble",
    "example", "export", "load", "open_dataset", "pack", "policy", "record", "reinforcement", "train",
]  # fmt: skip


def __getattr__(name: str):
    if name in ROOMS:
        return import_module(f"{__name__}.{name}")
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *ROOMS})
