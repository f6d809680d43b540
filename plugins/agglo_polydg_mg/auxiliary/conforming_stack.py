"""Levels of the recipe with a continuous space: cells, vertices and bubbles, then aggregates of vertices.

Smoothing on cells removes what is discontinuous; the rest is a scalar problem on vertices, which has its
own multigrid. There are no discontinuous coarse levels at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, System, frozen_int, multigrid
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, conforming_space
from agglo_polydg_mg.auxiliary.coupling_network import coupling_network
from agglo_polydg_mg.auxiliary.nodal_traces import nodal_basis, nodal_network
from agglo_polydg_mg.auxiliary.solid_space import solid_space
from agglo_polydg_mg.space.basis import Basis

_SMALL = 1e-5
"""Entries of the matrix with bubbles below this times the root of both diagonal ones are left out."""
_SMALL_BUBBLES = 0.03
"""The same between two bubbles: on squares and triangles that halves the matrix at no iteration."""
_SMALLEST_KAPPA = 0.01
"""Nothing above this times the ratio of the smallest κ to the largest is left out: groups of vertices where κ
is large hang on entries as small as its jumps."""
_ROUNDING = 1e-13
"""The same without bubbles, and whatever κ is."""
_SMALL_VERTICES = 0.01
"""Where single cells are smoothed, κ is of one size and there are no bubbles, positive entries up to this go
to the diagonal: of polygons a quarter. In space they are so many that iterations rise by half."""
_WEAK = 0.05
"""Couplings of vertices up to this part of the diagonal do not smooth the prolongation of aggregates: four in
five of those of squares, which cost more in coarse matrices than they save in iterations."""
_GROUPS = 64
"""Unknowns that strong couplings join in layers, and that are smoothed together on classical levels."""
_SWEEPS = 2
"""Sweeps of linear tetrahedra: their vertices are so few that a second one takes less than the iterations it
saves, a quarter of them."""
_ONE_SIZE = 4.0
"""Ratio of the largest to the smallest κ up to which it is of one size."""


def conforming_stack(
    system: System,
    basis: Basis,
    sigma: Float,
    kappa: Float,
    *,
    labels: Sequence[Int] | None = None,
    smoother: Callable[[Any, Int, Any], multigrid.LevelSmoother] | None = None,
    scale: Float | None = None,
    bubbles: bool = True,
    vertices: Literal["aggregates", "classical"] = "aggregates",
    layers: bool = False,
    dtype: Any = np.float32,
) -> multigrid.LevelStack:
    """Set up the levels for a system of symmetric interior penalty.

    The first is the system itself. The second has the vertices and the bubbles of
    :func:`~agglo_polydg_mg.auxiliary.conforming_space.conforming_space`, the third the vertices alone (where
    there are no bubbles the second is that; in layers, too, where points of the faces take the place of
    bubbles), the others are smoothed aggregation or classical multigrid.

    Parameters
    ----------
    system : System
        With a matrix in blocks (BSR), as :func:`~agglo_polydg_mg.forms.assembly.discretise` makes it.
    basis : Basis
        Of the system.
    sigma : (n_faces,) float
        Penalty of the faces in 1 / length, 0 on natural faces.
    kappa : (n_cells,) float
        Coefficient of the cells.
    labels : sequence of (n_cells,) int, optional
        Agglomerates, finest first: a vertex belongs to that of its first cell, and agglomerates are split
        where vertices are joined weakly. By default aggregates come from the matrix alone.
    smoother : callable
        Makes the smoother of the first level from matrix, block offsets and precision. Symmetric block
        Gauss–Seidel on cells by default; see :func:`~agglo_polydg_mg.solver.choose.choose`.
    scale : (n_cells, n_local, n_local) float, optional
        Blocks that take the coefficients of each cell to the unknowns of the first level, if it has others.
    bubbles : bool
        Whether faces have p − 1 bubbles each.
    vertices : "aggregates" or "classical"
        Smoothed aggregation below the vertices, or classical levels: then agglomerates of ``labels`` come
        after a first classical step.
    layers : bool
        Whether classical levels are to be guided by the
        :func:`~agglo_polydg_mg.auxiliary.coupling_network.coupling_network`, with bubbles by the
        :func:`~agglo_polydg_mg.auxiliary.nodal_traces.nodal_network` of vertices and points of faces.
    dtype : float32 or float64
        Precision of the cycle; matrices are set up in double precision.
    """
    # 1. The continuous space, with bubbles or with points of the faces instead of them
    nodal_traces = layers and vertices == "classical" and bubbles and basis.degree > 1
    if basis.mesh.dim == 2:
        space = conforming_space(basis, sigma, kappa, bubbles=bubbles, orthogonal=not nodal_traces)
    else:
        space = solid_space(basis, bubbles=bubbles)
    has_bubbles = space.n > space.n_vertices
    # 2. Its Galerkin matrix C, without small entries
    constant_kappa = bool(kappa.max() <= _ONE_SIZE * kappa.min())
    lumps_vertices = (
        basis.mesh.dim == 2 and smoother is None and not (has_bubbles or layers) and constant_kappa
    )
    largest_dropped = _SMALLEST_KAPPA * kappa.min() / kappa.max()
    dropped = max(min(_SMALL, largest_dropped), _ROUNDING) if has_bubbles else _ROUNDING
    C = space.galerkin(
        system.A,
        dropped,
        dropped if nodal_traces else _SMALL_BUBBLES,
        _SMALL_VERTICES if lumps_vertices else 0.0,
    )
    P, guide = space.prolongation(dtype, scale), None
    # 3. The guide of classical levels in layers
    if nodal_traces:
        T = nodal_basis(space, basis.mesh)
        C, P = sparse.csr_array(T.T @ C @ T), sparse.csr_array(P.tocsr() @ T.astype(dtype))
        C.sort_indices()
        guide = nodal_network(space, basis.mesh, kappa)
    elif layers and vertices == "classical":
        guide = coupling_network(space, basis.mesh, kappa)
    # 4. The levels: cells, bubbles if there are any, then multigrid on the vertices
    cell_smoother = (smoother or _sweeps_for(basis))(system.A, system.block_offsets, dtype)
    levels = [multigrid.Level(system.A, system.block_offsets, P, cell_smoother)]
    if has_bubbles and not nodal_traces:
        levels.append(_with_bubbles(C, space, dtype))
        C = sparse.csr_array(C[: space.n_vertices, : space.n_vertices])
    n = C.shape[0]
    vertex_labels = None if labels is None else [labels_of_unknowns(space, each)[:n] for each in labels]
    if vertices == "classical":
        vertex_stack = multigrid.classical_stack(
            C,
            labels=vertex_labels,
            near_null=np.ones(n),
            guide=guide,
            dtype=dtype,
            groups=1 if guide is None else _GROUPS,
        )
    else:
        vertex_stack = multigrid.aggregation_stack(C, labels=vertex_labels, weak=_WEAK, dtype=dtype)
    return multigrid.LevelStack([*levels, *vertex_stack.levels], vertex_stack.coarse, dtype)


def cell_sweeps(A: Any, block_offsets: Int, dtype: Any, sweeps: int = 1) -> multigrid.LevelSmoother:
    """Symmetric block Gauss–Seidel on cells, for a matrix that is symmetric as it was assembled."""
    matrix = multigrid.block_matrix(A, block_offsets, dtype, symmetric=True)
    return multigrid.GaussSeidel.on(matrix, sweeps)


def _sweeps_for(basis: Basis) -> Callable[[Any, Int, Any], multigrid.LevelSmoother]:
    """Sweeps on cells, as many as serve a space."""
    linear = basis.mesh.dim == 3 and basis.degree == 1
    tetrahedra = linear and int(np.diff(basis.mesh.cell_faces[0]).max()) == 4
    return partial(cell_sweeps, sweeps=_SWEEPS if tetrahedra else 1)


def labels_of_unknowns(space: ConformingSpace, labels: Int) -> Int:
    """Label ``(n,)`` of the first cell that has each unknown, those of vertices first."""
    cells = np.repeat(labels, np.diff(space.offsets))[::-1]
    found = np.empty(space.n, np.int64)
    found[space.unknowns[::-1]] = cells
    return frozen_int(found)


def _with_bubbles(C: Any, space: ConformingSpace, dtype: Any) -> multigrid.Level:
    """The level of vertices and bubbles, which come after them: its prolongation adds zeros."""
    P = sparse.csr_array(sparse.eye_array(space.n, space.n_vertices, dtype=dtype))
    sweeps = multigrid.ScalarGaussSeidel(C, dtype)
    return multigrid.Level(sweeps.matrix, frozen_int(np.arange(space.n + 1)), P, sweeps)
