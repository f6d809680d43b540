"""Chains of edges through vertices of degree two, and the removal of superfluous vertices from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int


class Chains(NamedTuple):
    """Chains of consecutive edges, as CSR.

    Chain c has ``edges[offsets[c]:offsets[c + 1]]`` and one vertex more, in order.

    Its vertices are ``vertices[offsets[c] + c:offsets[c + 1] + c + 1]``; the first and last vertex of a
    closed chain are equal.
    """

    offsets: Int
    edges: Int
    vertices: Int

    @property
    def n(self) -> int:
        """Chain count."""
        return len(self.offsets) - 1

    @property
    def of_edges(self) -> Int:
        """Index of the chain that contains each entry of ``edges``."""
        return frozen_int(np.repeat(np.arange(self.n), np.diff(self.offsets)))

    @property
    def before(self) -> Int:
        """Index into ``vertices`` of the vertex before each edge."""
        return frozen_int(np.arange(len(self.edges)) + self.of_edges)

    def thin(self, points: Float, limits: Float, chains: Int, keep: Mask) -> None:
        """Mark vertices to keep such that all others lie within ``limits (n,)`` of the new chains."""
        from agglo_core.mesh.kernels.edge_chains import thin_chains

        thin_chains(points, self.offsets, self.vertices, frozen_float(limits), frozen_int(chains), keep)

    def runs(self, keep: Mask) -> Int:
        """Return for each entry of ``edges`` the index of the merged edge that replaces it."""
        begins = keep[self.before]
        return frozen_int(np.cumsum(begins) - 1)


def ends_at(ends: Int, n_points: int) -> tuple[Mask, Int]:
    """Find the vertices of degree two among edges ``(E, 2)``, and their two edges ``(n_points, 2)``.

    Return the mask of these vertices, and their edges.
    """
    order = np.argsort(ends.ravel(), kind="stable")
    count = np.bincount(ends.ravel(), minlength=n_points)
    first = np.cumsum(count) - count
    two = count == 2
    at = np.full((n_points, 2), -1)
    at[two] = order[first[two][:, None] + [0, 1]] // 2
    return two, frozen_int(at)


def chains_of(points: Float, ends: Int, joint: Mask, at: Int) -> Chains:
    """Trace chains of edges ``(E, 2)`` through the vertices ``joint`` of degree two (edges ``at``)."""
    from agglo_core.mesh.kernels.edge_chains import walk_chains

    return Chains(*map(frozen_int, walk_chains(points, ends, joint, at)))
