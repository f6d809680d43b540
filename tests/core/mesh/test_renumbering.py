"""A mesh with its cells in another order: the same cells, whatever their numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agglo_core import Mesh, samples
from agglo_core.errors import MeshError


def tagged(mesh: Mesh) -> Mesh:
    """Every cell and every face has a tag of its own."""
    return replace(
        mesh,
        cell_tags={"cell": np.arange(mesh.n_cells)},
        face_tags={"face": np.arange(mesh.n_faces)},
        name="tagged",
    )


@pytest.mark.parametrize("make", [lambda: samples.voronoi(60, seed=4), lambda: samples.tetrahedra(2)])
def test_cells_faces_and_points_are_those_of_before(make) -> None:
    mesh = tagged(make())
    cells = np.random.default_rng(4).permutation(mesh.n_cells)
    there = mesh.renumbered(cells)
    faces = there.face_tags["face"]
    assert (there.n_cells, there.n_faces, there.name) == (mesh.n_cells, mesh.n_faces, "tagged")
    assert np.array_equal(there.cell_tags["cell"], cells)
    assert len(set(faces.tolist())) == mesh.n_faces
    number = np.append(np.argsort(cells), -1)
    assert np.array_equal(there.face_cells, number[mesh.face_cells[faces]])
    for at, face in enumerate(faces):
        new, old = (
            each.points[each.face_vertices[slice(*each.face_offsets[f : f + 2])]]
            for each, f in ((there, at), (mesh, face))
        )
        assert np.array_equal(new, old)
    assert np.allclose(there.cell_measures, mesh.cell_measures[cells], rtol=1e-13)


def test_faces_and_points_come_as_cells_meet_them() -> None:
    mesh = samples.voronoi(60, seed=5)
    there = mesh.renumbered(np.random.default_rng(5).permutation(mesh.n_cells))
    first_cell = np.where(there.face_cells[:, 1] < 0, there.face_cells[:, 0], there.face_cells.min(axis=1))
    assert np.all(np.diff(first_cell) >= 0)
    _, first = np.unique(there.face_vertices, return_index=True)
    assert np.all(np.diff(first) > 0)


def test_points_without_a_face_are_left_out() -> None:
    mesh = samples.squares(4)
    coarse = mesh.coarsen(np.arange(16) // 8)
    there = coarse.renumbered([1, 0])
    assert (coarse.n_points, there.n_points) == (25, 19)
    assert np.allclose(there.cell_centroids, coarse.cell_centroids[::-1])


@pytest.mark.parametrize(
    "cells", [[0, 1, 2], [0, 1, 2, 2], [0, 1, 2, 4], [-1, 0, 1, 2], [0.0, 1.0, 2.0, 3.0]]
)
def test_an_order_holds_each_cell_once(cells) -> None:
    with pytest.raises(MeshError, match=r"each of 0\.\.3 once"):
        samples.squares(2).renumbered(cells)
