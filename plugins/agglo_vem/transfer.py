"""Prolongation from the virtual elements on agglomerates to those on the cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mesh, fields
from agglo_vem.local_spaces import Space
from agglo_vem.monomials import count, exponents, monomials


def prolongation(mesh: Mesh, labels: Int, degree: int) -> sparse.csr_array:
    """Return the injection ``(n_fine, n_coarse)`` of functions on agglomerates ``labels (n_cells,)``.

    On edges between agglomerates both spaces have equal unknowns. Inside an agglomerate the function is
    replaced by its L2 projection, so that polynomials of the degree are kept.
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
    copied = sparse.csr_array((np.ones(len(equal)), (equal, same[equal])), shape=(fine.n, coarse.n))
    # 2. Other unknowns: those of the polynomials on each agglomerate, equal in all cells around
    changes, m = _changed_basis(fine, coarse, labels), count(degree, mesh.dim)

    def columns(cells: Int) -> Int:
        return cells[:, None] * m + np.arange(m)

    polynomials = fields.sum_blocks(
        (fine.n, coarse.mesh.n_cells * m),
        (
            (each.unknowns, columns(labels[each.cells]), each.of_polynomials @ changes[each.cells])
            for each in fine.batches()
        ),
    )
    projections = fields.sum_blocks(
        (coarse.mesh.n_cells * m, coarse.n),
        ((columns(each.cells), each.unknowns, each.l2) for each in coarse.batches()),
    )
    around = np.concatenate([each.unknowns.ravel() for each in fine.batches()])
    weights = 1.0 / np.bincount(around, minlength=fine.n)
    weights[equal] = 0.0
    return sparse.csr_array(copied + sparse.diags_array(weights) @ polynomials @ projections)


def _changed_basis(fine: Space, coarse: Space, labels: Int) -> Float:
    """Return matrices ``(n_cells, m, m)`` from monomials on the agglomerates to those on their cells.

    The coefficients interpolate at as many points.
    """
    k, mesh, frames = fine.degree, fine.mesh, fine.frames
    lattice: Any = exponents(k, mesh.dim) - k / (mesh.dim + 1.0)
    points = lattice @ np.linalg.inv(frames.maps).transpose(0, 2, 1)
    points = points + mesh.local_centroids[:, None] + (mesh.origin - coarse.mesh.origin)
    local = coarse.frames.coordinates(np.repeat(labels, len(lattice)), points.reshape(-1, mesh.dim))
    values = monomials(local, k).reshape(mesh.n_cells, len(lattice), -1)
    return np.asarray(np.linalg.solve(monomials(lattice, k), values))
