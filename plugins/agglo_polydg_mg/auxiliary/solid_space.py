"""Conforming auxiliary space on polyhedra: unknowns at vertices and, from degree 2, on edges."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Index, Int, Mesh, frozen_float, frozen_index, frozen_int
from agglo_core.fields.gauss_points import simplex_rule
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import orders

_REGULARISATION = 1e-4
"""Weight of the squared degree in the fit, relative to the squared trace on a box scaled to a cube.

It limits polynomials that vanish on the surface; a larger value fits the trace less closely
(benchmarks/solid_ratios.py --meshes tetrahedra --degrees 2).
"""


def solid_space(basis: Basis, *, bubbles: bool = True) -> ConformingSpace:
    """Build the continuous auxiliary space of a discontinuous polynomial space in 3-D.

    It corresponds to :func:`~agglo_polydg_mg.auxiliary.conforming_space.conforming_space`. Each vertex has
    one unknown and, from degree 2 on, so has each edge between triangles: the bubble 4 λ_a λ_b. On each
    cell a function is the polynomial closest to the trace on the surface, at degree 1 to the corner values.

    Parameters
    ----------
    basis : Basis
    bubbles : bool
        Whether edges have bubbles.
    """
    from agglo_polydg_mg.auxiliary.solid_trace_kernels import fit_corners, fit_solid_traces

    mesh, p = basis.mesh, basis.degree
    if p == 1:
        starts, vertices = mesh.cell_vertices
        indices, linear, n = fit_corners(mesh.local_points, starts, vertices, basis.boxes, basis.scale)
        return _space(starts, indices, linear, n, n)
    numbers, n_vertices = _vertices(mesh)
    edges, n = _edges(mesh, numbers, n_vertices, bubbles and p > 1)
    (offsets, faces), sizes = mesh.cell_faces, np.diff(mesh.face_offsets)
    max_unknowns = np.add.reduceat(2 * sizes[faces], offsets[:-1])
    shape = mesh.local_points, offsets, faces, mesh.face_offsets, mesh.face_vertices
    polynomials = basis.boxes, basis.scale, orders(p, 3), *simplex_rule(2, p + 1), _REGULARISATION
    limits = int(max_unknowns.sum()), int(max_unknowns.max()) + 1
    starts, unknowns, fitted = fit_solid_traces(*shape, numbers, edges, *polynomials, *limits)
    return _space(starts, unknowns, fitted, n_vertices, n)


def _space(offsets: Int, unknowns: Index, fitted: Float, n_vertices: int, n: int) -> ConformingSpace:
    given = frozen_int(offsets), frozen_index(unknowns), frozen_float(fitted), int(n_vertices), int(n)
    none = frozen_int(np.empty(0))
    return ConformingSpace(*given, none, none, 0, frozen_float(np.empty(0)))


def _vertices(mesh: Mesh) -> tuple[Int, int]:
    """Number the vertex unknowns by first cell: index at each face vertex ``(v,)``, and total number."""
    vertices, first = np.unique(mesh.cell_vertices[1], return_index=True)
    numbers = np.full(mesh.n_points, -1)
    numbers[vertices[np.argsort(first)]] = np.arange(len(vertices))
    return frozen_int(numbers[mesh.face_vertices]), len(vertices)


def _edges(mesh: Mesh, numbers: Int, n_vertices: int, has_bubbles: bool) -> tuple[Int, int]:
    """Number the edge unknowns: index on the edge after each face vertex ``(v,)``, and total number.

    Edges without an unknown have −1.
    """
    edges = np.full(len(numbers), -1)
    slots = np.flatnonzero(np.repeat(np.diff(mesh.face_offsets) == 3, np.diff(mesh.face_offsets)))
    if not has_bubbles or not len(slots):
        return frozen_int(edges), n_vertices
    ends = numbers[slots].reshape(-1, 3)
    pairs = np.stack((ends, np.roll(ends, -1, axis=1)), axis=2).reshape(-1, 2)
    keys, pair_numbers = np.unique(pairs.min(axis=1) * n_vertices + pairs.max(axis=1), return_inverse=True)
    edges[slots] = n_vertices + pair_numbers
    return frozen_int(edges), n_vertices + len(keys)
