"""Block-diagonal graphs: selection and splitting of blocks, diameters, connected components."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import (
    FieldState,
    Float,
    Index,
    Int,
    Mask,
    frozen,
    frozen_float,
    frozen_index,
    frozen_int,
    label_order,
    plain_array,
    trusted_copy,
)
from agglo_core.errors import MeshError
from agglo_core.graph.connection import all_connected
from agglo_core.graph.loads import Loaded
from agglo_core.mesh import check_labels, diameters_of, wide_parts
from agglo_core.threads import together

_LATER = ("boundary", "vertex_offsets", "vertices")
"""Arrays that a subgraph copies only on access, because few bisectors need them."""


@dataclass(frozen=True, eq=False)
class BlockGraph(FieldState, Loaded):
    """Base class of :class:`~agglo_core.graph.Graph`: its arrays, and operations on its blocks."""

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

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Copy a rarely used array (``_LATER``) from the parent graph on first access."""
            if name not in _LATER or "_whole" not in self.__dict__:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            whole, nodes = self.__dict__["_whole"]
            if name == "boundary":
                self.__dict__[name] = frozen_float(whole.boundary[nodes])
            else:
                self.__dict__.update(_rows_of(whole, nodes))
            return self.__dict__[name]

    def __getstate__(self) -> dict[str, Any]:
        """Return all arrays for pickling, without a reference to the parent graph."""
        loads = {"_loads": self.__dict__["_loads"]} if "_loads" in self.__dict__ else {}
        return super().__getstate__() | loads

    @property
    def n(self) -> int:
        """Node count."""
        return len(self.measures)

    @property
    def dim(self) -> int:
        """Space dimension d."""
        return int(self.centroids.shape[1])

    @property
    def n_blocks(self) -> int:
        """Block count B."""
        return len(self.offsets) - 1

    @cached_property
    def sizes(self) -> Int:
        """Node count per block ``(B,)``."""
        return frozen_int(np.diff(self.offsets))

    @cached_property
    def block_ids(self) -> Int:
        """Index of the block that contains each node ``(n,)``."""
        return frozen_int(np.repeat(np.arange(self.n_blocks), self.sizes))

    def __getitem__(self, block: int) -> Self:
        """Return one block as a separate graph, with nodes from 0 and views of the other arrays."""
        b = block + self.n_blocks if block < 0 else block
        if not 0 <= b < self.n_blocks:
            raise IndexError(f"block {block} is out of range: the graph has {self.n_blocks} blocks")
        i, j = int(self.offsets[b]), int(self.offsets[b + 1])
        nodes = slice(i, j)
        edges = slice(int(self.indptr[i]), int(self.indptr[j]))
        corners = slice(int(self.vertex_offsets[i]), int(self.vertex_offsets[j]))
        graph = trusted_copy(
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
        return graph.with_loads(self.loads and self.loads.take(nodes))

    def subgraph(self, nodes: ArrayLike, offsets: ArrayLike) -> Self:
        """Return the subgraph of ``nodes`` in this order, without edges between the blocks ``offsets``."""
        order, blocks = frozen_int(nodes), frozen_int(offsets)
        if len(order) and (order.min() < 0 or order.max() >= self.n):
            raise MeshError(f"nodes must lie in 0..{self.n - 1}, given {order.min()}..{order.max()}")
        if len(blocks) == 0 or blocks[0] != 0 or blocks[-1] != len(order) or (np.diff(blocks) < 0).any():
            raise MeshError(f"block offsets must increase from 0 to {len(order)}")
        edges = self.indptr, self.indices, self.interface
        whole, places = self.__dict__.get("_whole", (self, None))
        rows, (centroids, measures, nodes_of_whole) = together(
            len(order),
            lambda: _permute_nodes(*edges, order, blocks),
            # take is ten times faster than indexing for rows
            lambda: (
                frozen_float(self.centroids.take(order, axis=0)),
                frozen_float(self.measures.take(order)),
                order if places is None else frozen_int(places[order]),
            ),
        )
        graph = object.__new__(type(self))
        graph.__dict__.update(
            indptr=rows[0],
            indices=rows[1],
            interface=rows[2],
            centroids=centroids,
            measures=measures,
            weights=measures if self.weights is self.measures else frozen_float(self.weights[order]),
            points=self.points,
            offsets=blocks,
            data={key: frozen(values[order], values.dtype) for key, values in self.data.items()},
            origin=self.origin,
            _whole=(whole, nodes_of_whole),
        )
        graph.__dict__["_loads"] = self.loads and self.loads.take(order)
        return graph

    def split(self, labels: ArrayLike) -> tuple[Self, Int]:
        """Return the graph with the parts (labels 0..k−1) as blocks, and the old index of each node."""
        array = check_labels(labels, self.n)
        if self.n_blocks == 1 and not array.any():  # single part: the usual case of a connected mesh
            return self, frozen_int(np.arange(self.n))
        order = label_order(array)
        offsets = np.concatenate(([0], np.cumsum(np.bincount(array))))
        return self.subgraph(order, offsets), order

    def take(self, blocks: ArrayLike) -> Self:
        """Return the graph of the selected blocks, in this order."""
        block_numbers = frozen_int(blocks)
        sizes = self.sizes[block_numbers]
        offsets = np.concatenate(([0], np.cumsum(sizes)))
        nodes = np.arange(offsets[-1]) + np.repeat(self.offsets[block_numbers] - offsets[:-1], sizes)
        return self.subgraph(nodes, offsets)

    def without_edges(self, removed: ArrayLike) -> Self:
        """Return the graph without the edges marked in ``removed (m,)``, a mask of the CSR entries.

        The mask contains both directions of each edge.

        Their interfaces become boundary of the cells on both sides, so that perimeters do not change.
        """
        mask = plain_array(removed, "removed")
        if mask.shape != self.indices.shape or mask.dtype != bool:
            raise MeshError(
                f"removed must be a mask of shape {self.indices.shape}, not {mask.shape} of {mask.dtype}"
            )
        if not mask.any():
            return self
        entries = np.flatnonzero(mask)
        rows = np.searchsorted(self.indptr, entries, side="right") - 1
        indptr, keep = self.indptr - np.searchsorted(entries, self.indptr), ~mask
        graph = trusted_copy(
            self,
            indptr=indptr,
            indices=self.indices[keep],
            interface=self.interface[keep],
            boundary=self.boundary + np.bincount(rows, self.interface[entries], self.n),
        )
        return graph.with_loads(self.loads)

    def diameters(self) -> Float:
        """Return the exact diameter of each block ``(B,)``, the largest distance of two vertices."""
        cells = frozen_int(np.arange(self.n))
        return diameters_of(self.offsets, cells, self.vertex_offsets, self.vertices, self.points)

    def part_diameters(self, labels: ArrayLike) -> Float:
        """Return the exact diameter of each part ``(k,)``, for labels 0..k−1."""
        array = check_labels(labels, self.n)
        alone = len(array) > 0 and bool((np.diff(array) == 1).all())  # each cell is a part, in order
        cells = frozen_int(np.arange(self.n)) if alone else label_order(array)
        offsets = frozen_int(np.concatenate(([0], np.cumsum(np.bincount(array)))))
        return diameters_of(offsets, cells, self.vertex_offsets, self.vertices, self.points)

    def wide_parts(self, labels: ArrayLike, limit: float, examined: Mask | None = None) -> Mask:
        """Return the mask ``(k,)`` of parts (labels 0..k−1) with a diameter above ``limit``.

        This is faster than computing all diameters.

        With ``examined (k,)`` only these parts are examined; others are reported as not wide.
        """
        array = frozen_int(labels)
        k = int(array.max(initial=-1)) + 1 if examined is None else len(examined)
        if array.shape != (self.n,) or array.min(initial=0) < 0 or array.max(initial=-1) >= k:
            raise MeshError(f"labels must be ({self.n},) integers in 0..{k - 1}, given shape {array.shape}")
        parts = np.ones(k, bool) if examined is None else examined
        return wide_parts(array, parts, limit, self.vertex_offsets, self.vertices, self.points)

    def components(self, labels: ArrayLike | None = None) -> Int:
        """Return the connected component of each node ``(n,)``, or within parts if ``labels`` are given.

        Components are numbered by their first nodes.
        """
        from agglo_core.compiled.graphs import components

        parts = frozen_int(np.zeros(self.n, np.int64) if labels is None else labels)
        if labels is None:
            if all_connected(self.indptr, self.indices):
                return parts
        elif parts.shape != (self.n,) or parts.min() < 0:
            raise MeshError(f"labels must be ({self.n},) non-negative integers; given shape {parts.shape}")
        nodes, offsets = components(self.indptr, self.indices, parts)
        component = np.empty(self.n, np.int64)
        component[nodes] = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
        return frozen_int(component)


def _permute_nodes(
    indptr: Int, indices: Index, interface: Float, order: Int, offsets: Int
) -> tuple[Int, Index, Float]:
    """Permute the nodes of a CSR graph to ``order``, and drop edges between blocks (``permute_graph``).

    numpy allocates large arrays with large pages, which makes them cheaper than arrays allocated in kernels.
    """
    from agglo_core.compiled.graphs import permute_graph

    whole = len(order) == len(indptr) - 1
    capacity = len(indices) if whole else int((indptr[order + 1] - indptr[order]).sum())
    arrays = np.empty(len(order) + 1, np.int64), np.empty(capacity, np.int32), np.empty(capacity)
    n_entries = permute_graph(indptr, indices, interface, order, offsets, *arrays)
    if n_entries < 0:
        raise MeshError(f"the {len(order)} nodes must be distinct, but one is given twice")
    return frozen_int(arrays[0]), frozen_index(arrays[1][:n_entries]), frozen_float(arrays[2][:n_entries])


def _rows_of(whole: BlockGraph, nodes: Int) -> dict[str, Any]:
    """Return the cell vertices of selected graph nodes as CSR."""
    from agglo_core.compiled.graphs import take_rows

    vertex_offsets, vertices = take_rows(whole.vertex_offsets, whole.vertices, nodes)
    return {"vertex_offsets": frozen_int(vertex_offsets), "vertices": frozen_index(vertices)}
