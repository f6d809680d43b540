"""Advice on the faster solver, multigrid (polydg_mg) or direct, for ``Solution.advice``.

The sizes below are the break-even sizes: both solvers take equal CPU time there, as measured by
``tests/benchmarks/break_even.py`` on one processor in 2-D. The sizes count matrix entries, because all
degrees then agree within a factor of two. They are rounded, and no advice is given near them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np

from agglo_core.solvers.backends import AUTO, PACKAGES, available_backends, choose_backend

Kind = Literal["cells", "groups", "solids", "linear", "plane", "plane blocks"]
"""Single cells of at most four faces, polygons or cells smoothed in groups, polyhedra, linear systems: any,
scalar on a mesh in 2-D, or with several unknowns per cell of it."""

_PENALTY: Final = 10.0
"""Default penalty constant of ``direct``, without unit."""
MANY: Final = 10
"""Minimum number of right-hand sides for the table ``_SEVERAL`` (benchmarks/break_even.py --many)."""
_STEPS: Final = 5
"""Smoothing steps after which the rest of a random vector counts as slow error."""
_NULL: Final = 1e-6
"""Maximum force of a translation, relative to the diagonal, that counts as 0."""
_CANCELLED: Final = 0.1
"""Maximum energy of slow errors relative to that of their components, for λ / μ from about 50."""
_TITLES: Final[Mapping[str, str]] = MappingProxyType({"pardiso": "PARDISO", "superlu": "SuperLU"})


@dataclass(frozen=True)
class _Range:
    """Ranges of matrix entries: direct is faster from ``least`` to ``most``, polydg_mg from ``other`` on."""

    least: float
    most: float
    other: float


_ONE: Final[Mapping[tuple[str, Kind], _Range]] = MappingProxyType(
    {
        ("pardiso", "cells"): _Range(0.0, 6e4, 2e5),
        ("pardiso", "groups"): _Range(0.0, 4e5, 1e6),
        ("pardiso", "linear"): _Range(0.0, 5e4, float("inf")),
        ("pardiso", "plane"): _Range(0.0, 1.4e5, float("inf")),
        ("pardiso", "plane blocks"): _Range(0.0, 9e5, float("inf")),
        ("superlu", "cells"): _Range(0.0, 5e4, 1.5e5),
        ("superlu", "groups"): _Range(0.0, 1e5, 5e5),
        ("superlu", "linear"): _Range(0.0, 1e5, float("inf")),
        ("superlu", "plane"): _Range(0.0, 1e5, float("inf")),
        ("superlu", "plane blocks"): _Range(0.0, 1e5, float("inf")),
    }
)
"""One right-hand side, sizes in matrix entries (benchmarks/break_even.py).

Linear systems may be of any kind, so none is referred to multigrid.
"""
_SEVERAL: Final[Mapping[tuple[str, Kind], _Range]] = MappingProxyType(
    {
        ("pardiso", "linear"): _Range(0.0, 4e5, float("inf")),
        ("superlu", "linear"): _Range(0.0, 4e5, float("inf")),
    }
)
"""Ten right-hand sides of a linear system, sizes in matrix entries (benchmarks/break_even.py).

With more, the advantage of direct solvers only grows.
"""


def advice_of_multigrid(A: Any, kind: Kind, count: int = 1, penalty: float | str = _PENALTY) -> str:
    """Return the advice to use ``direct`` instead of polydg_mg, or an empty text if ``direct`` is slower.

    Parameters
    ----------
    A : (n, n) sparse
    kind : "cells", "groups", "linear", "plane" or "plane blocks"
    count : int
        Number of right-hand sides.
    penalty : float, "paper" or "sharp"
        Penalty that gives ``direct`` an equal discretisation.
    """
    table = _ONE
    if count >= MANY:
        table, kind = _SEVERAL, "linear" if kind.startswith("plane") else kind
    for backend in available_backends():
        limits = table.get((backend, kind))
        if limits is None or not limits.least <= A.nnz <= limits.most:
            continue
        size = f"up to about {_unknowns(A, limits.most)} unknowns of this kind"
        size += f" with {count} right-hand sides" if count >= MANY else ""
        way = (
            "use the solver"
            if count == 1
            else "for the inverse of all columns use aspreconditioner of the solver"
        )
        return (
            f"{_TITLES[backend]} usually takes less time {size}: {way} {_spec(backend, penalty)}"
            f"{_suggest_pardiso(backend)}"
        )
    return ""


def advice_of_direct(A: Any, kind: Kind, backend: str) -> str:
    """Return the advice to use polydg_mg instead of ``direct``, or an empty text if polydg_mg is slower."""
    limits = _ONE.get((backend, kind))
    if limits is None or A.nnz < limits.other:
        return ""
    return (
        f"multigrid usually takes less time than {_TITLES[backend]} from about "
        f"{_unknowns(A, limits.other)} unknowns of this kind: use the solver "
        f"polydg_mg{_suggest_pardiso(backend)}"
    )


def advice_after_failure(degree: int = 1, penalty: float | str = _PENALTY) -> str:
    """Return the advice to use ``direct``, with an equal discretisation, after multigrid did not converge.

    Examples
    --------
    >>> from agglo_core.solvers import advice_after_failure
    >>> advice_after_failure(2, "sharp")
    'multigrid did not converge, but a direct method may: use the solver direct:degree=2,penalty=sharp'
    """
    spec = _spec(choose_backend(AUTO), penalty, degree)
    return f"multigrid did not converge, but a direct method may: use the solver {spec}"


def advice_of_components(A: Any, M: Any, width: int) -> str:
    """Return the advice not to use multigrid if the energies of the components of slow errors cancel.

    In elasticity with λ ≫ μ each component alone costs an energy of order λ, but divergence-free fields cost
    only μ, and levels for general fields miss these. The slow errors are what five steps e − M A e leave of a
    random vector. Their energy is about 4 μ / λ times that of their components. The text is empty unless
    translations, each component by itself, are near-null vectors.

    Parameters
    ----------
    A : (n, n) sparse
    M : operator
        Preconditioner of A.
    width : int
        Number of components: unknown i belongs to component i modulo ``width``.
    """
    of_component = np.arange(A.shape[0])[:, None] % width == np.arange(width)
    forces = np.abs(A @ of_component.astype(float))
    if np.median(forces.max(axis=1)) > _NULL * np.median(A.diagonal()):
        return ""
    e = np.random.default_rng(0).standard_normal(A.shape[0])
    for _ in range(_STEPS):
        e = e - M @ (A @ e)
    parts = (e * of_component[:, j] for j in range(width))
    ratio = float(e @ (A @ e)) / sum(float(part @ (A @ part)) for part in parts)
    if not 0.0 <= ratio <= _CANCELLED:
        return ""
    return (
        f"the energies of the {width} components of slow errors cancel to {100 * ratio:.1g} %, as in nearly "
        "incompressible elasticity (λ much larger than μ), where multigrid takes many iterations: use the "
        "solver direct, or a mixed formulation"
    )


def _unknowns(A: Any, entries: float) -> str:
    """Estimate the unknowns of a matrix like A with that many entries, as text with two digits."""
    return f"{float(f'{entries * A.shape[0] / A.nnz:.1e}'):,.0f}"


def _spec(backend: str, penalty: float | str, degree: int = 1) -> str:
    """Return the solver ``direct`` with its options in command-line notation."""
    options = [] if degree == 1 else [f"degree={degree}"]
    options += [] if penalty in (_PENALTY, "paper") else [f"penalty={penalty}"]
    options += [] if choose_backend(AUTO) == backend else [f"backend={backend}"]
    return ":".join(filter(None, ("direct", ",".join(options))))


def _suggest_pardiso(backend: str) -> str:
    """Return a hint at PARDISO if only SuperLU is installed, else an empty text."""
    if backend != "superlu" or "pardiso" in available_backends():
        return ""
    return (
        f"; PARDISO is not installed, but is faster on large systems (pip install {PACKAGES['pardiso'][1]})"
    )
