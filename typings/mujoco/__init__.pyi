"""MuJoCo has no type stubs: for pyright, each of its names is of any type."""

from typing import Any

def __getattr__(name: str) -> Any: ...
