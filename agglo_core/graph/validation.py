"""Check user-defined graphs: shapes, values, symmetry."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from agglo_core.arrays import Float, Index, Int, exact_cast, frozen, owned, plain_array
from agglo_core.errors import MeshError

# number of axes per array
_DIMENSIONS = {
    **dict.fromkeys(("indptr", "indices", "measures", "vertex_offsets", "vertices", "offsets"), 1),
    "points": 2,
}


class GraphArrays(Protocol):
    """Interface of :class:`~agglo_core.graph.Graph` as used here, which avoids a circular import."""

    @property
    def n(self) -> int: ...
    @property
    def n_blocks(self) -> int: ...
    @property
    def indptr(self) -> Int: ...
    @property
    def indices(self) -> Index: ...
    @property
    def offsets(self) -> Int: ...
    @property
    def vertex_offsets(self) -> Int: ...
    @property
    def vertices(self) -> Index: ...
    @property
    def points(self) -> Float: ...
    @property
    def data(self) -> Mapping[str, NDArray[Any]]: ...
    def to_scipy(self) -> sparse.csr_array[Any, Any]: ...


def immutable_array(name: str, values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Return values as a read-only array of type ``dtype``, or raise MeshError.

    Integer types require integer input.

    Raises
    ------
    MeshError
        If the values have another kind, do not fit into ``dtype``, or are masked.
    """
    array = plain_array(values, name)
    kinds = "iu" if np.issubdtype(dtype, np.integer) else "iufb"
    if array.size and array.dtype.kind not in kinds:
        what = "integers" if kinds == "iu" else "numbers"
        raise MeshError(f"{name} must be an array of {what}, not of {array.dtype}")
    return owned(frozen(exact_cast(array, dtype, name), dtype))


def check_graph(graph: GraphArrays) -> None:
    """Raise MeshError unless shapes agree, values are valid and the CSR adjacency is symmetric."""
    # Dimensions and shapes.
    for key, count in _DIMENSIONS.items():
        if getattr(graph, key).ndim != count:
            raise MeshError(f"{key} must have {count} dimensions, not shape {getattr(graph, key).shape}")
    n, m, d = graph.n, len(graph.indices), graph.points.shape[1]
    if n == 0:
        raise MeshError("the graph is empty: it has no nodes")
    if d not in (2, 3):
        raise MeshError(f"points must have shape (p, 2) or (p, 3), not {graph.points.shape}")
    shapes: dict[str, tuple[int, ...]] = {"interface": (m,), "measures": (n,), "boundary": (n,)}
    shapes |= {"weights": (n,), "centroids": (n, d), "origin": (d,)}
    for key, shape in shapes.items():
        values = getattr(graph, key)
        if values.shape != shape:
            raise MeshError(f"{key} must have shape {shape}, not {values.shape}")
        place = key in ("centroids", "origin")
        bad = np.argwhere(~(np.isfinite(values) & ((values >= 0) | place)))
        if len(bad):
            where = tuple(bad[0].tolist())
            wanted = "finite" if place else "finite and not negative"
            raise MeshError(f"{key}{list(where)} is {values[where]}: it must be {wanted}")
    # Data and connectivity.
    for key, values in graph.data.items():
        if values.ndim == 0:
            raise MeshError(f"data {key!r} is a single value, expected {n} rows")
        if len(values) != n:
            raise MeshError(f"data {key!r} has {len(values)} rows, expected {n}")
    _check_vertices(graph)
    _check_edges(graph)


def _check_vertices(graph: GraphArrays) -> None:
    total = len(graph.vertices)
    for key, count, end in (
        ("vertex_offsets", graph.n + 1, total),
        ("offsets", graph.n_blocks + 1, graph.n),
    ):
        values = getattr(graph, key)
        if len(values) != count or values[0] != 0 or values[-1] != end or (np.diff(values) < 0).any():
            raise MeshError(f"{key} must have {count} entries increasing from 0 to {end}")
    if total and (graph.vertices.min() < 0 or graph.vertices.max() >= len(graph.points)):
        raise MeshError(f"vertices must lie in 0..{len(graph.points) - 1}")
    if not np.isfinite(graph.points).all():
        raise MeshError("points must be finite")


def _check_edges(graph: GraphArrays) -> None:
    n, m = graph.n, len(graph.indices)
    rising = len(graph.indptr) == n + 1 and graph.indptr[0] == 0 and (np.diff(graph.indptr) >= 0).all()
    if not rising or graph.indptr[-1] != m:
        raise MeshError(f"indptr must have {n + 1} entries increasing from 0 to {m}")
    if m and (graph.indices.min() < 0 or graph.indices.max() >= n):
        raise MeshError(f"indices must lie in 0..{n - 1}")
    rows = np.repeat(np.arange(n), np.diff(graph.indptr))
    loops = np.flatnonzero(rows == graph.indices)
    if len(loops):
        raise MeshError(f"node {graph.indices[loops[0]]} has an edge to itself")
    block = np.repeat(np.arange(graph.n_blocks), np.diff(graph.offsets))
    across = np.flatnonzero(block[rows] != block[graph.indices])
    if len(across):
        ends = rows[across[0]], graph.indices[across[0]]
        raise MeshError(f"an edge joins nodes {ends[0]} and {ends[1]}, which are in different blocks")
    matrix = graph.to_scipy()
    pattern = sparse.csr_array((np.ones(m), matrix.indices, matrix.indptr), shape=matrix.shape)
    gap = abs(matrix - matrix.T)
    if (pattern != pattern.T).nnz or (gap.nnz and gap.max() > 1e-9 * abs(matrix).max()):
        raise MeshError(
            "the graph must be symmetric: each edge must be given in both directions, with the same interface"
        )
