"""Barriers: fractures, faults, walls that have no part on both sides, not even around their tips."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.mesh.marks import marked


class Barriers:
    """No part lies on both sides of a barrier, which is some faces between cells.

    Parameters
    ----------
    pairs : (p, 2) int
        The two cells beside each face of a barrier.
    """

    def __init__(self, pairs: Int) -> None:
        self.pairs = np.asarray(pairs).reshape(-1, 2)

    def forbidden(self, graph: Graph) -> Mask:
        """Entries of the graph ``(m,)`` between two cells with a face of a barrier."""
        if self.pairs.size and self.pairs.max() >= graph.n:
            raise OptionError(f"a barrier is beside cell {self.pairs.max()}, and there are {graph.n} cells")
        touched = np.zeros(graph.n, bool)
        touched[self.pairs] = True
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        near = np.flatnonzero(touched[rows] & touched[graph.indices])
        one, other = np.sort(np.stack((rows[near], graph.indices[near])), axis=0)
        low, high = np.sort(self.pairs, axis=1).T
        found = np.zeros(len(graph.indices), bool)
        found[near] = np.isin(one * graph.n + other, low * graph.n + high)
        return found

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Which parts ``(k,)`` have no barrier inside them."""
        good = np.ones(int(labels.max(initial=-1)) + 1, bool)
        one, other = labels[self.pairs].T
        good[one[one == other]] = False
        return good

    def halves(self, graph: Graph, labels: Int, through: Int) -> Int:
        """Sides ``(n,)`` of the nodes of parts with a barrier inside; cell c lies in the node ``through[c]``.

        Nodes beside a barrier are on different sides of it, all others on the side of the nearest of them.
        """
        from agglo_core.constraints.barrier_sides import barrier_sides

        one, other = through[self.pairs].T
        inside = (labels[one] == labels[other]) & (one != other)
        pairs = np.concatenate((self.pairs[inside], self.pairs[inside, ::-1]))
        nodes = through[pairs]
        nodes = nodes[np.argsort(nodes[:, 0], kind="stable")]
        first = np.concatenate(([0], np.cumsum(np.bincount(nodes[:, 0], minlength=graph.n))))
        return frozen_int(
            barrier_sides(
                graph.indptr, graph.indices, frozen_int(labels), frozen_int(first), frozen_index(nodes[:, 1])
            )
        )


class BarrierTags:
    """No part lies on both sides of a face with one of these tags.

    Parameters
    ----------
    tags : str or tuple of str
        Names of face tags, for the faces of these groups, or ``"name=3"`` for those with that value. In
        Python also whatever :func:`~agglo_core.mesh.marks.marked` accepts.
    """

    def __init__(self, tags: str | tuple[str, ...] = "region") -> None:
        self.tags = tags

    def for_mesh(self, mesh: Mesh) -> Barriers:
        """The barriers of this mesh; an OptionError if it lacks a tag."""
        chosen = marked("barriers", self.tags, mesh.face_tags, mesh.n_faces, "face")
        return Barriers(mesh.face_cells[chosen & (mesh.face_cells[:, 1] >= 0)])
