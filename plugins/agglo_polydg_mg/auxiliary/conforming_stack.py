"""Build multigrid levels with a continuous space: cells, vertices and bubbles, then vertex aggregates.

Cell smoothing removes the discontinuous errors. The rest is a scalar problem on vertices with its own
multigrid. No coarse level is discontinuous.
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
"""Entries of the matrix with bubbles up to this multiple of the geometric mean of both diagonal entries are
dropped. A larger value makes cycles cheaper and weaker (benchmarks/solve.py --degrees 2 3)."""
_SMALL_BUBBLES = 0.03
"""Drop limit between two bubbles: on squares and triangles it halves the matrix and costs no iteration
(benchmarks/solve.py --meshes squares triangles)."""
_SMALLEST_KAPPA = 0.01
"""The drop limit is at most this factor times κ_min / κ_max: vertex groups with large κ are coupled by
entries as small as its jumps. It is below _SMALL if κ spans more than three decades."""
_ROUNDING = 1e-13
"""Drop limit without bubbles, and lower bound of the drop limit for any κ: relative rounding of a Galerkin
product in double precision, with a margin."""
_SMALL_VERTICES = 0.01
"""Limit for positive entries that move to the diagonal, if single cells are smoothed, κ is nearly constant
and there are no bubbles: a quarter of the entries on polygons. In 3-D there are so many that iterations
would rise by half (benchmarks/solve.py --meshes voronoi)."""
_WEAK = 0.05
"""Vertex couplings up to this fraction of the diagonal do not smooth the prolongation of aggregates: four
fifths of the couplings on squares, which cost more in coarse matrices than they save in iterations
(benchmarks/solve.py --meshes squares)."""
_GROUPS = 64
"""Largest group of strongly coupled unknowns smoothed together on classical levels in layers. Larger groups
smooth better, and each sweep takes longer (benchmarks/solve.py --meshes layers)."""
_SWEEPS = 2
"""Sweeps for linear tetrahedra: they have so few vertices that a second sweep costs less than the
iterations it saves, a quarter (benchmarks/solid_ratios.py)."""
_ONE_SIZE = 4.0
"""Ratio κ_max / κ_min up to which κ counts as nearly constant (benchmarks/time_steps.py, at ratio 7)."""


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
    """Build multigrid levels with continuous coarse spaces for a symmetric interior penalty system.

    The first level is the system itself. The second has the vertices and bubbles of
    :func:`~agglo_polydg_mg.auxiliary.conforming_space.conforming_space`, the third the vertices alone.
    Without bubbles, and in layers, where face points replace bubbles, these two are a single level.
    Smoothed aggregation or classical multigrid follows.

    Parameters
    ----------
    system : System
        System with a block matrix (BSR) from :func:`~agglo_polydg_mg.forms.assembly.discretise`.
    basis : Basis
        Basis of the system.
    sigma : (n_faces,) float
        Face penalty in 1 / length, 0 on natural faces.
    kappa : (n_cells,) float
        Cell coefficient.
    labels : sequence of (n_cells,) int, optional
        Agglomerates, finest first: a vertex belongs to its first cell's agglomerate, and agglomerates
        are split at weak vertex couplings. By default the matrix alone defines the aggregates.
    smoother : callable
        Returns the first level's smoother from matrix, block offsets and precision. By default
        symmetric block Gauss–Seidel on cells; see :func:`~agglo_polydg_mg.solver.choose.choose`.
    scale : (n_cells, n_local, n_local) float, optional
        Blocks that map cell coefficients to first-level unknowns, if these differ.
    bubbles : bool
        Whether faces have p − 1 bubbles each.
    vertices : "aggregates" or "classical"
        Smoothed aggregation below the vertices, or classical levels: then the agglomerates of ``labels``
        follow a first classical step.
    layers : bool
        Guide classical levels by the :func:`~agglo_polydg_mg.auxiliary.coupling_network.coupling_network`,
        with bubbles by the :func:`~agglo_polydg_mg.auxiliary.nodal_traces.nodal_network` of vertices and
        face points.
    dtype : float32 or float64
        Cycle precision; the set-up uses double precision.
    """
    # 1. Build the continuous space, with bubbles or with face points
    nodal_traces = layers and vertices == "classical" and bubbles and basis.degree > 1
    if basis.mesh.dim == 2:
        space = conforming_space(basis, sigma, kappa, bubbles=bubbles, orthogonal=not nodal_traces)
    else:
        space = solid_space(basis, bubbles=bubbles)
    has_bubbles = space.n > space.n_vertices
    # 2. Compute its Galerkin matrix C, without small entries
    constant_kappa = bool(kappa.max() <= _ONE_SIZE * kappa.min())
    lumps_vertices = (
        basis.mesh.dim == 2 and smoother is None and not (has_bubbles or layers) and constant_kappa
    )
    largest_dropped = _SMALLEST_KAPPA * kappa.min() / kappa.max()
    drop_tolerance = max(min(_SMALL, largest_dropped), _ROUNDING) if has_bubbles else _ROUNDING
    C = space.galerkin(
        system.A,
        drop_tolerance,
        drop_tolerance if nodal_traces else _SMALL_BUBBLES,
        _SMALL_VERTICES if lumps_vertices else 0.0,
    )
    P, guide = space.prolongation(dtype, scale), None
    # 3. Build the guide of classical levels in layers
    if nodal_traces:
        T = nodal_basis(space, basis.mesh)
        C, P = sparse.csr_array(T.T @ C @ T), sparse.csr_array(P.tocsr() @ T.astype(dtype))
        C.sort_indices()
        guide = nodal_network(space, basis.mesh, kappa)
    elif layers and vertices == "classical":
        guide = coupling_network(space, basis.mesh, kappa)
    # 4. Stack the levels: cells, bubbles if there are any, then multigrid on the vertices
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
    """Return symmetric block Gauss–Seidel with one block per cell, for an exactly symmetric matrix."""
    matrix = multigrid.block_matrix(A, block_offsets, dtype, symmetric=True)
    return multigrid.GaussSeidel.on(matrix, sweeps)


def _sweeps_for(basis: Basis) -> Callable[[Any, Int, Any], multigrid.LevelSmoother]:
    """Return block Gauss–Seidel on cells: two sweeps for linear tetrahedra, otherwise one."""
    linear = basis.mesh.dim == 3 and basis.degree == 1
    tetrahedra = linear and int(np.diff(basis.mesh.cell_faces[0]).max()) == 4
    return partial(cell_sweeps, sweeps=_SWEEPS if tetrahedra else 1)


def labels_of_unknowns(space: ConformingSpace, labels: Int) -> Int:
    """Return each unknown's label ``(n,)``: its first cell's agglomerate.

    Vertex unknowns precede bubbles.
    """
    cells = np.repeat(labels, np.diff(space.offsets))[::-1]
    found = np.empty(space.n, np.int64)
    found[space.unknowns[::-1]] = cells
    return frozen_int(found)


def _with_bubbles(C: Any, space: ConformingSpace, dtype: Any) -> multigrid.Level:
    """Build the multigrid level of vertices and bubbles, whose prolongation is 0 on bubbles."""
    P = sparse.csr_array(sparse.eye_array(space.n, space.n_vertices, dtype=dtype))
    sweeps = multigrid.ScalarGaussSeidel(C, dtype)
    return multigrid.Level(sweeps.matrix, frozen_int(np.arange(space.n + 1)), P, sweeps)
