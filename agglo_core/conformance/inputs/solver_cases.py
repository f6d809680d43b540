"""Questions to solvers beyond the ordinary ones: a plate with tagged sides, awkward systems and levels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_changes import Change, moved, renumbered
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Linear

SIDES = LEFT, RIGHT, BOTTOM, TOP = 1, 2, 3, 4
"""Boundary tags of a :func:`plate`."""


def plate(nx: int = 8, ny: int = 6, tag: str = "boundary") -> Hierarchy:
    """Rectangles that fill [0, 2] × [0, 1], the sides tagged by :data:`SIDES`, in blocks of two by two."""
    mesh = small_meshes.grid(nx, ny, width=2.0 / nx, height=1.0 / ny)
    x, y = mesh.points[mesh.face_vertices[mesh.face_offsets[:-1]]].T
    ends = mesh.points[mesh.face_vertices[mesh.face_offsets[1:] - 1]]
    x, y = (x + ends[:, 0]) / 2, (y + ends[:, 1]) / 2
    sides = np.select([x < 1e-9, x > 2 - 1e-9, y < 1e-9, y > 1 - 1e-9], SIDES, 0)
    tagged = replace(mesh, face_tags={tag: sides}, name=f"a plate of {nx} by {ny}")
    row, column = np.divmod(np.arange(nx * ny), nx)
    return on_levels(tagged, frozen_int(row // 2 * ((nx + 1) // 2) + column // 2))


def block() -> Hierarchy:
    """Boxes of unequal sizes that fill one in 3-D, its sides tagged 1 to 6: low and high x, y, z."""
    mesh = small_meshes.boxes()
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    corners = mesh.points[mesh.face_vertices.reshape(mesh.n_faces, 4)]
    beyond = np.stack((low - corners, corners - high), axis=-1) > -1e-9
    on_side = beyond.all(axis=1).reshape(mesh.n_faces, 6)
    sides = np.where(on_side.any(axis=1), 1 + on_side.argmax(axis=1), 0)
    tagged = replace(mesh, face_tags={"boundary": sides}, name="a block of boxes")
    return on_levels(tagged, frozen_int(np.arange(mesh.n_cells) // 4))


def halves(hierarchy: Hierarchy, left: float, right: float) -> Float:
    """A value in the left half of a plate and another in the right one ``(n_cells,)``."""
    assert hierarchy.fine is not None
    return frozen_float(np.where(hierarchy.fine.cell_centroids[:, 0] < 1.0, left, right))


def on_levels(mesh: Mesh, *levels: Int) -> Hierarchy:
    """A hierarchy of a mesh with these labels, finest first."""
    targets = [{"n_parts": int(labels.max()) + 1} for labels in levels]
    return Hierarchy(mesh, mesh.graph, list(levels), targets, nested=True)


def elsewhere(hierarchy: Hierarchy, change: Change | None) -> tuple[Hierarchy, Int]:
    """The hierarchy on the mesh moved, or renumbered if ``change`` is None, and the cells' old numbers."""
    assert hierarchy.fine is not None
    if change is not None:
        there, order = moved(hierarchy.fine, change), frozen_int(np.arange(hierarchy.graph.n))
    else:
        there, order = renumbered(hierarchy.fine)
    return on_levels(there, *(frozen_int(labels[order]) for labels in hierarchy.levels)), order


def uneven(graph: Graph, per_cell: int, seed: int = 0) -> Linear:
    """A system whose couplings differ by 1 to 100, and whose right-hand side changes sign."""
    rng = np.random.default_rng(seed)
    links = sparse.triu(graph.to_scipy(), format="coo")
    links = sparse.coo_array((10 ** rng.uniform(0, 2, links.nnz), links.coords), shape=links.shape).tocsr()
    links = links + links.T
    scalar = sparse.diags_array(links.sum(axis=1) + rng.uniform(0.1, 1.0, graph.n)) - links
    A = sparse.csr_array(sparse.kron(scalar, sparse.eye_array(per_cell)))
    return Linear(
        A, frozen_float(rng.standard_normal(A.shape[0])), frozen_int(np.arange(graph.n + 1) * per_cell)
    )


def awkward() -> list[Case]:
    """Coefficients that jump from cell to cell, one part, three levels, loose parts, no mesh."""
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
        "parts in pieces": on_levels(mesh, loose),
    }
    bare = Hierarchy(None, graph, [fours], [{"n_parts": 16}], nested=True)
    rough = Diffusion(kappa=kappa, source=lambda x: np.where(x[:, 0] < 4.0, 1.0, -3.0))
    return [
        Case("a coefficient that jumps from cell to cell", (rough, on_levels(mesh, fours))),
        *(Case(f"diffusion, {name}", (Diffusion(), each)) for name, each in shapes.items()),
        *(Case(f"a linear system, {name}", (uneven(graph, 1), each)) for name, each in shapes.items()),
        Case("a linear system without a mesh", (uneven(graph, 1, seed=1), bare)),
        Case("an uneven linear system of three per cell", (uneven(graph, 3), on_levels(mesh, fours))),
    ]
