"""The laws, one file per kind of component; in the order in which they are judged."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

from agglo_core.conformance.law import Law

__all__ = ["all_laws"]


def all_laws() -> Sequence[Law]:
    """Every law: of building and asking, of each kind, of all kinds once more, of promises."""
    from agglo_core.conformance.laws import (
        bisector,
        fixer,
        general,
        metric,
        parts,
        promises,
        refiner,
        solver,
        whole,
    )

    modules: list[ModuleType] = [general, bisector, parts, refiner, fixer, metric, solver, whole, promises]
    return [value for module in modules for value in vars(module).values() if isinstance(value, Law)]
