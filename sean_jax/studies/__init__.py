"""Studies: questions about the simulator itself, which a simulation need not ask.

Are the people right (``validation``, ``calibration``, ``prediction``, ``inverse_graph``, with ``scenes`` of walls,
gates and walkers)? What are the paper's results (``experiments``: Table I, Figure 4, ablation, benchmark)?
"""
