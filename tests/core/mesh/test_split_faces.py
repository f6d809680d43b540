"""Faces of solids that smaller ones tile: rounded to single precision, and warped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from core.mesh.test_conforming import bricks, pairs, solids, together
from numpy.typing import NDArray

from agglo_core import Mesh, MeshError, read, write
from agglo_core.io.to_mesh.plain_cells import half_faces

BEND = [[3.0, 0.7, 0.2], [-0.3, 2.0, 0.1], [0.1, 0.3, 1.1]]


@pytest.mark.parametrize(("n", "shift"), [(2, 0.0), (2, 10.0), (5, 100.0)])
def test_in_single_precision(tmp_path: Path, n: int, shift: float) -> None:
    """The points that hang on an edge are rounded away from it. What is written is read back."""
    points, cells = together(bricks(n, 0), bricks(2 * n, 1))
    mesh = solids(((points @ BEND + shift).astype(np.float32), cells))
    inner = 3 * n**2 * (n - 1) + 3 * (2 * n) ** 2 * (2 * n - 1)
    assert pairs(mesh) == inner + (2 * n) ** 2
    assert mesh.repairs["faces split like those of neighbours"] == n**2
    write(tmp_path / "bent.vtu", mesh)
    back = read(tmp_path / "bent.vtu")
    assert pairs(back) == pairs(mesh)
    assert back.cell_measures == pytest.approx(mesh.cell_measures, rel=1e-9)


def test_a_cell_that_lacks_a_tile_does_not_close() -> None:
    mesh = solids(((bricks(1, 0)[0] @ BEND).astype(np.float32), bricks(1, 0)[1]))
    cells, loops, vertices = half_faces(mesh)
    moved = np.concatenate((mesh.points, mesh.points[vertices[:1]] + 1e-3))
    with pytest.raises(MeshError, match="do not close"):
        Mesh.from_polyhedra(moved, (cells, loops, np.concatenate(([8], vertices[1:]))), merge_points=False)


def warped(points: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Points of two cubes side by side, whose corners are moved and all else with them."""
    moves = np.random.default_rng(seed).uniform(-0.15, 0.15, (3, 2, 2, 3))
    block = np.minimum(points[:, 0].astype(int), 1)
    along = points - np.eye(3)[0] * block[:, None]
    moved = points.copy()
    for i, j, k in np.ndindex(2, 2, 2):
        weight = np.where([i, j, k], along, 1 - along).prod(axis=1)
        moved += weight[:, None] * moves[block + i, j, k]
    return moved


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_warped_faces_of_refined_hexahedra(tmp_path: Path, seed: int, kind: type) -> None:
    """Edges are straight, so tiles have the area vector and the border of the face."""
    points, cells = together(bricks(1, 0), bricks(2, 1))
    mesh = solids((warped(points, seed).astype(kind), cells))
    assert (mesh.n_cells, pairs(mesh)) == (9, 12 + 4)
    assert mesh.repairs["faces split like those of neighbours"] == 1
    assert (mesh.face_cells[:, 1] < 0).sum() == 5 + 20
    write(tmp_path / "warped.vtu", mesh)
    assert pairs(read(tmp_path / "warped.vtu")) == 16


def test_a_warped_face_and_others_beside_it_stay_apart() -> None:
    """The gap is smaller than the face is warped, but no point of one is on the other."""
    points, cells = together(bricks(1, 0), bricks(2, 1))
    moved = warped(points, 1) + np.where(np.arange(len(points)) < 8, 0, 0.02)[:, None]
    assert pairs(solids((moved, cells))) == 12
