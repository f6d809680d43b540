"""Plugin with a solver by PETSc's multigrid on agglo hierarchies, and functions for PETSc programs.

Names other than the declaration are imported on first use, so that listing plugins does not load PETSc.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from agglo_core.authoring import Component, hookimpl

if TYPE_CHECKING:
    from agglo_petsc.dolfinx_meshes import from_dolfinx, to_dolfinx
    from agglo_petsc.ksp.checked_solve import solve
    from agglo_petsc.ksp.pcmg import pc, setup
    from agglo_petsc.levels.aggregates import PetscLevels, aggregate_levels, given_levels
    from agglo_petsc.levels.labels import labels_of_unknowns, nested_aggregates
    from agglo_petsc.matrices import linear, mat_from_rows, to_petsc, to_scipy
    from agglo_petsc.solver.across_ranks import AcrossRanks, solve_across

_HOME = MappingProxyType(
    {
        "AcrossRanks": "solver.across_ranks",
        "PetscLevels": "levels.aggregates",
        "aggregate_levels": "levels.aggregates",
        "from_dolfinx": "dolfinx_meshes",
        "given_levels": "levels.aggregates",
        "labels_of_unknowns": "levels.labels",
        "linear": "matrices",
        "mat_from_rows": "matrices",
        "nested_aggregates": "levels.labels",
        "pc": "ksp.pcmg",
        "setup": "ksp.pcmg",
        "solve": "ksp.checked_solve",
        "solve_across": "solver.across_ranks",
        "to_dolfinx": "dolfinx_meshes",
        "to_petsc": "matrices",
        "to_scipy": "matrices",
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
    """Return the declaration of the solver ``petsc_mg``."""
    return [
        Component(
            kind="solver",
            name="petsc_mg",
            target="agglo_petsc.solver.petsc_multigrid:PetscMultigrid",
            requires=("mpi4py", "petsc4py"),
            promises={"deterministic": True, "3d": True, "pickles": True, "symmetric": True},
            summary="PETSc's PCMG on agglomerates, smoothed by patch sweeps or by PETSc's smoothers.",
        )
    ]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
