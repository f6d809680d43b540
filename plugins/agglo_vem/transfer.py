"""Prolongation from the virtual elements on agglomerates to those on the cells."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mask, Mesh, fields
from agglo_vem.local_spaces import Space
from agglo_vem.monomials import monomials


def prolongation(mesh: Mesh, labels: Int, degree: int) -> sparse.csr_array:
    """Return the matrix ``(n_fine, n_coarse)`` that injects functions on agglomerates into the fine space.

    On edges between agglomerates both spaces have equal unknowns. Inside an agglomerate the function is
    replaced by its L2 projection, so that polynomials of the degree are kept.

    Parameters
    ----------
    mesh : Mesh
    labels : (n_cells,) int
        Agglomerate of each cell.
    degree : int
    """
    labels = np.asarray(labels)
    fine, coarse = Space(mesh, degree), Space(mesh.coarsen(labels), degree)
    # 1. Fine unknowns on the boundaries of agglomerates
    same = np.full(fine.n_outer, -1)
    same[: len(fine.vertices)] = coarse.numbers[fine.vertices]
    if degree > 1:
        owner, neighbour = mesh.face_cells.T
        kept = (neighbour < 0) | (labels[owner] != labels[neighbour])
        nodes = fine.edge_nodes[kept]
        turned = mesh.face_pairs[kept, 0] != coarse.mesh.face_pairs[:, 0]
        nodes[turned] = nodes[turned, ::-1]
        same[nodes] = coarse.edge_nodes
    equal = np.flatnonzero(same >= 0)
    shape = fine.n, coarse.n
    copied = sparse.csr_array((np.ones(len(equal)), (equal, same[equal])), shape=shape)
    # 2. Fine unknowns of the polynomials on each agglomerate
    return sparse.csr_array(copied + _of_polynomials(fine, coarse, labels, same < 0) @ _projections(coarse))


def _projections(space: Space) -> sparse.csr_array:
    """Return the map ``(n_cells * m, n)`` from unknowns to the coefficients of the L2 projections."""
    rows, columns, values = [], [], []
    for batch in space.batches():
        m = batch.l2.shape[1]
        row = (batch.cells[:, None] * m + np.arange(m))[:, :, None]
        rows.append(np.broadcast_to(row, batch.l2.shape).ravel())
        columns.append(np.broadcast_to(batch.unknowns[:, None], batch.l2.shape).ravel())
        values.append(batch.l2.ravel())
    parts = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.coo_array(parts, shape=(space.mesh.n_cells * m, space.n)))


def _of_polynomials(fine: Space, coarse: Space, labels: Int, inside: Mask) -> sparse.csr_array:
    """Return the fine unknowns ``(n_fine, n_coarse_cells * m)`` of polynomials on the agglomerates.

    Outer unknowns count where ``inside (n_outer,)``.
    """
    mesh, k = fine.mesh, fine.degree
    shift = mesh.origin - coarse.mesh.origin
    # Any cell at an unknown inside an agglomerate belongs to it.
    cell_of = np.full(fine.n_outer, -1)
    for batch in fine.batches():
        outer = batch.unknowns[:, : batch.unknowns.shape[1] - fine.per_cell]
        cell_of[outer] = batch.cells[:, None]
    nodes = np.flatnonzero(inside)
    parts = labels[cell_of[nodes]]
    blocks: list[tuple[Int, Int, Float]] = [
        (nodes, parts, monomials(coarse.frames.coordinates(parts, fine.node_points[nodes] + shift), k))
    ]
    # Moments: means over the cell of polynomials times monomials of the cell
    if fine.per_cell:
        sums = np.zeros((mesh.n_cells, fine.per_cell, blocks[0][2].shape[1]))
        for rule in fields.inside(mesh, 2 * k - 2):
            own = monomials(fine.frames.coordinates(rule.cells, rule.points), k - 2) * rule.weights[:, None]
            others = coarse.frames.coordinates(labels[rule.cells], rule.points + shift)
            products = own[:, :, None] * monomials(others, k)[:, None]
            stop = rule.first + len(rule.offsets) - 1
            sums[rule.first : stop] = np.add.reduceat(products, rule.offsets[:-1])
        sums /= mesh.cell_measures[:, None, None]
        unknowns = fine.inner(np.arange(mesh.n_cells))
        blocks.append((unknowns.ravel(), np.repeat(labels, fine.per_cell), sums.reshape(-1, sums.shape[2])))
    rows, cells, values = (np.concatenate(column) for column in zip(*blocks, strict=True))
    m = values.shape[1]
    columns = cells[:, None] * m + np.arange(m)
    entries = (values.ravel(), (np.repeat(rows, m), columns.ravel()))
    return sparse.csr_array(sparse.coo_array(entries, shape=(fine.n, coarse.mesh.n_cells * m)))
