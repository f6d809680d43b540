"""Laws for each component kind, sorted into modules.

Each kind's registry record names the files with its laws.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from agglo_core.conformance.base import Law
from agglo_core.registry import KINDS

__all__ = ["all_laws", "laws_of"]


def laws_of(kind: str) -> Sequence[Law]:
    """Return the laws for a kind of component, in the order of testing."""
    files = [import_module(f"{__name__}.{name}") for name in KINDS[kind].laws]
    return [
        value
        for file in files
        for value in vars(file).values()
        if isinstance(value, Law) and kind in value.kinds
    ]


def all_laws() -> Sequence[Law]:
    """Return all laws, ordered by component kind."""
    return list(dict.fromkeys(law for kind in KINDS for law in laws_of(kind)))
