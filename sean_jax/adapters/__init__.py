"""Interfaces of other projects to the same environments: Gymnasium, gymnax, Brax, each imported when asked for."""
