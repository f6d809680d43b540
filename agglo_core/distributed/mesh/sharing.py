"""Distribution of a mesh from rank 0 to all ranks."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.distributed.agglomeration.blocks_by_coordinates import (
    coordinate_blocks,
    halvings,
    rank_of_block,
)
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.whole_cells import WholeCells, parcels
from agglo_core.errors import OptionError
from agglo_core.graph.ordering import curve_order
from agglo_core.mesh import Mesh

_METHODS = ("coordinates", "curve")

_LARGEST_SHARE = 1.6
"""Maximum cells per rank over the mean, for whole blocks. Four blocks on three ranks have 1.5.

Above, blocks are cut, and labels depend on the number of ranks (benchmarks/scale.py tetrahedra).
"""


def _along_curve(centroids: Float, size: int) -> Int:
    """Assign cells to ranks by intervals on a Hilbert curve."""
    rank = np.empty(len(centroids), np.int64)
    rank[curve_order(centroids)] = np.arange(len(rank)) * size // len(rank)
    return frozen_int(rank)


def _by_coordinates(centroids: Float, size: int, block_cells: int | None) -> Int:
    """Assign cells to ranks by whole coordinate blocks, or bisect boxes if blocks balance too badly."""
    depth = halvings(len(centroids), centroids.shape[1], block_cells)
    rank = rank_of_block(coordinate_blocks(centroids, depth), 1 << depth, size)
    largest = int(np.bincount(rank).max(initial=0))
    return rank if largest * size <= _LARGEST_SHARE * len(rank) else _in_boxes(centroids, size)


def _in_boxes(centroids: Float, size: int) -> Int:
    """Assign cells to ranks by recursive coordinate bisection across the longest side of the box."""
    rank = np.zeros(len(centroids), np.int64)
    stack = [(np.arange(len(rank)), 0, size)]
    while stack:
        cells, first, count = stack.pop()
        if count == 1 or not len(cells):
            rank[cells] = first
            continue
        points = centroids[cells]
        coordinate = points[:, int(np.argmax(np.ptp(points, axis=0)))]
        n_left = count // 2
        order = cells[np.argsort(coordinate, kind="stable")]
        cut = len(order) * n_left // count
        stack += [(order[:cut], first, n_left), (order[cut:], first + n_left, count - n_left)]
    return frozen_int(rank)


def scatter_cells(mesh: Mesh | None, ranks: Ranks, method: str, block_cells: int | None) -> WholeCells:
    """Send each rank its cells from rank 0, and return this rank's cells.

    Raises
    ------
    OptionError
        If rank 0 has no mesh, for an unknown method, or blocks without cells.
    """
    parcels: dict[int, WholeCells] = {}
    with ranks.together():
        if method not in _METHODS:
            raise OptionError(f"unknown method {method!r}; accepted: {', '.join(_METHODS)}")
        if ranks.rank == 0:
            if mesh is None:
                raise OptionError("rank 0 has no mesh to distribute: pass the mesh on rank 0")
            x, size = mesh.local_centroids, ranks.size
            rank = _along_curve(x, size) if method == "curve" else _by_coordinates(x, size, block_cells)
            parcels = _shares(mesh, rank, size)
    return ranks.exchanged(parcels)[0]


def _shares(mesh: Mesh, rank: Int, size: int) -> dict[int, WholeCells]:
    """Return the cells for each rank. A rank without cells still receives the tag names."""
    owners = frozen_int(np.append(rank, -1)[mesh.face_cells])
    whole = WholeCells(
        frozen_int(np.arange(mesh.n_cells)),
        rank,
        mesh.cell_tags,
        frozen_int(np.arange(mesh.n_faces)),
        mesh.face_offsets,
        mesh.face_vertices,
        mesh.face_cells,
        owners,
        mesh.face_tags,
        frozen_int(np.arange(mesh.n_points)),
        mesh.points,
    )
    sides = [np.flatnonzero(owners[:, side] >= 0) for side in (0, 1)]
    to = np.concatenate([owners[faces, side] for side, faces in enumerate(sides)])
    return parcels(
        whole, (rank, whole.cells), (frozen_int(to), frozen_int(np.concatenate(sides))), range(size)
    )
