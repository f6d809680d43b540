"""Graph: the dual graph of a mesh with cell geometry; all that agglomeration needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from agglo_core.arrays import Float, Index, Int, frozen, frozen_float, frozen_index, frozen_int
from agglo_core.errors import MeshError
from agglo_core.graph.validation import check_graph, copied
from agglo_core.mesh import Mesh, check_labels

if TYPE_CHECKING:
    import networkx as nx

__all__ = ["Graph"]

_FLOATS = ("interface", "centroids", "measures", "boundary", "weights", "points", "origin")


@dataclass(frozen=True, eq=False)
class Graph:
    """Dual graph of a mesh; one block per piece.

    Block b owns the nodes ``offsets[b]:offsets[b + 1]`` and no edge joins two blocks: a mesh is one
    block, a recursion level is one block-diagonal Graph.

    Attributes
    ----------
    indptr : (n + 1,) int64; indices : (m,) int32
        CSR of the neighbours, both directions.
    interface : (m,) float
        Measure of the faces shared with that neighbour.
    centroids : (n, d) float
        Cell centroids relative to ``origin``.
    measures, boundary, weights : (n,) float
        Cell measure, measure of its faces on the domain boundary, weight (default: the measure).
    vertex_offsets : (n + 1,) int64; vertices : (v,) int32; points : (p, d) float
        Vertices of each cell and their coordinates relative to ``origin``, for exact diameters.
    offsets : (B + 1,) int64
        Blocks.
    data : mapping of name to (n, …) array
        Carried through every split: tags, indicators, features.
    origin : (d,) float
        What was subtracted from user coordinates.
    """

    indptr: Int
    indices: Index
    interface: Float
    centroids: Float
    measures: Float
    boundary: Float
    weights: Float
    vertex_offsets: Int
    vertices: Index
    points: Float
    offsets: Int
    data: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    origin: Float = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        for key in _FLOATS:
            object.__setattr__(self, key, frozen_float(getattr(self, key)))
        for key in ("indptr", "vertex_offsets", "offsets"):
            object.__setattr__(self, key, frozen_int(getattr(self, key)))
        for key in ("indices", "vertices"):
            object.__setattr__(self, key, frozen_index(getattr(self, key)))
        data = {key: frozen(values, np.asarray(values).dtype) for key, values in self.data.items()}
        object.__setattr__(self, "data", data)

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> Graph:
        """Dual graph of ``mesh``; cell tags become ``data``."""
        from agglo_core.kernels.graphs import dual_graph

        indptr, indices, interface, boundary = dual_graph(
            *mesh.cell_faces, mesh.face_cells, mesh.face_measures
        )
        vertex_offsets, vertices = mesh.cell_vertices
        graph = cls(
            indptr=indptr,
            indices=indices,
            interface=interface,
            centroids=mesh.local_centroids,
            measures=mesh.cell_measures,
            boundary=boundary,
            weights=mesh.cell_measures,
            vertex_offsets=vertex_offsets,
            vertices=vertices,
            points=mesh.local_points,
            offsets=frozen_int([0, mesh.n_cells]),
            data=mesh.cell_tags,
            origin=mesh.origin,
        )
        graph.__dict__["_sound"] = True
        return graph

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
        """Graph of one block from a symmetric CSR and centroids alone; the arrays are copied.

        Interfaces and measures default to 1. Without cell vertices a diameter is that of the
        centroids.

        Raises
        ------
        MeshError
            If shapes disagree, an index is out of range, a value is not finite or negative, or the
            CSR is not symmetric or has a self-loop.
        """
        centre = copied("centroids", centroids, np.float64)
        if centre.ndim != 2 or centre.shape[1] not in (2, 3):
            raise MeshError(f"centroids must have shape (n, 2) or (n, 3), not {centre.shape}")
        n = len(centre)
        origin = 0.5 * (centre.min(axis=0) + centre.max(axis=0)) if n else np.zeros(centre.shape[1])
        columns = copied("indices", indices, np.int32)
        size = np.ones(n) if measures is None else copied("measures", measures, np.float64)
        given = {"interface": interface, "boundary": boundary, "weights": weights}
        floats = {key: copied(key, each, np.float64) for key, each in given.items() if each is not None}
        graph = cls(
            indptr=copied("indptr", indptr, np.int64),
            indices=columns,
            interface=floats.get("interface", np.ones(columns.size)),
            centroids=centre - origin,
            measures=size,
            boundary=floats.get("boundary", np.zeros(n)),
            weights=floats.get("weights", size),
            vertex_offsets=frozen_int(np.arange(n + 1)),
            vertices=frozen_index(np.arange(n)),
            points=centre - origin,
            offsets=frozen_int([0, n]),
            data={key: np.array(values) for key, values in (data or {}).items()},
            origin=origin,
        )
        graph.ensure_sound()
        return graph

    def ensure_sound(self) -> None:
        """Run :meth:`check` once; the graph of a mesh is known to pass."""
        if "_sound" not in self.__dict__:
            self.check()
            self.__dict__["_sound"] = True

    def check(self) -> None:
        """Raise MeshError unless shapes agree, values make sense and the CSR is symmetric."""
        check_graph(self)

    @property
    def n(self) -> int:
        """Number of nodes."""
        return len(self.measures)

    @property
    def dim(self) -> int:
        """Space dimension d."""
        return int(self.centroids.shape[1])

    @property
    def n_blocks(self) -> int:
        """Number of blocks B."""
        return len(self.offsets) - 1

    @cached_property
    def sizes(self) -> Int:
        """Number of nodes of each block ``(B,)``."""
        return frozen_int(np.diff(self.offsets))

    @cached_property
    def block_ids(self) -> Int:
        """Block of each node ``(n,)``."""
        return frozen_int(np.repeat(np.arange(self.n_blocks), self.sizes))

    def __repr__(self) -> str:
        return f"Graph({self.dim}-D, {self.n} nodes, {len(self.indices) // 2} edges, {self.n_blocks} blocks)"

    def __getitem__(self, block: int) -> Graph:
        """One block as a graph of its own: indices rebased, the rest viewed."""
        b = block + self.n_blocks if block < 0 else block
        if not 0 <= b < self.n_blocks:
            raise IndexError(f"block {block} of a graph with {self.n_blocks} blocks")
        i, j = int(self.offsets[b]), int(self.offsets[b + 1])
        nodes = slice(i, j)
        edges = slice(int(self.indptr[i]), int(self.indptr[j]))
        corners = slice(int(self.vertex_offsets[i]), int(self.vertex_offsets[j]))
        return replace(
            self,
            indptr=self.indptr[i : j + 1] - self.indptr[i],
            indices=self.indices[edges] - np.int32(i),
            interface=self.interface[edges],
            centroids=self.centroids[nodes],
            measures=self.measures[nodes],
            boundary=self.boundary[nodes],
            weights=self.weights[nodes],
            vertex_offsets=self.vertex_offsets[i : j + 1] - self.vertex_offsets[i],
            vertices=self.vertices[corners],
            offsets=frozen_int([0, j - i]),
            data={key: values[nodes] for key, values in self.data.items()},
        )

    def subgraph(self, nodes: ArrayLike, offsets: ArrayLike) -> Graph:
        """Graph of ``nodes`` in that order, cut into blocks ``offsets``; edges between blocks are dropped."""
        from agglo_core.kernels.graphs import permute_graph, take_rows

        order, blocks = frozen_int(nodes), frozen_int(offsets)
        if len(order) and (order.min() < 0 or order.max() >= self.n):
            raise MeshError(f"nodes must lie in 0..{self.n - 1}, given {order.min()}..{order.max()}")
        if len(blocks) == 0 or blocks[0] != 0 or blocks[-1] != len(order) or (np.diff(blocks) < 0).any():
            raise MeshError(f"block offsets must rise from 0 to {len(order)}")
        indptr, indices, interface = permute_graph(self.indptr, self.indices, self.interface, order, blocks)
        vertex_offsets, vertices = take_rows(self.vertex_offsets, self.vertices, order)
        measures = frozen_float(self.measures[order])
        return replace(
            self,
            indptr=indptr,
            indices=indices,
            interface=interface,
            centroids=self.centroids.take(order, axis=0),  # ten times faster than indexing
            measures=measures,
            boundary=self.boundary[order],
            weights=measures if self.weights is self.measures else self.weights[order],
            vertex_offsets=vertex_offsets,
            vertices=vertices,
            offsets=blocks,
            data={key: values[order] for key, values in self.data.items()},
        )

    def split(self, labels: ArrayLike) -> tuple[Graph, Int]:
        """Parts as blocks, labels 0..k−1: the graph, and the node of ``self`` at each of its nodes."""
        array = check_labels(labels, self.n)
        if self.n_blocks == 1 and not array.any():  # one part: a connected mesh, most of the time
            return self, frozen_int(np.arange(self.n))
        order = frozen_int(np.argsort(array, kind="stable"))
        offsets = np.concatenate(([0], np.cumsum(np.bincount(array))))
        return self.subgraph(order, offsets), order

    def take(self, blocks: ArrayLike) -> Graph:
        """The chosen blocks, in that order."""
        chosen = np.asarray(blocks, dtype=np.int64)
        sizes = self.sizes[chosen]
        offsets = np.concatenate(([0], np.cumsum(sizes)))
        nodes = np.arange(offsets[-1]) + np.repeat(self.offsets[chosen] - offsets[:-1], sizes)
        return self.subgraph(nodes, offsets)

    def diameters(self) -> Float:
        """Exact largest vertex distance of each block ``(B,)``."""
        from agglo_core.kernels.geometry import block_diameters

        cells = frozen_int(np.arange(self.n))
        return frozen_float(
            block_diameters(self.offsets, cells, self.vertex_offsets, self.vertices, self.points)
        )

    def part_diameters(self, labels: ArrayLike) -> Float:
        """Exact largest vertex distance of each part ``(k,)``, labels 0..k−1."""
        from agglo_core.kernels.geometry import block_diameters

        array = check_labels(labels, self.n)
        cells = frozen_int(np.argsort(array, kind="stable"))
        offsets = frozen_int(np.concatenate(([0], np.cumsum(np.bincount(array)))))
        return frozen_float(block_diameters(offsets, cells, self.vertex_offsets, self.vertices, self.points))

    def components(self, labels: ArrayLike | None = None) -> Int:
        """Connected component of each node ``(n,)``, of equal ``labels`` if given; by first node."""
        from agglo_core.kernels.graphs import components

        parts = frozen_int(np.zeros(self.n) if labels is None else labels)
        if parts.shape != (self.n,) or parts.min() < 0:
            raise MeshError(f"labels must be ({self.n},) integers, none negative; given shape {parts.shape}")
        nodes, offsets = components(self.indptr, self.indices, parts)
        component = np.empty(self.n, np.int64)
        component[nodes] = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
        return frozen_int(component)

    def to_scipy(self) -> sparse.csr_array[Any, Any]:
        """Adjacency ``(n, n)`` weighted by interface measure."""
        shape = (self.n, self.n)
        return sparse.csr_array((self.interface, self.indices.astype(np.int64), self.indptr), shape=shape)

    @classmethod
    def from_networkx(
        cls,
        network: nx.Graph,
        *,
        centroid: str = "centroid",
        interface: str = "interface",
        measure: str = "measure",
        weight: str = "weight",
        boundary: str = "boundary",
        data: Iterable[str] | None = None,
    ) -> Graph:
        """Graph of a networkx graph; see :func:`agglo_core.interchange.graph_from_networkx`."""
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

    def to_networkx(self) -> nx.Graph:
        """Graph of networkx with all of this one's attributes."""
        from agglo_core.interchange import graph_to_networkx

        return graph_to_networkx(self)

    def coarsen(self, labels: ArrayLike) -> Graph:
        """Quotient graph: one node per agglomerate, labels 0..k−1 without gaps.

        Interfaces, measures, boundaries and weights add up, centroids are averaged by measure,
        vertices are collected. ``data`` is not carried: what it means on an agglomerate is not known.

        Raises
        ------
        MeshError
            If the labels have another shape, or leave gaps.
        """
        array = check_labels(labels, self.n)
        k = int(array.max()) + 1
        gather = sparse.csr_array((np.ones(self.n), (array, np.arange(self.n))), shape=(k, self.n))
        quotient = sparse.coo_array(gather @ self.to_scipy() @ gather.T)
        outer = quotient.row != quotient.col
        matrix = sparse.csr_array(
            (quotient.data[outer], (quotient.row[outer], quotient.col[outer])), shape=(k, k)
        )
        measures = frozen_float(gather @ self.measures)
        heft = self.measures if (measures > 0).all() else np.ones(self.n)
        corners = np.unique(np.repeat(array, np.diff(self.vertex_offsets)) * len(self.points) + self.vertices)
        counts = np.bincount(corners // len(self.points), minlength=k)
        return replace(
            self,
            indptr=frozen_int(matrix.indptr),
            indices=frozen_index(matrix.indices),
            interface=matrix.data,
            centroids=(gather @ (self.centroids * heft[:, None])) / (gather @ heft)[:, None],
            measures=measures,
            boundary=gather @ self.boundary,
            weights=measures if self.weights is self.measures else gather @ self.weights,
            vertex_offsets=frozen_int(np.concatenate(([0], np.cumsum(counts)))),
            vertices=frozen_index(corners % len(self.points)),
            offsets=frozen_int([0, k]),
            data={},
        )
