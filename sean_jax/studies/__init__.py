"""Studies: questions about the simulator itself, which a simulation need not ask.

Are the people right (``validation``, ``calibration``, ``prediction``, ``inverse_graph``, with ``scenes`` of walls,
gates and walkers)? What are the paper's results (``experiments``: Table I, Figure 4, ablation, benchmark)?
"""

import lazy_loader

# Public as a whole, and imported at first use.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["inverse_graph", "scenes"])
