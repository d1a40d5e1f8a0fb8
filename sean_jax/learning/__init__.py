"""Learning to drive, from demonstrations (section V) and from rewards: collect, train, let it drive.

Names are imported at first use, so that the command line, which only needs the options, answers at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sean_jax.learning import dagger, policy, reinforcement
    from sean_jax.learning.collection import Recorder, collect, record
    from sean_jax.learning.dataset import Dataset, open_dataset
    from sean_jax.learning.examples import Example, Loader, Recording, Token, example
    from sean_jax.learning.imitation import train, train_ensemble
    from sean_jax.learning.lerobot import export
    from sean_jax.learning.networks import Network
    from sean_jax.learning.policy import load_folder as load
    from sean_jax.learning.policy import load_policy, pack

_HOMES = {
    "Dataset": "dataset",
    "Example": "examples",
    "Loader": "examples",
    "Network": "networks",
    "Recorder": "collection",
    "Recording": "examples",
    "Token": "examples",
    "collect": "collection",
    "example": "examples",
    "export": "lerobot",
    "load": "policy",
    "load_policy": "policy",
    "open_dataset": "dataset",
    "pack": "policy",
    "record": "collection",
    "train": "imitation",
    "train_ensemble": "imitation",
}

MODULES = "dagger", "policy", "reinforcement"  # public as a whole

__all__ = [
    "Dataset", "Example", "Loader", "Network", "Recorder", "Recording", "Token", "collect", "dagger", "example",
    "export", "load", "load_policy", "open_dataset", "pack", "policy", "record", "reinforcement", "train",
    "train_ensemble",
]  # fmt: skip


def __getattr__(name: str):
    if name in MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), "load_folder" if name == "load" else name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *MODULES})
