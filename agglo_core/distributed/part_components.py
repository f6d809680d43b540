"""Whether parts are connected that lie on several ranks."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.distributed_mesh import DistributedMesh

__all__ = ["components_of_parts"]


def components_of_parts(mesh: DistributedMesh, labels: Int, bounds: Int) -> Int:
    """Number of connected components of each part that this rank has.

    Each rank finds the components of its own cells; who has the part joins those that touch across ranks.

    Parameters
    ----------
    mesh : DistributedMesh
    labels : (n_own,) int
        Global part of each own cell.
    bounds : (size + 1,) int
        Rank r has the parts ``bounds[r]:bounds[r + 1]``.
    """
    ranks, graph = mesh.ranks, mesh.local.graph
    part = np.asarray(mesh.exchange(labels))
    with ranks.together():
        own = graph.subgraph(mesh.own, [0, len(mesh.own)])
        component = own.components(_numbered(labels)) if own.n else np.empty(0, np.int64)
    names = np.zeros(len(part), np.int64)
    names[mesh.own] = component * ranks.size + ranks.rank  # of a component, on no other rank
    names = np.asarray(mesh.exchange(frozen_int(names[mesh.own])))
    row = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    ours = mesh.owners == ranks.rank
    across = ours[row] & ~ours[graph.indices] & (part[row] == part[graph.indices])
    edges = np.stack((part[row], names[row], names[graph.indices]), axis=1)[across]
    alone = np.stack((labels, names[mesh.own], names[mesh.own]), axis=1)
    told = np.unique(np.concatenate((alone, edges)), axis=0)
    owner = np.searchsorted(bounds, told[:, 0], side="right") - 1
    parcels = {rank: told[owner == rank] for rank in np.unique(owner).tolist()}
    found = np.concatenate([np.empty((0, 3), np.int64), *ranks.exchanged(parcels).values()])
    first, count = int(bounds[ranks.rank]), int(bounds[ranks.rank + 1] - bounds[ranks.rank])
    return _joined(found, first, count)


def _numbered(labels: Int) -> Int:
    return frozen_int(np.unique(labels, return_inverse=True)[1])


def _joined(edges: Int, first: int, count: int) -> Int:
    """Components of the parts ``first`` to ``first + count``; ``edges (e, 3)``: part, two of its pieces."""
    names, place = np.unique(edges[:, 1:], return_inverse=True)
    ends = place.reshape(-1, 2)
    joins = sparse.coo_array((np.ones(len(ends), bool), tuple(ends.T)), shape=(len(names), len(names)))
    component = connected_components(joins, directed=False)[1]
    of_parts = np.unique(np.stack((edges[:, 0], component[ends[:, 0]]), axis=1), axis=0)
    return frozen_int(np.bincount(of_parts[:, 0] - first, minlength=count))
