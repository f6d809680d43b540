"""Build multigrid levels with a continuous space: cells, vertices and bubbles, then vertex aggregates.

Cell smoothing removes the discontinuous errors. The rest is a scalar problem on vertices with its own
multigrid. No coarse level is discontinuous. If groups of cells are smoothed, each cell's unknowns are scaled
so that its diagonal block is the identity: otherwise single precision would lose all digits in the blocks of
flat cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mesh, Patches, System, frozen_float, frozen_int, multigrid
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, conforming_space
from agglo_polydg_mg.auxiliary.coupling_network import coupling_network
from agglo_polydg_mg.auxiliary.nodal_traces import nodal_basis, nodal_network
from agglo_polydg_mg.auxiliary.solid_space import solid_space
from agglo_polydg_mg.auxiliary.strong_faces import columns
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


_SMALL_LEVEL = 0.25
"""Entries of a level's matrix over those of the level above, up to which the level is visited twice below
patches. Patches leave so little error that a single visit would limit convergence (benchmarks/solve.py
--meshes voronoi --degrees 3)."""
_SMALL_GIVEN = 0.7
"""Entry ratio for given agglomerates, which leave more error than classical levels (benchmarks/solve.py
--hierarchy kmeans --meshes voronoi --degrees 3)."""


def conforming_stack(
    system: System,
    basis: Basis,
    sigma: Float,
    kappa: Float,
    *,
    labels: Sequence[Int] | None = None,
    smoother: Literal["cells", "groups", "patches"] = "cells",
    bubbles: bool = True,
    vertices: Literal["aggregates", "classical"] = "aggregates",
    layers: bool = False,
    dtype: Any = np.float32,
    tensors: Float | None = None,
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
    smoother : "cells", "groups" or "patches"
        Smoother of the first level: symmetric block Gauss–Seidel on single cells, on groups of up to eight
        strongly coupled cells, the :func:`~agglo_core.multigrid.strong_groups` (in 3-D on the
        :func:`~agglo_polydg_mg.auxiliary.strong_faces.columns` of flat cells), or on vertex patches, which
        take half the iterations and several times the time and memory of a sweep. See
        :func:`~agglo_polydg_mg.solver.choose.choose`.
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
    tensors : (n_cells, d, d) float, optional
        Coefficient per cell, along which vertex patches extend.

    Raises
    ------
    LinAlgError
        If the matrix is not positive definite on a cell or a group.
    """
    # 1. The continuous space, with bubbles or with face points, and its Galerkin matrix C
    mesh, in_layers = basis.mesh, layers and vertices == "classical"
    nodal_traces = in_layers and bubbles and basis.degree > 1
    if mesh.dim == 2:
        space = conforming_space(basis, sigma, kappa, bubbles=bubbles, orthogonal=not nodal_traces)
    else:
        space = solid_space(basis, bubbles=bubbles)
    lumps_vertices = mesh.dim == 2 and smoother == "cells" and not layers
    C = space.galerkin(system.A, *_drop_limits(space, kappa, nodal_traces, lumps_vertices))
    # 2. The prolongation to scaled cells, if they are smoothed in groups
    scaled = None if smoother == "cells" else multigrid.block_scaled(system.A)
    P = space.prolongation(dtype, None if scaled is None else frozen_float(scaled.LT.data))
    # 3. The guide of classical levels in layers
    guide = None
    if nodal_traces:
        T = nodal_basis(space, mesh)
        C, P = sparse.csr_array(T.T @ C @ T), sparse.csr_array(P.tocsr() @ T.astype(dtype))
        C.sort_indices()
        guide = nodal_network(space, mesh, kappa)
    elif in_layers:
        guide = coupling_network(space, mesh, kappa)
    # 4. Stack the levels: cells, bubbles if there are any, then multigrid on the vertices
    levels = []
    if space.n > space.n_vertices and not nodal_traces:
        levels.append(_with_bubbles(C, space, dtype))
        C = sparse.csr_array(C[: space.n_vertices, : space.n_vertices])
    n = C.shape[0]
    vertex_labels = None if labels is None else [labels_of_unknowns(space, each)[:n] for each in labels]
    if vertices == "classical":
        options: Any = {"near_null": np.ones(n), "guide": guide, "groups": 1 if guide is None else _GROUPS}
        below = multigrid.classical_stack(C, labels=vertex_labels, dtype=dtype, **options)
    else:
        below = multigrid.aggregation_stack(C, labels=vertex_labels, weak=_WEAK, dtype=dtype)
    levels += below.levels
    if scaled is None:
        sweeps = _sweeps_for(basis)(system.A, system.block_offsets, dtype)
        top = multigrid.Level(system.A, system.block_offsets, P, sweeps)
        return multigrid.LevelStack([top, *levels], below.coarse, dtype)
    groups = _groups(mesh, scaled.A, smoother, tensors)
    patches = multigrid.VertexPatches(scaled.A, groups, dtype)
    top = multigrid.Level(patches.A, system.block_offsets, P, patches, patches=groups)
    if smoother == "patches":
        levels = _with_visits(levels, system.A, _SMALL_LEVEL if labels is None else _SMALL_GIVEN)
    return multigrid.LevelStack([top, *levels], below.coarse, dtype, scaled.T)


def _drop_limits(
    space: ConformingSpace, kappa: Float, nodal_traces: bool, lumps_vertices: bool
) -> tuple[float, float, float]:
    """Return the limits of small entries of C: of all, between bubbles, and between vertices."""
    if space.n == space.n_vertices:
        constant = bool(kappa.max() <= _ONE_SIZE * kappa.min())
        return _ROUNDING, _SMALL_BUBBLES, _SMALL_VERTICES if lumps_vertices and constant else 0.0
    small = max(min(_SMALL, _SMALLEST_KAPPA * kappa.min() / kappa.max()), _ROUNDING)
    return small, small if nodal_traces else _SMALL_BUBBLES, 0.0


def _groups(mesh: Mesh, A: Any, smoother: str, tensors: Float | None) -> Patches:
    """Return the cells that are smoothed together."""
    if smoother == "patches":
        return multigrid.vertex_patches(mesh, tensors=tensors)
    if mesh.dim == 3:
        return columns(mesh)[0]
    return multigrid.strong_groups(A)


def _with_visits(levels: Sequence[multigrid.Level], A: Any, small: float) -> list[multigrid.Level]:
    """Return the levels below ``A``, with two visits if they have few entries beside the level above."""
    above = [A, *(level.A for level in levels)]
    return [
        replace(level, visits=2 if level.A.nnz <= small * finer.nnz else 1)
        for level, finer in zip(levels, above, strict=False)
    ]


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
