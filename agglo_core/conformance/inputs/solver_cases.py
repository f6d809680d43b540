"""Test cases for solvers: a plate with tagged sides, unusual levels, and systems unlike diffusion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import laplacian
from agglo_core.conformance.inputs.mesh_changes import Change, renumber_mesh, transform_mesh
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Linear

SIDES = LEFT, RIGHT, BOTTOM, TOP = -1, 101, 2, 300
"""Boundary tags of a :func:`plate`, as mesh generators may number them."""

CORNER = LEFT, RIGHT, BOTTOM, RIGHT
"""Boundary tags of a plate with the same tag on both sides of the upper right corner."""


def plate(
    nx: int = 8, ny: int = 6, tag: str = "boundary", tags: tuple[int, int, int, int] = SIDES
) -> Hierarchy:
    """Return a hierarchy on a grid of [0, 2] × [0, 1], with side tags and agglomerates of 2 by 2 cells."""
    mesh = small_meshes.grid(nx, ny, width=2.0 / nx, height=1.0 / ny)
    # Tag boundary faces by their midpoint.
    x, y = mesh.points[mesh.face_vertices[mesh.face_offsets[:-1]]].T
    ends = mesh.points[mesh.face_vertices[mesh.face_offsets[1:] - 1]]
    x, y = (x + ends[:, 0]) / 2, (y + ends[:, 1]) / 2
    sides = np.select([x < 1e-9, x > 2 - 1e-9, y < 1e-9, y > 1 - 1e-9], tags, 0)
    tagged_mesh = replace(mesh, face_tags={tag: sides}, name=f"a plate of {nx} by {ny}")
    row, column = np.divmod(np.arange(nx * ny), nx)
    return on_levels(tagged_mesh, frozen_int(row // 2 * ((nx + 1) // 2) + column // 2))


def block() -> Hierarchy:
    """Return a hierarchy on a grid of unequal boxes, with side tags 1 to 6 for low and high x, y, z."""
    mesh = small_meshes.boxes()
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    corners = mesh.points[mesh.face_vertices.reshape(mesh.n_faces, 4)]
    beyond = np.stack((low - corners, corners - high), axis=-1) > -1e-9
    on_side = beyond.all(axis=1).reshape(mesh.n_faces, 6)
    sides = np.where(on_side.any(axis=1), 1 + on_side.argmax(axis=1), 0)
    tagged_mesh = replace(mesh, face_tags={"boundary": sides}, name="a block of boxes")
    return on_levels(tagged_mesh, frozen_int(np.arange(mesh.n_cells) // 4))


def halves(hierarchy: Hierarchy, left: float, right: float) -> Float:
    """Return cell values ``(n_cells,)`` with a jump between the left and the right half of a plate."""
    assert hierarchy.fine is not None
    return frozen_float(np.where(hierarchy.fine.cell_centroids[:, 0] < 1.0, left, right))


def on_levels(mesh: Mesh, *levels: Int) -> Hierarchy:
    """Return the hierarchy with the given labels for each level, finest first."""
    targets = [{"n_parts": int(labels.max()) + 1} for labels in levels]
    return Hierarchy(mesh, mesh.graph, list(levels), targets, nested=True)


def transform_hierarchy(hierarchy: Hierarchy, change: Change | None) -> tuple[Hierarchy, Int]:
    """Transform or renumber the mesh of a hierarchy, and return also the old index per cell.

    If ``change`` is None, the mesh is renumbered.
    """
    assert hierarchy.fine is not None
    if change is not None:
        mesh, order = transform_mesh(hierarchy.fine, change), frozen_int(np.arange(hierarchy.graph.n))
    else:
        mesh, order = renumber_mesh(hierarchy.fine)
    return on_levels(mesh, *(frozen_int(labels[order]) for labels in hierarchy.levels)), order


def uneven(graph: Graph, per_cell: int, seed: int = 0) -> Linear:
    """Return a linear system with random couplings from 1 to 100, and a random right-hand side."""
    rng = np.random.default_rng(seed)
    links = sparse.triu(graph.to_scipy(), format="coo")
    links = sparse.coo_array((10 ** rng.uniform(0, 2, links.nnz), links.coords), shape=links.shape).tocsr()
    links = links + links.T
    scalar = sparse.diags_array(links.sum(axis=1) + rng.uniform(0.1, 1.0, graph.n)) - links
    A = sparse.csr_array(sparse.kron(scalar, sparse.eye_array(per_cell)))
    return Linear(
        A, frozen_float(rng.standard_normal(A.shape[0])), frozen_int(np.arange(graph.n + 1) * per_cell)
    )


def awkward_cases() -> list[Case]:
    """Return test cases with rough coefficients, one part, three levels, disconnected parts, or no mesh."""
    mesh = small_meshes.grid(8, 8)
    row, column = np.divmod(np.arange(64), 8)
    fours, whole = frozen_int(row // 2 * 4 + column // 2), frozen_int(np.zeros(64))
    quarters = frozen_int(row // 4 * 2 + column // 4)
    loose = frozen_int(row % 2 * 2 + column % 2)
    graph = mesh.graph
    kappa = frozen_float(10 ** np.random.default_rng(3).uniform(-1.5, 1.5, 64))
    shapes = {
        "one part": on_levels(mesh, whole),
        "three levels": on_levels(mesh, fours, quarters, whole),
        "disconnected parts": on_levels(mesh, loose),
    }
    meshless_hierarchy = Hierarchy(None, graph, [fours], [{"n_parts": 16}], nested=True)
    rough = Diffusion(kappa=kappa, source=lambda x: np.where(x[:, 0] < 4.0, 1.0, -3.0))
    return [
        Case("a coefficient that jumps from cell to cell", (rough, on_levels(mesh, fours))),
        *(Case(f"diffusion, {name}", (Diffusion(), hierarchy)) for name, hierarchy in shapes.items()),
        *(
            Case(f"a linear system, {name}", (uneven(graph, 1), hierarchy))
            for name, hierarchy in shapes.items()
        ),
        Case("a linear system without a mesh", (uneven(graph, 1, seed=1), meshless_hierarchy)),
        Case("an uneven linear system of three per cell", (uneven(graph, 3), on_levels(mesh, fours))),
    ]


def unlike_diffusion() -> list[Case]:
    """Return test cases of linear systems unlike diffusion: nonsymmetric, indefinite, or oddly stored."""
    hierarchy = _squares()
    base = uneven(hierarchy.graph, 1, seed=2)
    below = sparse.tril(base.A, -1)
    coupling = sparse.csr_array((np.full(6, 8.0), (np.arange(0, 36, 7), np.zeros(6, int))), shape=(36, 1))
    shift = float(np.median(base.A.diagonal())) / 2
    systems = {
        "a matrix that is not symmetric": replace(base, A=sparse.csr_array(base.A - 0.7 * below)),
        "a matrix with zeros above the diagonal": replace(base, A=sparse.csr_array(sparse.tril(base.A))),
        "a symmetric matrix that is not definite": replace(
            base, A=sparse.csr_array(base.A - shift * sparse.eye_array(36))
        ),
        "positive couplings of cells that are not neighbours": replace(
            base, A=sparse.csr_array(base.A + coupling @ coupling.T)
        ),
        "cells with one, two and three unknowns": _of_unequal_cells(base),
        "a matrix that is 1 or -1 times every unknown": _without_curvature(hierarchy.levels[0]),
        "a matrix of whole numbers, by columns": replace(
            base, A=sparse.csc_array(np.rint(base.A.toarray()).astype(np.int64))
        ),
        "a matrix with entries stored twice, in any order": replace(base, A=_split_entries(base.A)),
    }
    return [
        *definite(),
        *(Case(name, (system, hierarchy)) for name, system in systems.items()),
        _slightly_nonsymmetric(),
    ]


def _slightly_nonsymmetric() -> Case:
    """Return a test case of 1,024 unknowns whose matrix is symmetric up to a thousandth."""
    mesh = small_meshes.grid(32, 32)
    row, column = np.divmod(np.arange(1024), 32)
    hierarchy = on_levels(mesh, frozen_int(row // 4 * 8 + column // 4))
    system = laplacian(mesh.graph, 1)
    A = sparse.csr_array(system.A + 1e-3 * sparse.triu(system.A, 1))
    return Case("a slightly nonsymmetric matrix of 1,024 rows", (replace(system, A=A), hierarchy))


def definite() -> list[Case]:
    """Return test cases of symmetric positive definite systems that are hard to precondition."""
    hierarchy = _squares()
    base = uneven(hierarchy.graph, 1, seed=2)
    # Strong positive couplings: a low-rank term over groups of cells.
    groups = sparse.csr_array((np.ones(36), (np.arange(36), np.arange(36) % 4)), shape=(36, 4))
    # Couplings from 1e-8 to 1e8: exponents are sums of random cell exponents.
    wide = np.random.default_rng(6).uniform(-4, 4, 36)
    links = sparse.csr_array(hierarchy.graph.to_scipy())
    weights = sparse.csr_array(10.0 ** (wide[:, None] + wide)) * links
    contrast = sparse.diags_array(weights.sum(axis=1) + 10.0 ** (wide - 2)) - weights
    systems = {
        "strong positive couplings": replace(base, A=sparse.csr_array(base.A + 1e3 * (groups @ groups.T))),
        "couplings from 1e-8 to 1e8": replace(base, A=sparse.csr_array(contrast)),
        "unknowns in different units": rising_residual_system(hierarchy),
        "an ill-conditioned matrix": ill_conditioned(hierarchy),
    }
    return [Case(name, (system, hierarchy)) for name, system in systems.items()]


def ill_conditioned(hierarchy: Hierarchy) -> Linear:
    """Return a linear system with condition number 1e11 and a solution of similar magnitude.

    Rounding then limits the accuracy of b − A x.
    """
    return laplacian(hierarchy.graph, 1, shift=1e-10)


def rising_residual_system(hierarchy: Hierarchy) -> Linear:
    """Return a linear system for which the residual norm increases before it decreases in the iteration."""
    base = uneven(hierarchy.graph, 1, seed=2)
    n = len(base.b)
    units = sparse.diags_array(10.0 ** np.random.default_rng(7).uniform(-1.5, 1.5, n))
    return replace(
        base, A=sparse.csr_array(units @ base.A @ units), b=frozen_float(base.b * units.diagonal())
    )


def _squares() -> Hierarchy:
    row, column = np.divmod(np.arange(36), 6)
    return on_levels(small_meshes.grid(6, 6), frozen_int(row // 2 * 3 + column // 2))


def _without_curvature(labels: Int) -> Linear:
    """Return an indefinite diagonal system with pᵀ A p = 0 exactly for the first search directions p.

    In each part with four cells the diagonal is 1 three times and -1 once. The entries of b have sum 0 in
    each part, and equal norms where A is 1 and where A is -1.
    """
    order = np.argsort(labels, kind="stable")
    sign, b = np.empty(len(labels)), np.empty(len(labels))
    sign[order] = np.resize([1.0, 1.0, 1.0, -1.0], len(labels))
    b[order] = np.resize([2.0, 2.0, -1.0, -3.0], len(labels))
    return Linear(sparse.csr_array(sparse.diags_array(sign)), frozen_float(b), np.arange(len(labels) + 1))


def _of_unequal_cells(scalar: Linear) -> Linear:
    """Return a linear system with one, two or three unknowns per cell, coupled with random weights."""
    widths = 1 + np.arange(scalar.A.shape[0]) % 3
    cells = np.repeat(np.arange(len(widths)), widths)
    n = len(cells)
    weights = np.random.default_rng(4).uniform(0.3, 1.0, n)
    prolongation = sparse.csr_array((weights, (np.arange(n), cells)), shape=(n, len(widths)))
    A = sparse.csr_array(prolongation @ scalar.A @ prolongation.T + 20.0 * sparse.eye_array(n))
    b = frozen_float(np.random.default_rng(5).standard_normal(n))
    return Linear(A, b, frozen_int(np.concatenate([[0], np.cumsum(widths)])))


def _split_entries(A: sparse.csr_array) -> sparse.csr_array:
    """Return an equal matrix with each entry stored as the sum of two separate entries."""
    n = A.shape[0]
    parts = [np.split(array, A.indptr[1:-1]) for array in (A.indices, A.data)]
    indices = np.concatenate([np.concatenate([row, row[::-1]]) for row in parts[0]])
    data = np.concatenate([np.concatenate([0.25 * row, 0.75 * row[::-1]]) for row in parts[1]])
    return sparse.csr_array((data, indices, 2 * A.indptr), shape=(n, n))
