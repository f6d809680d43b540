"""Pair half-edges of 2-D cells into faces, if every edge has one cell, or one on each side.

``match_half_edges`` handles all other meshes. Here the half-edges are first sorted into buckets of points
that fit into a cache. The caller allocates the largest arrays, see
:mod:`agglo_core.mesh.kernels.plane_cells`.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel

BITS = 11
"""Number of points per bucket, as a power of two.

Larger buckets exceed the cache, smaller buckets are more (benchmarks/building.py).
"""


@kernel
def to_buckets(offsets, vertices, first, places, edges):
    """Sort the half-edges of cells, from ``first`` on, into buckets by their lower vertex index.

    An entry is (lower end, upper end, half-edge, cell).

    The next entry of bucket b is written to ``edges[places[b]]``, and ``places[b]`` is incremented. If
    ``edges`` is empty, entries are only counted. The upper end is stored as ~upper if the half-edge starts
    there.
    """
    c, count_only = 0, len(edges) == 0
    for h in range(offsets[0], offsets[len(offsets) - 1]):
        c += h == offsets[c + 1]  # no loop over cells, whose end would be mispredicted
        a, b = vertices[h], vertices[h + 1 if h + 1 < offsets[c + 1] else offsets[c]]
        low, high = min(a, b), max(a, b)
        i = places[low >> BITS]
        places[low >> BITS] = i + 1
        if not count_only:
            edges[i, 0], edges[i, 1] = low, high if a == low else ~high
            edges[i, 2], edges[i, 3] = h, first + c


@kernel
def pair_half_edges(edges, bounds, first, beyond):
    """Find the cell across each half-edge, for counter-clockwise cells.

    It is −1 outside, and −2 at the second half-edge of a pair.

    The entries of bucket ``first + k`` are ``edges[bounds[k]:bounds[k + 1]]``, with rows (lower end, upper
    end, half-edge, cell) from :func:`to_buckets`. Returns the pair count, or −1 if an edge has more than
    two cells, two cells on the same side, or one cell on both sides; the output is then invalid.
    """
    most = 0
    for k in range(len(bounds) - 1):
        most = max(most, bounds[k + 1] - bounds[k])
    head, link = np.empty(1 << BITS, np.int32), np.empty(most, np.int32)
    pairs = 0
    for k in range(len(bounds) - 1):
        # 1. Empty lists, one per lower end in the bucket.
        start = bounds[k]
        for v in range(len(head)):
            head[v] = -1
        for i in range(start, bounds[k + 1]):
            # 2. Search an earlier half-edge of the same edge: its key is ~key, or key for the same direction.
            low, key = edges[i, 0] - ((first + k) << BITS), edges[i, 1]
            j = head[low]
            while j >= 0 and edges[j, 1] != key and edges[j, 1] != ~key:
                j = link[j - start]
            # 3. The first half-edge of an edge is outside for now. The second must have the opposite
            #    direction and another cell. It gets −2, because the first one creates the face; a third is an
            #    error.
            if j < 0:
                beyond[edges[i, 2]] = -1
                link[i - start] = head[low]
                head[low] = i
            elif edges[j, 1] == ~key and beyond[edges[j, 2]] == -1 and edges[j, 3] != edges[i, 3]:
                beyond[edges[j, 2]], beyond[edges[i, 2]] = edges[i, 3], -2
                pairs += 1
            else:
                return -1
    return pairs


@kernel
def number_faces(offsets, vertices, beyond, first, face_vertices, face_cells):
    """Number the faces of cells ``first``, ... in order of first visit, and write their vertices and cells.

    Cell ``first + c`` has the half-edges ``offsets[c]:offsets[c + 1]``. Half-edges with ``beyond`` ≥ −1 are
    faces; the output has space for these only.
    """
    f, c = 0, 0
    for h in range(offsets[0], offsets[len(offsets) - 1]):
        c += h == offsets[c + 1]
        if f < len(face_cells):  # entries that are no face are overwritten later
            face_vertices[f, 0] = vertices[h]
            face_vertices[f, 1] = vertices[h + 1 if h + 1 < offsets[c + 1] else offsets[c]]
            face_cells[f, 0], face_cells[f, 1] = first + c, beyond[h]
        f += beyond[h] >= -1
