"""Graph class: the dual graph of a mesh with the cell geometry for agglomeration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from agglo_core.arrays import (
    Float,
    Index,
    frozen,
    frozen_index,
    frozen_int,
    index_cast,
    owned,
    plain_array,
    trusted,
    trusted_copy,
)
from agglo_core.errors import MeshError
from agglo_core.graph.block_graph import BlockGraph
from agglo_core.graph.quotient import quotient
from agglo_core.graph.validation import check_graph, immutable_array
from agglo_core.mesh import Mesh, check_labels

_DTYPES = {
    **dict.fromkeys(("indptr", "vertex_offsets", "offsets"), np.int64),
    **dict.fromkeys(("indices", "vertices"), np.int32),
    **dict.fromkeys(("interface", "centroids", "measures", "boundary", "weights"), np.float64),
    **dict.fromkeys(("points", "origin"), np.float64),
}


@dataclass(frozen=True, eq=False)
class Graph(BlockGraph):
    """Dual graph of a mesh, or of several pieces of it as independent blocks.

    Block b owns the nodes ``offsets[b]:offsets[b + 1]`` and no edge joins two blocks. A mesh is one block.
    All pieces at one depth of a recursion form one block-diagonal Graph, called a *level* in bisectors.

    Attributes
    ----------
    indptr : (n + 1,) int64; indices : (m,) int32
        Neighbour CSR, both directions.
    interface : (m,) float
        Measure of the faces shared with that neighbour.
    centroids : (n, d) float
        Cell centroids relative to ``origin``.
    measures, boundary, weights : (n,) float
        Cell measure, measure of its faces on the domain boundary, weight (default: the measure).
    vertex_offsets : (n + 1,) int64; vertices : (v,) int32; points : (p, d) float
        Vertices per cell and their coordinates relative to ``origin``, for exact diameters.
    offsets : (B + 1,) int64
        Blocks.
    data : mapping of name to (n, …) array
        Passed on to all subgraphs: tags, indicators, features.
    origin : (d,) float
        Offset subtracted from user coordinates.

    Raises
    ------
    MeshError
        From the constructor, as :meth:`from_arrays`; also for an edge between blocks. Arrays are copied
        unless they are immutable.

    Examples
    --------
    >>> graph = agglo.samples.squares(2).graph
    >>> graph
    Graph(2-D, 4 nodes, 4 edges)
    >>> graph.indptr.tolist(), graph.indices.tolist()
    ([0, 2, 4, 6, 8], [1, 2, 0, 3, 0, 3, 1, 2])
    """

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> Graph:
        """Build the dual graph from ``mesh``.

        Cell tags become ``data``.
        """
        neighbours, (vertex_offsets, vertices) = mesh.cell_neighbours, mesh.cell_vertices
        return trusted(
            cls,
            indptr=neighbours.indptr,
            indices=frozen_index(neighbours.indices),
            interface=neighbours.interface,
            centroids=mesh.local_centroids,
            measures=mesh.cell_measures,
            boundary=neighbours.boundary,
            weights=mesh.cell_measures,
            vertex_offsets=vertex_offsets,
            vertices=frozen_index(vertices),
            points=mesh.local_points,
            offsets=frozen_int([0, mesh.n_cells]),
            data=mesh.cell_tags,
            origin=mesh.origin,
        )

    @classmethod
    def from_arrays(
        cls,
        indptr: ArrayLike,
        indices: ArrayLike,
        centroids: ArrayLike,
        *,
        interface: ArrayLike | None = None,
        measures: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        boundary: ArrayLike | None = None,
        data: Mapping[str, NDArray[Any]] | None = None,
    ) -> Graph:
        """Build a graph with one block from a symmetric CSR adjacency and node centroids.

        The arrays are copied.

        Interfaces and measures default to 1. Without cell vertices, diameters are those of the centroids.

        Raises
        ------
        MeshError
            If shapes disagree, an index is out of range, a value is masked, not finite or negative, or
            the CSR is not symmetric or has a self-loop.
        """
        centre: Float = immutable_array("centroids", centroids, np.float64)
        if centre.ndim != 2 or centre.shape[1] not in (2, 3):
            raise MeshError(f"centroids must have shape (n, 2) or (n, 3), not {centre.shape}")
        n = len(centre)
        finite = n and np.isfinite(centre).all()  # else the constructor reports the first bad value
        origin = 0.5 * (centre.min(axis=0) + centre.max(axis=0)) if finite else np.zeros(centre.shape[1])
        columns: Index = immutable_array("indices", indices, np.int32)
        size = np.ones(n) if measures is None else measures
        return cls(
            indptr=indptr,  # type: ignore[arg-type]  # checked by the constructor
            indices=columns,
            interface=np.ones(columns.size) if interface is None else interface,  # type: ignore[arg-type]
            centroids=centre - origin,
            measures=size,  # type: ignore[arg-type]
            boundary=np.zeros(n) if boundary is None else boundary,  # type: ignore[arg-type]
            weights=size if weights is None else weights,  # type: ignore[arg-type]
            vertex_offsets=np.arange(n + 1),
            vertices=frozen_index(np.arange(n)),
            points=centre - origin,
            offsets=frozen_int([0, n]),
            data=data or {},
            origin=origin,
        )

    def __post_init__(self) -> None:
        copies: dict[int, NDArray[Any]] = {}  # weights may be the same array as measures, and remain so
        for name, dtype in _DTYPES.items():
            array = getattr(self, name)
            if id(array) not in copies:
                copies[id(array)] = immutable_array(name, array, dtype)
            self.__dict__[name] = copies[id(array)]
        data = {key: plain_array(values, f"data {key!r}") for key, values in self.data.items()}
        self.__dict__["data"] = {key: owned(frozen(values, values.dtype)) for key, values in data.items()}
        self.check()

    def check(self) -> None:
        """Raise MeshError unless shapes agree, values are valid and the CSR adjacency is symmetric.

        The constructor calls this method.
        """
        check_graph(self)

    def __repr__(self) -> str:
        blocks = f", {self.n_blocks} blocks" if self.n_blocks > 1 else ""
        return f"Graph({self.dim}-D, {self.n} nodes, {len(self.indices) // 2} edges{blocks})"

    def to_scipy(self) -> sparse.csr_array[Any, Any]:
        """Return a copy of the adjacency matrix ``(n, n)``, weighted by interface measure.

        It is a copy because scipy sorts in place.
        """
        most = max(self.n, len(self.indices))
        indices, indptr = (index_cast(each, most) for each in (self.indices, self.indptr))
        return sparse.csr_array((self.interface.copy(), indices, indptr), shape=(self.n, self.n))

    @classmethod
    def from_scipy(cls, A: Any, points: ArrayLike | None = None) -> Graph:
        """Build the graph of a sparse matrix: a node for each unknown, an edge for each pair of entries.

        The diagonal and stored zeros are ignored. Nodes i and j are joined if a_ij or a_ji is not 0, with the
        interface ``(|a_ij| + |a_ji|) / 2``. Measures are 1. The nodes of a BSR matrix with square blocks are
        these blocks, and its interfaces are sums over their entries.

        Parameters
        ----------
        A : (n, n) sparse
            Matrix or array of :mod:`scipy.sparse` in any format, also unsymmetric.
        points : (n, 2 or 3) float, optional
            Coordinates of the nodes. By default all are 0. Then :func:`agglo_core.agglomerate` requires
            counts (``n_parts``, ``cells_per_part``) and a bisector that uses edges only: ``metis`` (extra
            ``agglo[metis]``), or the slower ``spectral``.

        Raises
        ------
        OptionError
            If A is not sparse, not square, complex or not finite, or its indices do not fit its shape.
        MeshError
            If A is empty, or the points have another shape or are not finite.

        Examples
        --------
        >>> from scipy import sparse
        >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(100, 100))
        >>> graph = agglo.Graph.from_scipy(A)
        >>> graph.to_scipy().toarray()[0, :3].tolist()
        [0.0, 1.0, 0.0]
        >>> hierarchy = agglo.agglomerate(graph, bisector="spectral", n_parts=(20, 5))
        >>> agglo.build_levels(A, hierarchy).solve([1.0] * 100).converged
        True
        """
        from agglo_core.interchange.scipy_graphs import graph_from_scipy

        return graph_from_scipy(A, points)

    @classmethod
    def from_networkx(
        cls,
        network: Any,
        *,
        centroid: str = "centroid",
        interface: str = "interface",
        measure: str = "measure",
        weight: str = "weight",
        boundary: str = "boundary",
        data: Iterable[str] | None = None,
    ) -> Graph:
        """Convert a networkx graph, see :func:`agglo_core.interchange.graph_from_networkx`."""
        from agglo_core.interchange import graph_from_networkx

        return graph_from_networkx(
            network,
            centroid=centroid,
            interface=interface,
            measure=measure,
            weight=weight,
            boundary=boundary,
            data=data,
        )

    def to_networkx(self) -> Any:
        """Convert to a networkx graph with all attributes."""
        from agglo_core.interchange import graph_to_networkx

        return graph_to_networkx(self)

    def coarsen(self, labels: ArrayLike) -> Graph:
        """Return the quotient graph: one node per agglomerate, labels 0..k−1 without gaps.

        Interfaces, measures, boundaries and weights are summed, centroids averaged by measure, and vertices
        collected. ``data`` are dropped, because their meaning on agglomerates is unknown.

        Raises
        ------
        MeshError
            If the labels have another shape, or leave gaps.
        """
        parts = check_labels(labels, self.n)
        coarse = quotient(parts, self)
        made = trusted_copy(self, **coarse._asdict(), offsets=frozen_int([0, len(coarse.measures)]), data={})
        return made.with_loads(self.loads and self.loads.added(parts))


def dual_graph(mesh: Mesh) -> Graph:
    """Build the dual graph of a mesh.

    ``mesh.graph`` caches it.

    Examples
    --------
    >>> dual_graph(agglo.samples.boxes(2))
    Graph(3-D, 8 nodes, 12 edges)
    """
    return Graph.from_mesh(mesh)
