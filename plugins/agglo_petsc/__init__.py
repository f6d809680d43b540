"""Declaration of PETSc's multigrid on our hierarchies, and the functions for code that has PETSc already.

Names other than the declaration are imported when first used, so that listing plugins loads no PETSc.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from agglo_core.authoring import Component, hookimpl

if TYPE_CHECKING:
    from agglo_petsc.across_ranks import AcrossRanks, solve_across
    from agglo_petsc.aggregate_spaces import PetscLevels, aggregate_levels, given_levels
    from agglo_petsc.dolfinx_meshes import from_dolfinx, to_dolfinx
    from agglo_petsc.ksp_history import solve
    from agglo_petsc.label_levels import labels_of_unknowns, nested_aggregates
    from agglo_petsc.pcmg import pc, setup
    from agglo_petsc.petsc_matrices import mat_from_rows, to_petsc, to_scipy
    from agglo_petsc.petsc_problems import linear

_HOME = MappingProxyType(
    {
        "AcrossRanks": "across_ranks",
        "PetscLevels": "aggregate_spaces",
        "aggregate_levels": "aggregate_spaces",
        "from_dolfinx": "dolfinx_meshes",
        "given_levels": "aggregate_spaces",
        "labels_of_unknowns": "label_levels",
        "linear": "petsc_problems",
        "mat_from_rows": "petsc_matrices",
        "nested_aggregates": "label_levels",
        "pc": "pcmg",
        "setup": "pcmg",
        "solve": "ksp_history",
        "solve_across": "across_ranks",
        "to_dolfinx": "dolfinx_meshes",
        "to_petsc": "petsc_matrices",
        "to_scipy": "petsc_matrices",
    }
)
"""Module of each public name."""

__all__ = [
    "AcrossRanks",
    "PetscLevels",
    "agglo_components",
    "aggregate_levels",
    "from_dolfinx",
    "given_levels",
    "labels_of_unknowns",
    "linear",
    "mat_from_rows",
    "nested_aggregates",
    "pc",
    "setup",
    "solve",
    "solve_across",
    "to_dolfinx",
    "to_petsc",
    "to_scipy",
]


@hookimpl
def agglo_components() -> list[Component]:
    """The solver ``petsc_mg``."""
    return [
        Component(
            kind="solver",
            name="petsc_mg",
            target="agglo_petsc.petsc_multigrid:PetscMultigrid",
            requires=("mpi4py", "petsc4py"),
            promises={"deterministic": True, "3d": True, "pickles": True, "symmetric": True},
            summary="PETSc's PCMG on agglomerates, smoothed through patches or as PETSc does.",
        )
    ]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
