"""The step and everything that runs it (section IV-B): scenarios, teams, episodes, batches of episodes."""

import lazy_loader

# Public as a whole, and imported at first use.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["team"])
