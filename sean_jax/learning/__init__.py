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
    from sean_jax.learning.policy import load, load_policy, pack

_NAMES = {
    "collection": ("Recorder", "collect", "record"),
    "dataset": ("Dataset", "open_dataset"),
    "examples": ("Example", "Loader", "Recording", "Token", "example"),
    "imitation": ("train", "train_ensemble"),
    "lerobot": ("export",),
    "networks": ("Network",),
    "policy": ("load", "load_policy", "pack"),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}

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
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *MODULES})
