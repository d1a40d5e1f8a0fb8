"""Studies: questions about the simulator itself, which a simulation need not ask.

Are the people right (``validation``, ``calibration``, ``prediction``, ``inverse_graph``, with ``scenes`` of walls,
gates and walkers)? What does the paper's evaluation give (``experiments``: Table I, Figure 4, ablation, benchmark)?
"""
