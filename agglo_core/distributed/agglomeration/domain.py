"""Domain: nodes that one rank agglomerates independently, with edges to other domains.

Domains are joined on the way to coarser levels. Results in a domain depend on its contents only, not on
its rank, nor on the pieces that it was joined from: nodes are sorted by id.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_index, frozen_int, trusted, trusted_copy
from agglo_core.graph import Graph
from agglo_core.graph.loads import Loads
from agglo_core.registry.attribution import Member


@dataclass(frozen=True, eq=False)
class Links:
    """Edges from nodes in a domain to nodes in others.

    Attributes
    ----------
    node : (e,) int
        Local node.
    to, domain : (e,) int
        Remote node: its id and domain.
    interface : (e,) float
        Measure of the faces between the nodes.
    barred : (e,) bool
        True if a constraint forbids a part across these faces.
    barrier : (e,) bool
        True if no part may contain both nodes.
    """

    node: Int
    to: Int
    domain: Int
    interface: Float
    barred: Mask
    barrier: Mask

    def chosen(self, which: Mask | Int) -> Links:
        """Return the links selected by a mask or by indices."""
        return Links(*(getattr(self, name)[which] for name in _LINK))

    def renamed(self, node: Int, to: Int, domain: Int) -> Links:
        """Return the links between agglomerates, merged per pair and sorted by local node and remote id."""
        order = np.lexsort((self.barred, to, node))
        keys = np.stack((node[order], to[order], self.barred[order]))
        first = np.flatnonzero(np.append(True, (np.diff(keys, axis=1) != 0).any(axis=0))[: keys.shape[1]])
        if not len(first):
            return self
        return Links(
            frozen_int(keys[0, first]),
            frozen_int(keys[1, first]),
            frozen_int(domain[order][first]),
            frozen_float(np.add.reduceat(self.interface[order], first)),
            keys[2, first].astype(bool),
            np.logical_or.reduceat(self.barrier[order], first),
        )


_LINK = ("node", "to", "domain", "interface", "barred", "barrier")


@dataclass(frozen=True, eq=False)
class Domain:
    """Subgraph that one rank agglomerates independently: cells or agglomerates as nodes.

    Attributes
    ----------
    graph : Graph
        Nodes with inner edges, without edges that constraints forbid.
    ids : (n,) int
        Global id per node, increasing.
    cells : (n,) int
        Mesh cell count per node.
    weights : (n, bounds) float
        Node weights, with a column per bound on part sizes.
    barriers : (p, 2) int
        Node pairs that no part may contain, whatever lies between.
    links : Links
        Edges to nodes in other domains.
    """

    graph: Graph
    ids: Int
    cells: Int
    weights: Float
    barriers: Int
    links: Links

    @property
    def n(self) -> int:
        """Node count."""
        return self.graph.n

    def counted(self, bounds: Sequence[Member]) -> list[Member]:
        """Return the bounds on part sizes, with the nodes' cell counts and weights filled in."""
        return [
            replace(each, tool=each.tool.counting(self.cells, frozen_float(self.weights[:, column])))
            for column, each in enumerate(bounds)
        ]

    def by_itself(self) -> Graph:
        """Return the graph of the domain alone, with the faces to other domains as boundary."""
        if not len(self.links.node):
            return self.graph
        beyond = np.bincount(self.links.node, self.links.interface, self.n)
        made = trusted_copy(self.graph, boundary=self.graph.boundary + beyond)
        return made.with_loads(self.graph.loads)

    def coarsened(self, labels: Int, first: int, to: Int) -> Domain:
        """Return the coarse domain with agglomerates ``labels (n,)`` as nodes, with ids from ``first`` on.

        ``to (e,)`` are the new ids at the links.
        """
        parts = int(labels.max(initial=-1)) + 1
        pairs = np.unique(np.sort(labels[self.barriers], axis=1), axis=0).reshape(-1, 2)
        weights = np.zeros((parts, self.weights.shape[1]))
        np.add.at(weights, labels, self.weights)
        return Domain(
            self.graph.coarsen(labels) if self.n else self.graph,
            frozen_int(first + np.arange(parts)),
            frozen_int(np.bincount(labels, self.cells, parts)),
            frozen_float(weights),
            frozen_int(pairs),
            self.links.renamed(labels[self.links.node], to, self.links.domain),
        )

    def to_send(self) -> Domain:
        """Return the domain with only the points that its nodes use, for sending."""
        from agglo_core.compiled.graphs import number_as_met

        vertices, points = number_as_met(self.graph.vertices, len(self.graph.points))
        points = self.graph.points.take(points, axis=0)
        own = trusted_copy(self.graph, vertices=frozen_index(vertices), points=points)
        return replace(self, graph=own.with_loads(self.graph.loads))


def join_pieces(
    pieces: Sequence[Domain], number: int, renumbered: Callable[[Int], Int]
) -> tuple[Domain, list[Int]]:
    """Join several domains into one.

    Return the joined domain, and the indices in it of the nodes of each given domain.

    Parameters
    ----------
    pieces : sequence of Domain
        Pieces, at least one.
    number : int
        New domain number.
    renumbered : callable
        Map from old to new domain numbers in links.
    """
    # Sort the nodes of all pieces by id.
    ids = np.concatenate([piece.ids for piece in pieces])
    order = np.argsort(ids, kind="stable")
    place = np.empty(len(ids), np.int64)
    place[order] = np.arange(len(ids))
    places = np.split(place, np.cumsum([piece.n for piece in pieces])[:-1])
    # Collect the links. Links into the new domain become inner edges.
    parts = [[getattr(piece.links, name) for piece in pieces] for name in _LINK]
    parts[0] = [position[piece.links.node] for position, piece in zip(places, pieces, strict=True)]
    links = Links(*map(np.concatenate, parts))
    links = replace(links, domain=renumbered(links.domain))
    inner = links.domain == number
    inside, ids = links.chosen(inner), ids[order]
    ends = np.stack((inside.node, np.searchsorted(ids, inside.to)), axis=1)
    barriers = [position[piece.barriers] for position, piece in zip(places, pieces, strict=True)]
    barriers.append(np.sort(ends[inside.barrier], axis=1))
    return Domain(
        _join_graphs([piece.graph for piece in pieces], places, order, inside, ends),
        frozen_int(ids),
        frozen_int(np.concatenate([piece.cells for piece in pieces])[order]),
        frozen_float(np.concatenate([piece.weights for piece in pieces])[order]),
        frozen_int(np.unique(np.concatenate(barriers), axis=0).reshape(-1, 2)),
        links.chosen(~inner),
    ), places


def _join_graphs(graphs: list[Graph], places: list[Int], order: Int, inside: Links, ends: Int) -> Graph:
    """Join the graphs into one. Links ``inside`` become edges with ``ends (e, 2)`` unless barred."""
    from agglo_core.compiled.graphs import take_rows

    # Edges of all graphs, and links that are not barred, by row and column.
    n, is_open = len(order), ~inside.barred
    rows = [np.repeat(position, np.diff(g.indptr)) for position, g in zip(places, graphs, strict=True)]
    columns = [position[g.indices] for position, g in zip(places, graphs, strict=True)]
    row = np.concatenate([*rows, ends[is_open, 0]])
    column = np.concatenate([*columns, ends[is_open, 1]])
    interface = np.concatenate([*(g.interface for g in graphs), inside.interface[is_open]])
    by_row = np.lexsort((column, row))
    # Vertices of all nodes, in the new order.
    starts = np.cumsum([0, *(len(g.points) for g in graphs)])
    corners = np.concatenate([g.vertices + start for g, start in zip(graphs, starts[:-1], strict=True)])
    sizes = np.concatenate([np.diff(g.vertex_offsets) for g in graphs])
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    vertex_offsets, vertices = take_rows(frozen_int(offsets), frozen_index(corners), frozen_int(order))

    def collect(name: str) -> Float:
        return np.concatenate([getattr(g, name) for g in graphs])[order]

    # Barred links count as boundary.
    barred_interface = np.bincount(ends[~is_open, 0], inside.interface[~is_open], n)
    names = set.intersection(*(set(g.data) for g in graphs))
    graph = trusted(
        Graph,
        indptr=frozen_int(np.concatenate(([0], np.cumsum(np.bincount(row, minlength=n))))),
        indices=frozen_index(column[by_row]),
        interface=interface[by_row],
        centroids=collect("centroids"),
        measures=collect("measures"),
        boundary=collect("boundary") + barred_interface,
        weights=collect("weights"),
        vertex_offsets=frozen_int(vertex_offsets),
        vertices=frozen_index(vertices),
        points=np.concatenate([g.points for g in graphs]),
        offsets=frozen_int([0, n]),
        data={name: np.concatenate([g.data[name] for g in graphs])[order] for name in sorted(names)},
        origin=graphs[0].origin,
    )
    loads = next((g.loads for g in graphs if g.loads is not None), None)
    if loads is None:
        return graph
    all_loads = Loads(
        loads.kind,
        frozen_float(collect("mass")),
        frozen_float(np.concatenate([g.node_sizes("cells") for g in graphs])[order]),
        frozen_float(np.concatenate([g.node_sizes("weights") for g in graphs])[order]),
    )
    return graph.with_loads(all_loads)
