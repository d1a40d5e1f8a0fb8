"""The public names of learning and their modules: type checkers read them here, and `lazy_loader` too."""

from . import dagger as dagger, policy as policy, reinforcement as reinforcement
from .collection import Recorder as Recorder, collect as collect, record as record
from .dataset import Dataset as Dataset, open_dataset as open_dataset, windows as windows
from .examples import (
    Example as Example,
    Recording as Recording,
    example as example,
)
from .imitation import train as train, train_ensemble as train_ensemble
from .lerobot import export as export
from .networks import ActorCritic as ActorCritic
from .policy import load as load, load_policy as load_policy, pack as pack
