"""Measure memory and messages of a distributed mesh: ``mpiexec -n 4 python .../distributed_mesh.py``.

Each rank makes its own strip of a square of triangles. Bytes are per local cell, including ghosts. Seconds
are those of the slowest rank, and have little meaning if ranks share cores.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from agglo_core.distributed import DistributedMesh, Ranks


def held(mesh: DistributedMesh) -> int:
    """Return the bytes of all primary arrays."""
    local = mesh.local
    arrays = (local.points, local.face_offsets, local.face_vertices, local.face_cells, mesh.global_ids)
    return sum(each.nbytes for each in (*arrays, mesh.owners, mesh.point_ids, mesh.face_ids, mesh.hidden))


def strip(ranks: Ranks, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, triangles and global point ids for the rows of this rank.

    All rows form a square with ``side`` × ``side`` cells.
    """
    rows = np.array_split(np.arange(side), ranks.size)[ranks.rank]
    ids = np.arange(rows[0] * (side + 1), (rows[-1] + 2) * (side + 1))
    corner = (rows[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1) - ids[0]
    cells = corner + np.array([0, 1, side + 2, 0, side + 2, side + 1])
    points = np.stack((ids % (side + 1), ids // (side + 1)), axis=1) / side
    return points, cells.reshape(-1, 3), ids


def main(side: int = 708) -> None:
    ranks = Ranks()
    points, cells, ids = strip(ranks, side)
    start = time.perf_counter()
    mesh = DistributedMesh.from_local(ranks, points, cells, ids)
    seconds = ranks.largest(time.perf_counter() - start)
    most = ranks.largest(held(mesh) / mesh.local.n_cells)
    sent = ranks.summed(ranks.traffic.bytes) / 1e6
    if ranks.rank == 0:
        print(f"{mesh.n_cells} triangles on {ranks.size} ranks: {most:.0f} bytes per cell held,")
        print(f"{sent:.1f} MB sent and {seconds:.1f} s while it was made")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
