"""Checks of `sean validate` that are made up."""

from dataclasses import dataclass
from typing import Any

from sean_jax.studies.validation.checks import Check


@dataclass(frozen=True)
class MadeCheck(Check):
    """A check whose function is in no module."""

    own: Any = None

    def run(self, context):
        return self.own(context)


def made_check(name: str, function: Any) -> Check:
    label = getattr(function, "__name__", "")
    return MadeCheck(name, "Title <b>", "set-up", "measure", "criterion", "source", label, own=function)
