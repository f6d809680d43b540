"""The laws, file by file; the record of a kind in the registry names the files that judge it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from agglo_core.conformance.base.law import Law
from agglo_core.registry import KINDS

__all__ = ["all_laws", "laws_of"]


def laws_of(kind: str) -> Sequence[Law]:
    """The laws of a kind in the order in which they are judged: that of the files its record names."""
    files = [import_module(f"{__name__}.{name}") for name in KINDS[kind].laws]
    return [
        value
        for file in files
        for value in vars(file).values()
        if isinstance(value, Law) and kind in value.kinds
    ]


def all_laws() -> Sequence[Law]:
    """Every law, in the order in which the kinds first name them."""
    return list(dict.fromkeys(law for kind in KINDS for law in laws_of(kind)))
