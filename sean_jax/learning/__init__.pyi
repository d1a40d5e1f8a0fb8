"""The public names of learning and their modules: type checkers read them here, and `lazy_loader` too."""

from . import dagger as dagger, policy as policy, reinforcement as reinforcement
from .collection import Recorder as Recorder, collect as collect, record as record
from .dataset import Dataset as Dataset, open_dataset as open_dataset
from .examples import (
    Example as Example,
    Loader as Loader,
    Recording as Recording,
    Token as Token,
    example as example,
)
from .imitation import train as train, train_ensemble as train_ensemble
from .lerobot import export as export
from .networks import Network as Network
from .policy import load as load, load_policy as load_policy, pack as pack
