"""VTK's PolyData: points, lines, polygons and strips as cells of an unstructured grid."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.arrays import Int, frozen_int

KINDS = ("Verts", "Lines", "Polys", "Strips")
"""Kinds of cells in the order in which VTK numbers them."""

_TYPES = {"Verts": 2, "Lines": 4, "Polys": 7, "Strips": 6}
_LINE, _POLYLINE = 3, 4


class StoredArrays(dict[str, Int]):
    """Arrays of whole numbers of a piece that are in memory already."""

    def take(self, name: str, declared: int) -> Int:
        """Values of an array."""
        return self[name]


def polydata_cells(lists: Mapping[str, tuple[Int, Int]]) -> StoredArrays:
    """Types, offsets and points of the cells of a PolyData, by the names of VTU files.

    Parameters
    ----------
    lists : mapping of kind to (ends, points)
        For each of :data:`KINDS` that there is, where the points of each cell end, and the points.
    """
    types, offsets, points = [], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for kind in KINDS:
        ends, vertices = lists.get(kind, (frozen_int([]), frozen_int([])))
        sizes = np.diff(ends, prepend=0)
        own = np.full(len(ends), _TYPES[kind])
        types.append(np.where((own == _POLYLINE) & (sizes == 2), _LINE, own))
        offsets.append(ends + sum(map(len, points)))
        points.append(vertices)
    return StoredArrays(
        types=frozen_int(np.concatenate(types)),
        offsets=frozen_int(np.concatenate(offsets)),
        connectivity=frozen_int(np.concatenate(points)),
    )
