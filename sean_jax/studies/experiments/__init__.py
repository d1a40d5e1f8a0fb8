"""Experiments of the paper (section V), each a report by one command: Table I and Figure 4."""
