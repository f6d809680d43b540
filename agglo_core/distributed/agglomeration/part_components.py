"""Connected components across ranks, of parts and of the mesh."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.graph import Graph


def components_of_parts(mesh: DistributedMesh, labels: Int, bounds: Int) -> Int:
    """Return the number of connected components per part owned by this rank.

    Each rank finds the components in its own cells. The owner of a part joins components that touch.

    Parameters
    ----------
    mesh : DistributedMesh
    labels : (n_own,) int
        Global part of each own cell.
    bounds : (size + 1,) int
        Rank r owns the parts ``bounds[r]:bounds[r + 1]``.
    """
    ranks = mesh.ranks
    contacts = _find_contacts(mesh, mesh.local.graph, labels)[1]
    owner = np.searchsorted(bounds, contacts[:, 0], side="right") - 1
    parcels = {rank: contacts[owner == rank] for rank in np.unique(owner).tolist()}
    part_contacts = np.concatenate([np.empty((0, 3), np.int64), *ranks.exchanged(parcels).values()])
    first, count = int(bounds[ranks.rank]), int(bounds[ranks.rank + 1] - bounds[ranks.rank])
    component, ends = _connect_pieces(part_contacts[:, 1:])
    of_parts = np.unique(np.stack((part_contacts[:, 0], component[ends[:, 0]]), axis=1), axis=0)
    return frozen_int(np.bincount(of_parts[:, 0] - first, minlength=count))


def first_cells(mesh: DistributedMesh) -> Int:
    """Return for each cell of this rank the first cell of its connected component of the mesh. Collective."""
    ranks, own_ids = mesh.ranks, mesh.global_ids[mesh.own]
    names, contacts = _find_contacts(mesh, mesh.local.graph, frozen_int(np.zeros(len(own_ids))))
    pieces, place, piece_of = np.unique(names, return_index=True, return_inverse=True)
    pairs = np.concatenate(ranks.gathered(contacts[:, 1:]))
    first = np.concatenate(ranks.gathered(np.stack((pieces, own_ids[place]), axis=1)))
    component, _ = _connect_pieces(pairs)
    all_pieces = np.unique(pairs)
    least = np.full(component.max(initial=-1) + 1, np.iinfo(np.int64).max)
    np.minimum.at(least, component[np.searchsorted(all_pieces, first[:, 0])], first[:, 1])
    return frozen_int(least[component[np.searchsorted(all_pieces, pieces)]][piece_of])


def component_sizes(mesh: DistributedMesh, forbidden: Mask) -> Int:
    """Return the cell count per connected component of the mesh, in any order. Collective.

    Parameters
    ----------
    mesh : DistributedMesh
    forbidden : (m,) bool
        Forbidden entries in the local graph, equal on both sides where ranks meet.
    """
    ranks = mesh.ranks
    with ranks.together():
        graph = mesh.local.graph.without_edges(forbidden)
    # Components within ranks, and edges between components on different ranks.
    names, contacts = _find_contacts(mesh, graph, frozen_int(np.zeros(len(mesh.own))))
    edges = contacts[contacts[:, 1] != contacts[:, 2], 1:]
    pieces, sizes = np.unique(names, return_counts=True)
    beyond = np.isin(pieces, edges)  # components that continue on other ranks
    inner_sizes = np.stack(np.unique(sizes[~beyond], return_counts=True))
    every = ranks.gathered((edges.T, np.stack((pieces[beyond], sizes[beyond])), inner_sizes))
    # Join the continued components on every rank, and count the rest by size.
    edges, edge_pieces, inner_sizes = (np.concatenate(tables, axis=1) for tables in zip(*every, strict=True))
    of_whole = np.repeat(inner_sizes[0], inner_sizes[1])
    if not edges.size:
        return frozen_int(of_whole)
    component = _connect_pieces(edges.T)[0][np.searchsorted(np.unique(edges), edge_pieces[0])]
    return frozen_int(np.concatenate((np.bincount(component, edge_pieces[1]), of_whole)))


def _find_contacts(mesh: DistributedMesh, graph: Graph, labels: Int) -> tuple[Int, Int]:
    """Return a fragment per cell ``(n_own,)``, and rows ``(e, 3)``: a part and two touching fragments.

    A fragment is a connected component of a part on a rank, in the local ``graph``. Each fragment touches
    itself, too.
    """
    ranks = mesh.ranks
    part = np.asarray(mesh.exchange(labels))
    # Number the pieces uniquely across ranks, also on ghosts.
    with ranks.together():
        own = graph.subgraph(mesh.own, [0, len(mesh.own)])
        component = own.components(_number_labels(labels)) if own.n else np.empty(0, np.int64)
    names = np.zeros(len(part), np.int64)
    names[mesh.own] = component * ranks.size + ranks.rank  # unique over all ranks
    names = np.asarray(mesh.exchange(frozen_int(names[mesh.own])))
    # Collect pairs of pieces within a part, across ranks and with themselves.
    row = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    ours = mesh.owners == ranks.rank
    across = ours[row] & ~ours[graph.indices] & (part[row] == part[graph.indices])
    edges = np.stack((part[row], names[row], names[graph.indices]), axis=1)[across]
    alone = np.stack((labels, names[mesh.own], names[mesh.own]), axis=1)
    return frozen_int(names[mesh.own]), frozen_int(np.unique(np.concatenate((alone, edges)), axis=0))


def _number_labels(labels: Int) -> Int:
    return frozen_int(np.unique(labels, return_inverse=True)[1])


def _connect_pieces(edges: Int) -> tuple[Int, Int]:
    """Return the component of each fragment, sorted by id, and the ends of ``edges (e, 2)`` as indices."""
    names, place = np.unique(edges, return_inverse=True)
    ends = place.reshape(-1, 2)
    joins = sparse.coo_array((np.ones(len(ends), bool), tuple(ends.T)), shape=(len(names), len(names)))
    return frozen_int(connected_components(joins, directed=False)[1]), frozen_int(ends)
