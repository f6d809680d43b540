"""Transfer between polynomial spaces on a mesh and on its agglomerates."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, OptionError, frozen_int
from agglo_core.fields.gauss_points import gauss
from agglo_polydg_mg.space.basis import Basis, one_per_row
from agglo_polydg_mg.space.polynomials import legendre, orders


def project_between(fine: Basis, coarse: Basis, labels: Int) -> sparse.bsr_array:
    """Return the prolongation ``(fine.n, coarse.n)`` from polynomials on agglomerates to those on cells.

    The prolongation is injection, hence the L2 projection: a polynomial on an agglomerate is a polynomial
    on each of its cells. Only the box changes; cell shapes have no influence.

    Parameters
    ----------
    fine, coarse : Basis
        Bases on a mesh and on ``mesh.coarsen(labels)``; the coarse degree must not be higher.
    labels : (fine.mesh.n_cells,) int
        Agglomerate of each cell.

    Raises
    ------
    OptionError
        If the coarse degree is higher, or the labels do not fit the meshes.
    """
    if coarse.degree > fine.degree:
        raise OptionError(
            f"cannot inject degree {coarse.degree} into degree {fine.degree}: the coarse degree must not "
            "be larger"
        )
    labels = np.asarray(labels)
    if labels.shape != (fine.mesh.n_cells,) or labels.max() + 1 != coarse.mesh.n_cells:
        raise OptionError(
            f"labels of shape {labels.shape} do not map the cells of {fine.mesh!r} to those of "
            f"{coarse.mesh!r}"
        )
    # Rotated boxes need Gauss points, parallel boxes a product per axis
    blocks = np.empty((len(labels), fine.n_local, coarse.n_local))
    turned = np.zeros(len(labels), bool)
    if fine.mesh.dim == 2:
        turned = (coarse.boxes[labels, 5] != 0.0) | (fine.boxes[:, 5] != 0.0)
        some = np.flatnonzero(turned)
        blocks[some] = _rotated_coefficients(fine, coarse, frozen_int(some), frozen_int(labels[some]))
    blocks[~turned] = _parallel_coefficients(
        fine, coarse, frozen_int(np.flatnonzero(~turned)), labels[~turned]
    )
    return one_per_row(blocks, labels, (fine.n, coarse.n))


def _parallel_coefficients(fine: Basis, coarse: Basis, cells: Int, labels: Int) -> Float:
    """Expand coarse in fine basis functions, for parallel boxes: ``(n, fine.n_local, coarse.n_local)``."""
    outer, inner = coarse.halves[labels], fine.halves[cells]
    shift = fine.centres[cells] - coarse.centres[labels] + (fine.mesh.origin - coarse.mesh.origin)
    dim = fine.mesh.dim
    coefficients = np.ones((len(cells), fine.n_local, coarse.n_local))
    for axis, (into, of) in enumerate(
        zip(orders(fine.degree, dim).T, orders(coarse.degree, dim).T, strict=True)
    ):
        axis_factors = _axis_coefficients(
            shift[:, axis] / outer[:, axis], inner[:, axis] / outer[:, axis], fine.degree
        )
        coefficients *= axis_factors[:, into[:, None], of]
    return np.asarray(coefficients * (coarse.scale[labels] / fine.scale[cells])[:, None, None])


def _rotated_coefficients(fine: Basis, coarse: Basis, cells: Int, labels: Int) -> Float:
    """Expand coarse in fine basis functions, for rotated boxes: ``(n, fine.n_local, coarse.n_local)``.

    The coefficients are computed by Gauss points in the cell boxes.
    """
    nodes, weights = gauss(fine.degree + 1)
    u, v = (each.ravel() for each in np.meshgrid(nodes, nodes, indexing="ij"))
    box = fine.boxes[cells]
    c, s, across, up = box[:, 4:5], box[:, 5:], box[:, 2:3] * u, box[:, 3:4] * v
    points = box[:, None, :2] + np.stack((c * across - s * up, s * across + c * up), axis=2)
    points += fine.mesh.origin - coarse.mesh.origin
    wide = coarse.values(labels, points)
    (i, j), lines = orders(fine.degree).T, legendre(nodes, fine.degree)
    own = (lines[i][:, :, None] * lines[j][:, None]).reshape(len(i), -1) * np.outer(weights, weights).ravel()
    return np.asarray(own @ wide / fine.scale[cells, None, None])


def _axis_coefficients(shift: Float, stretch: Float, degree: int) -> Float:
    """Expand the Legendre polynomials L_i(shift + stretch t) in the L_k(t): coefficients ``(n, k, i)``."""
    nodes, weights = gauss(degree + 1)
    wide = legendre(shift[:, None] + stretch[:, None] * nodes, degree)
    return np.triu(np.einsum("inq,kq,q->nki", wide, legendre(nodes, degree), weights))
