"""Barriers: no part lies on both sides of fractures, faults or walls, not even around their tips."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.mesh.marks import select_members


class Barriers:
    """Constraint: no part lies on both sides of a barrier, a set of interior faces.

    Parameters
    ----------
    pairs : (p, 2) int
        The two cells adjacent to each barrier face.
    """

    def __init__(self, pairs: Int) -> None:
        self.pairs = np.asarray(pairs).reshape(-1, 2)

    def forbidden(self, graph: Graph) -> Mask:
        """Return a mask ``(m,)`` of the dual edges that cross a barrier face."""
        if self.pairs.size and self.pairs.max() >= graph.n:
            raise OptionError(
                f"a barrier is adjacent to cell {self.pairs.max()}, but there are only {graph.n} cells"
            )
        # 1. Entries between cells adjacent to barriers.
        touched = np.zeros(graph.n, bool)
        touched[self.pairs] = True
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        near = np.flatnonzero(touched[rows] & touched[graph.indices])
        # 2. The entries among them that are barrier pairs.
        low_cell, high_cell = np.sort(np.stack((rows[near], graph.indices[near])), axis=0)
        low, high = np.sort(self.pairs, axis=1).T
        crossings = np.zeros(len(graph.indices), bool)
        crossings[near] = np.isin(low_cell * graph.n + high_cell, low * graph.n + high)
        return crossings

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Return a mask ``(k,)`` of the parts without a barrier face in their interior."""
        good = np.ones(int(labels.max(initial=-1)) + 1, bool)
        one, other = labels[self.pairs].T
        good[one[one == other]] = False
        return good

    def halves(self, graph: Graph, labels: Int, through: Int) -> Int:
        """Return the side (0 or 1) per node ``(n,)`` in parts with a barrier inside.

        Cell c lies in node ``through[c]``. Nodes adjacent to a barrier are on different sides, all other
        nodes on the side of the nearest barrier node.
        """
        from agglo_core.constraints.barrier_sides import barrier_sides

        # 1. Barrier pairs inside parts, in both directions, as a CSR by node.
        one, other = through[self.pairs].T
        inside = (labels[one] == labels[other]) & (one != other)
        pairs = np.concatenate((self.pairs[inside], self.pairs[inside, ::-1]))
        nodes = through[pairs]
        nodes = nodes[np.argsort(nodes[:, 0], kind="stable")]
        first = np.concatenate(([0], np.cumsum(np.bincount(nodes[:, 0], minlength=graph.n))))
        # 2. Sides on the graph.
        return frozen_int(
            barrier_sides(
                graph.indptr, graph.indices, frozen_int(labels), frozen_int(first), frozen_index(nodes[:, 1])
            )
        )


class BarrierTags:
    """Constraint: no part lies on both sides of a face with one of these tags.

    Parameters
    ----------
    tags : str or tuple of str
        Face tag names, for the faces in their groups, or ``"name=3"`` for faces with that value. In
        Python all inputs of :func:`~agglo_core.mesh.marks.select_members` are accepted.
    """

    def __init__(self, tags: str | tuple[str, ...] = "region") -> None:
        self.tags = tags

    def for_mesh(self, mesh: Mesh) -> Barriers:
        """Return the barriers that the tags mark on a mesh, or raise OptionError for a missing tag."""
        chosen = select_members("barriers", self.tags, mesh.face_tags, mesh.n_faces, "face")
        return Barriers(mesh.face_cells[chosen & (mesh.face_cells[:, 1] >= 0)])
