"""Build the system on the mesh and the spaces of the multigrid levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Float,
    Hierarchy,
    Int,
    Linear,
    Mesh,
    MeshError,
    Problem,
    System,
    frozen_float,
    frozen_int,
    multigrid,
    solvers,
)
from agglo_core.fields.corrections import corrections
from agglo_polydg_mg.auxiliary.box_transfer import project_between
from agglo_polydg_mg.auxiliary.transfer import l2_projection
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import Basis


@dataclass(frozen=True, eq=False)
class LevelSpaces:
    """System on the mesh, and coarse level spaces, finest first.

    Attributes
    ----------
    fine : solvers.FineSystem
    system : System
        The system in the form for compositions of multigrid parts.
    injected : list of sparse
        Coarse functions on the next finer level: injected, or L2-projected if the levels are not
        nested.
    rediscretised : list of callables, optional
        Each returns the matrix of a coarse level; None for a linear system.
    """

    fine: solvers.FineSystem
    system: System
    injected: list[Any]
    rediscretised: Sequence[Callable[[], Any]] | None = None


def level_spaces(problem: Problem, hierarchy: Hierarchy, labels: Sequence[Int], how: PolyDG) -> LevelSpaces:
    """Build the system on the mesh and the coarse spaces for a problem.

    Parameters
    ----------
    labels : sequence of (n_cells,) int
        Coarse level labels, finest first. For a diffusion problem coarse unknowns are
        polynomials on the agglomerates, for a linear system constants, one per unknown of a cell.

    Raises
    ------
    OptionError
        See :func:`~agglo_core.solvers.fine_system.fine_system`.
    MeshError
        For a mesh with self-overlapping cells; a callable in ``rediscretised``, for such agglomerates.
    """
    fine = solvers.fine_system(problem, hierarchy, how)
    offsets = frozen_int(np.arange(0, fine.A.shape[0] + 1, fine.width))
    # Linear systems: piecewise constants
    if isinstance(problem, Linear):
        near_null = None if problem.near_null is None else _columns(problem.near_null)
        system = System.trusted(fine.A, fine.b, offsets, hierarchy.fine, near_null)
        return LevelSpaces(fine, system, _constant_prolongations(hierarchy, labels, fine.width))
    # Diffusion problems: polynomials on the mesh and its agglomerates
    mesh = solvers.own_mesh(hierarchy)
    meshes = [mesh.coarsen(item) for item in labels]
    bases = [how.basis(item) for item in (mesh, *meshes)]
    constant = frozen_float(bases[0].project(lambda points: np.ones(len(points)))[:, None])
    system = System.trusted(fine.A, fine.b, offsets, mesh, constant)
    rediscretised = [
        partial(_coarse_matrix, how, problem, mesh, *item) for item in zip(labels, meshes, strict=True)
    ]
    return LevelSpaces(fine, system, polydg_prolongations(bases, labels), rediscretised)


def _columns(vectors: Any) -> Float:
    found = np.asarray(vectors, np.float64)
    return frozen_float(found if found.ndim == 2 else found[:, None])


def _coarse_matrix(how: PolyDG, problem: Problem, mesh: Mesh, labels: Int, coarse: Mesh) -> Any:
    assert isinstance(problem, Diffusion)  # PolyDG accepts no other problem
    try:
        return how.assemble(corrections(problem, mesh, labels), coarse).A
    except MeshError as error:  # the mesh itself may work although its agglomerates overlap
        raise MeshError(
            f"on the level with {coarse.n_cells} agglomerates: {error} (operators='inherited' or "
            "coarse_operator='galerkin' avoids this)"
        ) from error


def polydg_prolongations(bases: Sequence[Basis], labels: Sequence[Int]) -> list[Any]:
    """Return the prolongations between the spaces of a mesh and its agglomerates, finest first."""
    P = []
    for level, coarse in enumerate(labels):
        nested = multigrid.parents(labels[level - 1], coarse) if level else coarse
        if nested is not None:
            P.append(project_between(bases[level], bases[level + 1], nested))
            continue
        down = [project_between(bases[0], bases[at], labels[at - 1]) for at in (level, level + 1)]
        P.append(l2_projection(down[0], down[1], bases[0].mass(), bases[0].n_local))
    return P


def _constant_prolongations(hierarchy: Hierarchy, labels: Sequence[Int], width: int) -> list[Any]:
    P = []
    mass = sparse.diags_array(np.repeat(hierarchy.graph.measures, width)).tocsr()
    for level, coarse in enumerate(labels):
        nested = multigrid.parents(labels[level - 1], coarse) if level else coarse
        if nested is not None:
            P.append(multigrid.injection(nested, width))
        else:
            down = [multigrid.injection(each, width) for each in labels[level - 1 : level + 1]]
            P.append(l2_projection(down[0], down[1], mass, width))
    return P
