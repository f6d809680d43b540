"""Distribution of a linear system over a communicator's ranks, and its multigrid levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from agglo_core.authoring import Float, Int, OptionError, Patches, frozen_float, frozen_int, multigrid
from agglo_petsc.ksp.pcmg import Smoother
from agglo_petsc.levels.aggregates import PetscLevels, aggregate_levels, given_levels
from agglo_petsc.matrices import mat_from_rows, vector
from agglo_petsc.ranks.row_shares import RowShare, row_share, usable_levels
from agglo_petsc.solver.posed_systems import PosedSystem

Coarsening = Literal["auto", "agglomerates", "matrix"]
COARSENINGS: Final = ("auto", "agglomerates", "matrix")


@dataclass(frozen=True, eq=False)
class SystemOnRanks:
    """Distributed matrix, right-hand side and levels, with the original row numbers ``rows (n,)``."""

    A: Any
    b: Any
    levels: PetscLevels
    rows: Int
    choice: str

    def gathered(self, own: Float) -> Float:
        """Collect a distributed vector on all ranks ``(n,)``, in the original order."""
        whole = np.empty(len(self.rows))
        whole[self.rows] = np.concatenate(self.A.getComm().tompi4py().allgather(own))
        return frozen_float(whole)


def on_ranks(system: PosedSystem, comm: Any, coarsening: Coarsening, smoother: Smoother) -> SystemOnRanks:
    """Distribute a system known to all ranks between them, and build its levels. Collective.

    Raises
    ------
    OptionError
        If levels are not nested, or for matrix levels on several ranks; see also
        :func:`~agglo_petsc.levels.aggregates.aggregate_levels`.
    """
    # 1. Choose the levels and the cells of this rank
    rank, ranks = comm.getRank(), comm.getSize()
    from_matrix = coarsening == "matrix" or (coarsening == "auto" and system.mesh is None and ranks == 1)
    if from_matrix and ranks > 1:
        raise OptionError("coarsening 'matrix' needs one rank; use 'agglomerates' on several")
    labels = [] if from_matrix else usable_levels(system.labels, ranks)
    share = row_share(labels, len(system.offsets) - 1, rank, ranks)
    # 2. Matrix and right-hand side
    own_unknowns, rows = (_unknowns(system.offsets, cells) for cells in (share.cells, share.order))
    place = np.empty(len(rows), np.int64)
    place[rows] = np.arange(len(rows))
    width = _width(system.offsets)
    A = mat_from_rows(
        _renumber_columns(system.A[own_unknowns], place), comm, len(own_unknowns), (width or 1, width or 1)
    )
    b = vector(A, frozen_float(system.b[own_unknowns]))
    # 3. Levels from the matrix, or from agglomerates
    if from_matrix:
        return SystemOnRanks(A, b, _from_matrix(system), rows, "levels from the matrix")
    near = None if system.near_null is None else system.near_null[own_unknowns]
    offsets = np.concatenate(([0], np.cumsum(np.diff(system.offsets)[share.cells])))
    levels = aggregate_levels(
        A,
        share.aggregates,
        near,
        block_offsets=offsets,
        patches=_patches(system, labels, share, smoother),
    )
    return SystemOnRanks(A, b, levels, rows, f"{len(labels)} levels of agglomerates")


def _unknowns(offsets: Int, cells: Int) -> Int:
    """Return the indices of some cells' unknowns, cell by cell."""
    sizes = np.diff(offsets)[cells]
    first = np.concatenate(([0], np.cumsum(sizes)))
    return frozen_int(np.repeat(offsets[cells] - first[:-1], sizes) + np.arange(first[-1]))


def _renumber_columns(rows: Any, place: Int) -> Any:
    """Return matrix rows with column j renumbered to ``place[j]``."""
    renumbered_rows = rows.copy()
    renumbered_rows.indices = place[rows.indices].astype(rows.indices.dtype)
    renumbered_rows.has_sorted_indices = False
    return renumbered_rows


def _width(offsets: Int) -> int | None:
    sizes = np.diff(offsets)
    return int(sizes[0]) if (sizes == sizes[0]).all() else None


def _patches(
    system: PosedSystem, labels: list[Int], share: RowShare, smoother: Smoother
) -> list[Patches | None] | None:
    """Return the vertex patches per level, or None if the smoother uses none.

    In 3-D sweeps visit single parts, unless patches are requested: their matrices are large there.
    """
    mesh = system.mesh
    if mesh is None or smoother in ("blocks", "sor") or (mesh.dim == 3 and smoother != "patches"):
        return None
    below = [None, *labels[:-1]]
    return [
        share.patches(k, multigrid.vertex_patches(mesh, each)) for k, each in enumerate(below[: len(labels)])
    ]


def _from_matrix(system: PosedSystem) -> PetscLevels:
    """Aggregate strongly coupled parts, keeping agglomerates as far as they suit the matrix."""
    stack = multigrid.aggregation_stack(
        system.A,
        labels=system.labels or None,
        near_null=system.near_null,
        block_offsets=system.offsets,
        smoother=_no_smoother,
    )
    above = stack.levels[:-1]
    return given_levels([each.P for each in above], widths=[_width(each.block_offsets) for each in above])


def _no_smoother(A: Any, block_offsets: Int, dtype: Any) -> Any:
    """Return None, because PETSc provides the smoother."""
    return None
