"""sean_jax: social robot navigation as pure JAX functions (SEAN 2.0, Tsoi et al. 2022)."""

import lazy_loader

__version__ = "0.2.0"

# Modules are imported at first use of a name, so that `sean --help` imports no JAX.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
