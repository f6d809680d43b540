"""Advice of polydg_mg and direct on which of them takes less time, in ``Solution.advice``.

The sizes are those at which both took the same CPU time, as ``tests/benchmarks/break_even.py`` measures it on
one processor in two dimensions. They are given as entries of the matrix, by which all degrees agree within a
factor of two. They are rounded, and no advice is given near them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

from agglo_core.solvers.backends import AUTO, PACKAGES, available_backends, chosen_backend

Kind = Literal["cells", "groups", "solids", "linear"]
"""Single cells of at most four faces; polygons, or cells smoothed together; polyhedra; a linear system."""

_PENALTY: Final = 10.0
"""Penalty of ``direct`` by default."""
MANY: Final = 10
"""Right-hand sides from which they count as many."""
_TITLES: Final[Mapping[str, str]] = MappingProxyType({"pardiso": "PARDISO", "superlu": "SuperLU"})


@dataclass(frozen=True)
class _Range:
    """A direct solver is faster from ``least`` to ``most`` entries, polydg_mg from ``other`` on."""

    least: float
    most: float
    other: float


_ONE: Final[Mapping[tuple[str, Kind], _Range]] = MappingProxyType(
    {
        ("pardiso", "cells"): _Range(0.0, 6e4, 2e5),
        ("pardiso", "groups"): _Range(0.0, 4e5, 1e6),
        ("pardiso", "linear"): _Range(0.0, 5e4, float("inf")),
        ("superlu", "cells"): _Range(0.0, 5e4, 1.5e5),
        ("superlu", "groups"): _Range(0.0, 1e5, 5e5),
        ("superlu", "linear"): _Range(0.0, 1e5, float("inf")),
    }
)
"""For one right-hand side. Linear systems may be of any kind, so that none is sent to multigrid."""
_SEVERAL: Final[Mapping[tuple[str, Kind], _Range]] = MappingProxyType(
    {
        ("pardiso", "linear"): _Range(0.0, 4e5, float("inf")),
        ("superlu", "linear"): _Range(0.0, 4e5, float("inf")),
    }
)
"""For ten of a linear system, as far as measured; with more the direct solvers only gain."""


def advice_of_multigrid(A: Any, kind: Kind, count: int = 1, penalty: float | str = _PENALTY) -> str:
    """What polydg_mg says of ``direct``; empty if that would not be faster.

    Parameters
    ----------
    A : (n, n) sparse
    kind : "cells", "groups" or "linear"
    count : int
        Right-hand sides.
    penalty : float, "paper" or "sharp"
        With which ``direct`` discretises alike.
    """
    table = _SEVERAL if count >= MANY else _ONE
    for backend in available_backends():
        known = table.get((backend, kind))
        if known is None or not known.least <= A.nnz <= known.most:
            continue
        size = f"up to about {_unknowns(A, known.most)} unknowns of this kind"
        size += f" with {count} right-hand sides" if count >= MANY else ""
        way = "take the solver" if count == 1 else "the inverse, for all columns, is the aspreconditioner of"
        return (
            f"{_TITLES[backend]} usually takes less time {size}: {way} {_spec(backend, penalty)}"
            f"{_missing(backend)}"
        )
    return ""


def advice_of_direct(A: Any, kind: Kind, backend: str) -> str:
    """What ``direct`` with one of its backends says of polydg_mg; empty if that would not be faster."""
    known = _ONE.get((backend, kind))
    if known is None or A.nnz < known.other:
        return ""
    return (
        f"multigrid usually takes less time than {_TITLES[backend]} from about {_unknowns(A, known.other)} "
        f"unknowns of this kind: take the solver polydg_mg{_missing(backend)}"
    )


def _unknowns(A: Any, entries: float) -> str:
    """Unknowns of a matrix like A with so many entries, to two digits."""
    return f"{float(f'{entries * A.shape[0] / A.nnz:.1e}'):,.0f}"


def _spec(backend: str, penalty: float | str) -> str:
    """``direct`` with its options, as components are written on the command line."""
    options = [] if penalty in (_PENALTY, "paper") else [f"penalty={penalty}"]
    options += [] if chosen_backend(AUTO) == backend else [f"backend={backend}"]
    return ":".join(filter(None, ("direct", ",".join(options))))


def _missing(backend: str) -> str:
    """What would be faster on large systems, and is not installed."""
    if backend != "superlu" or "pardiso" in available_backends():
        return ""
    return f"; PARDISO is not installed, and faster on large systems (pip install {PACKAGES['pardiso'][1]})"
