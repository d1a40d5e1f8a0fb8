"""The lowest floor: data types, plane arithmetic, time, chance, padding, devices, and sentences about wrong values."""

import lazy_loader

# Public as a whole, and imported at first use.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["gradients"])
