"""Graph: the dual graph of a mesh with cell geometry; all that agglomeration needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from agglo_core.arrays import frozen_index, frozen_int
from agglo_core.errors import MeshError
from agglo_core.graph.block_graph import BlockGraph
from agglo_core.graph.quotient import quotient
from agglo_core.graph.validation import check_graph, copied
from agglo_core.mesh import Mesh, check_labels
from agglo_core.mesh.elsewhere import made_by

__all__ = ["Graph", "dual_graph"]


@dataclass(frozen=True, eq=False)
class Graph(BlockGraph):
    """Dual graph of a mesh; one block per piece.

    Block b owns the nodes ``offsets[b]:offsets[b + 1]`` and no edge joins two blocks. A mesh is one block;
    all pieces of one depth of a recursion are one block-diagonal Graph, which bisectors call a *level*.

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

    Examples
    --------
    >>> graph = agglo.samples.squares(2).graph
    >>> graph
    Graph(2-D, 4 nodes, 4 edges, 1 blocks)
    >>> graph.indptr.tolist(), graph.indices.tolist()
    ([0, 2, 4, 6, 8], [1, 2, 0, 3, 0, 3, 1, 2])
    """

    @classmethod
    def from_mesh(cls, mesh: Mesh) -> Graph:
        """Dual graph of ``mesh``; cell tags become ``data``."""
        beside, (vertex_offsets, vertices) = mesh.cell_neighbours, mesh.cell_vertices
        graph = cls(
            indptr=beside.indptr,
            indices=beside.indices,
            interface=beside.interface,
            centroids=mesh.local_centroids,
            measures=mesh.cell_measures,
            boundary=beside.boundary,
            weights=mesh.cell_measures,
            vertex_offsets=vertex_offsets,
            vertices=vertices,
            points=mesh.local_points,
            offsets=frozen_int([0, mesh.n_cells]),
            data=mesh.cell_tags,
            origin=mesh.origin,
        )
        graph.__dict__["_valid"] = True
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
        graph.ensure_valid()
        return graph

    def ensure_valid(self) -> None:
        """Run :meth:`check` once; the graph of a mesh is known to pass."""
        if "_valid" not in self.__dict__:
            self.check()
            self.__dict__["_valid"] = True

    def check(self) -> None:
        """Raise MeshError unless shapes agree, values make sense and the CSR is symmetric."""
        check_graph(self)

    def __repr__(self) -> str:
        return f"Graph({self.dim}-D, {self.n} nodes, {len(self.indices) // 2} edges, {self.n_blocks} blocks)"

    def to_scipy(self) -> sparse.csr_array[Any, Any]:
        """Adjacency ``(n, n)`` weighted by interface measure, in arrays of its own: scipy sorts in place."""
        arrays = (self.interface.copy(), self.indices.astype(np.int64), self.indptr.copy())
        return sparse.csr_array(arrays, shape=(self.n, self.n))

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
        """Graph of a networkx graph; see :func:`agglo_core.interchange.graph_from_networkx`."""
        made: Graph = made_by("agglo_core.interchange:graph_from_networkx")(
            network,
            centroid=centroid,
            interface=interface,
            measure=measure,
            weight=weight,
            boundary=boundary,
            data=data,
        )
        return made

    def to_networkx(self) -> Any:
        """Graph of networkx with all of this one's attributes."""
        return made_by("agglo_core.interchange:graph_to_networkx")(self)

    def coarsen(self, labels: ArrayLike) -> Graph:
        """Quotient graph: one node per agglomerate, labels 0..k−1 without gaps.

        Interfaces, measures, boundaries and weights add up, centroids are averaged by measure,
        vertices are collected. ``data`` is not carried: what it means on an agglomerate is not known.

        Raises
        ------
        MeshError
            If the labels have another shape, or leave gaps.
        """
        parts = check_labels(labels, self.n)
        coarse = quotient(parts, self)
        made = replace(self, **coarse._asdict(), offsets=frozen_int([0, len(coarse.measures)]), data={})
        return made if self.mass is self.measures else made.with_mass(np.bincount(parts, self.mass))


def dual_graph(mesh: Mesh) -> Graph:
    """Dual graph of a mesh; ``mesh.graph`` is this, made once.

    Examples
    --------
    >>> dual_graph(agglo.samples.boxes(2))
    Graph(3-D, 8 nodes, 12 edges, 1 blocks)
    """
    return Graph.from_mesh(mesh)
