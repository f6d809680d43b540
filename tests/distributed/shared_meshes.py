"""Meshes for the tests of distributed files, and helpers for each rank."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from agglo_core import Mesh, samples
from agglo_core.distributed import DistributedMesh, Ranks, write

__all__ = ["MESHES", "shared", "write_all"]


def _ring() -> Mesh:
    """Return a 2-D mesh in which one cell has a hole."""
    around = np.isin(np.arange(36), [7, 8, 9, 13, 15, 19, 20, 21])
    return samples.squares(6).coarsen(np.where(around, 0, np.cumsum(~around)))


def _tagged(mesh: Mesh) -> Mesh:
    """Add cell tags with small and large numbers, and a face tag."""
    cells, outer = np.arange(mesh.n_cells), mesh.face_cells[:, 1] < 0
    sides = np.where(outer, 1 + np.arange(mesh.n_faces) % 4, 0)
    tags = {"far": np.where(cells == 3, 1 << 40, cells), "half": cells % 2}
    return replace(mesh, cell_tags=tags, face_tags={"side": sides})


def _crack() -> Mesh:
    """Return four squares, two of which do not share the point in the middle."""
    squares = samples.squares(2)
    points = np.concatenate((squares.points, [[0.5, 0.5]]))
    cells = [[0, 1, 4, 3], [1, 2, 5, 9], [3, 4, 7, 6], [9, 5, 8, 7]]
    return Mesh.from_polygons(points, cells, merge_points=False, allow_gaps=True)


MESHES = {
    "plane": lambda: _tagged(samples.voronoi(90, seed=5)),
    "solid": lambda: _tagged(samples.boxes(3)),
    "ring": lambda: _tagged(_ring()),
    "few": lambda: samples.squares(1),
    "crack": _crack,
}


def shared(mesh: Mesh) -> DistributedMesh:
    """Scatter the mesh from rank 0."""
    ranks = Ranks()
    return DistributedMesh.scatter(mesh if ranks.rank == 0 else None, ranks)


def write_all(folder: str) -> None:
    """Write all meshes as ``NAME.pvtu``."""
    for name, make in MESHES.items():
        write(Path(folder) / f"{name}.pvtu", shared(make()), compress=name == "solid")
