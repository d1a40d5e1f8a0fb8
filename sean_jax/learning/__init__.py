"""Learning to drive, from demonstrations (section V) and from rewards: collect, train, let it drive."""

import lazy_loader

# Modules are imported at first use of a name, so that the command line, which only needs the options, answers at once.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
