"""Anisotropic metrics: map a dual graph so that lengths in the metric become Euclidean.

Diameters, centroid distances and interfaces of the mapped graph are then measured in the metric, and parts
are long where the metric makes lengths short.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float, Int, frozen_float, plain_array, trusted_copy
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_SYMMETRY = 1e-9  # relative to the largest entry of a tensor: largest difference of transposed entries


def in_metric(mesh: Mesh | Graph, graph: Graph, metric: ArrayLike) -> Graph:
    """Map the geometry of the dual graph so that lengths in a metric become Euclidean.

    A length is √(xᵀ M x). A constant tensor defines an exact linear map. For one tensor per cell an exact map
    may not exist, and the map is the least-squares fit along the graph edges.

    Parameters
    ----------
    metric : (d, d) or (n, d, d) float
        Symmetric positive definite.

    Raises
    ------
    OptionError
        If the metric has another shape, or is not symmetric positive definite.
    """
    # 1. Map positions by the square roots of the tensors.
    roots = _roots(metric, graph)
    centroids, points = _map_to_euclidean(graph, roots)
    # 2. Measures and interfaces in the metric.
    size = np.broadcast_to(np.linalg.det(roots), graph.n)
    interface, boundary = _interfaces(mesh, graph, roots)
    measures = frozen_float(size * graph.measures)
    return trusted_copy(
        graph,
        centroids=centroids,
        points=points,
        interface=interface,
        boundary=boundary,
        measures=measures,
        weights=measures if graph.weights is graph.measures else graph.weights,
        origin=np.zeros(graph.dim),
    )


def _roots(metric: ArrayLike, graph: Graph) -> Float:
    """Return the square roots ``(d, d)`` or ``(n, d, d)`` of metric tensors, or raise OptionError."""
    tensors = plain_array(metric, "metric", OptionError)
    d = graph.dim
    if tensors.shape not in ((d, d), (graph.n, d, d)) or tensors.dtype.kind not in "iuf":
        raise OptionError(
            f"metric must have shape ({d}, {d}), or ({graph.n}, {d}, {d}) for a tensor in each cell; "
            f"given {tensors.shape} of {tensors.dtype}"
        )
    # Eigenvalues of all tensors, then checks for symmetry and definiteness.
    flat = tensors.reshape(-1, d, d).astype(float)
    uneven = abs(flat - flat.transpose(0, 2, 1)).max(axis=(1, 2)) > _SYMMETRY * abs(flat).max(axis=(1, 2))
    values, vectors = np.linalg.eigh(np.where(np.isfinite(flat), flat, 0.0))
    bad = np.flatnonzero(uneven | ~np.isfinite(flat).all(axis=(1, 2)) | (values[:, 0] <= 0))
    if len(bad):
        where = "" if tensors.ndim == 2 else f" of cell {bad[0]}"
        raise OptionError(f"the metric{where} is not symmetric positive definite: {flat[bad[0]].tolist()}")
    roots: Float = (vectors * np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return roots[0] if tensors.ndim == 2 else roots


def _map_to_euclidean(graph: Graph, roots: Float) -> tuple[Float, Float]:
    """Map centroids and vertices so that lengths in the metric become Euclidean."""
    if roots.ndim == 2:
        return graph.centroids @ roots, graph.points @ roots
    # 1. Centroids by least squares.
    centroids = _nearest_map(graph, roots)
    # 2. Points: mean over the adjacent cells of each cell's linear map about its centroid.
    cells = np.repeat(np.arange(graph.n), np.diff(graph.vertex_offsets))
    corners = graph.points[graph.vertices] - graph.centroids[cells]
    there = centroids[cells] + np.einsum("nij,nj->ni", roots[cells], corners)
    count = np.maximum(np.bincount(graph.vertices, minlength=len(graph.points)), 1)
    columns = [np.bincount(graph.vertices, x, len(graph.points)) / count for x in there.T]
    return centroids, np.stack(columns, axis=1)


def _nearest_map(graph: Graph, roots: Float) -> Float:
    """Return mapped centroids ``(n, d)`` whose differences best fit the metric (least squares).

    Edges are weighted by interface over distance, as in a discrete gradient.
    """
    rows, columns = np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices.astype(np.int64)
    # 1. Edge weights, and as ``flux`` the desired differences along the edges times the weights.
    difference = graph.centroids[rows] - graph.centroids[columns]
    distance = np.linalg.norm(difference, axis=1)
    weight = np.where(distance > 0, graph.interface / np.where(distance > 0, distance, 1.0), 0.0)
    weight += 1e-9 * (weight.max(initial=0.0) or 1.0)
    flux = 0.5 * np.einsum("nij,nj->ni", roots[rows] + roots[columns], difference) * weight[:, None]
    # 2. Normal equations: a weighted graph Laplacian, with one cell fixed in each component.
    first = np.unique(graph.components(), return_index=True)[1]
    anchor = np.zeros(graph.n)
    anchor[first] = weight.max(initial=1.0)
    diagonal = np.bincount(rows, weight, graph.n) + anchor
    everywhere = np.arange(graph.n)
    matrix = sparse.coo_array(
        (np.concatenate((-weight, diagonal)), (np.append(rows, everywhere), np.append(columns, everywhere)))
    )
    # 3. Right-hand side and direct solution.
    rhs = np.stack([np.bincount(rows, x, graph.n) for x in flux.T], axis=1)
    rhs += anchor[:, None] * np.einsum("nij,nj->ni", roots, graph.centroids)
    solved: Float = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A").solve(rhs)
    return solved


def _interfaces(mesh: Mesh | Graph, graph: Graph, roots: Float) -> tuple[Float, Float]:
    """Return the interfaces ``(m,)`` and the boundary measures ``(n,)`` in the metric.

    A face with area vector S has the measure |det R R⁻¹ S|, where R is the mean of the roots on both sides.
    Without a mesh, interfaces are perpendicular to the line between the centroids, and boundary measures
    scale with the cell.
    """
    rows, columns = np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices.astype(np.int64)
    # 1. Without a mesh: normals along the centroid distances.
    if not isinstance(mesh, Mesh):
        difference = graph.centroids[columns] - graph.centroids[rows]
        normals = difference / np.maximum(np.linalg.norm(difference, axis=1), 1e-300)[:, None]
        vectors = graph.interface[:, None] * normals
        scale = np.linalg.det(roots) ** ((graph.dim - 1) / graph.dim)
        return _face_measures(roots, rows, columns, vectors), graph.boundary * scale
    # 2. With a mesh: measure each face, and sum the boundary faces by cell.
    first_cell, second_cell = mesh.face_cells.T
    vectors = mesh.face_normals * mesh.face_measures[:, None]
    size = _face_measures(roots, first_cell, np.where(second_cell < 0, first_cell, second_cell), vectors)
    inner = second_cell >= 0
    outer = np.bincount(first_cell[~inner], size[~inner], graph.n)
    # 3. Sum the interior faces by cell pair, and distribute the sums to the graph entries.
    low, high = np.minimum(first_cell, second_cell)[inner], np.maximum(first_cell, second_cell)[inner]
    pairs, place = np.unique(low * graph.n + high, return_inverse=True)
    total = np.bincount(place, size[inner], len(pairs))
    keys = np.minimum(rows, columns) * graph.n + np.maximum(rows, columns)
    return frozen_float(total[np.searchsorted(pairs, keys)]), frozen_float(outer)


def _face_measures(roots: Float, one: Int, other: Int, vectors: Float) -> Float:
    """Return the measures ``(f,)``, in the metric, of faces between cells ``one`` and ``other``."""
    mean = roots if roots.ndim == 2 else 0.5 * (roots[one] + roots[other])
    turned = np.linalg.solve(np.broadcast_to(mean, (len(vectors), *mean.shape[-2:])), vectors[:, :, None])
    size: Float = np.linalg.norm(turned[:, :, 0], axis=1) * np.linalg.det(mean)
    return size
