"""``mesh.cells``: exact vertices, the mesh rebuilt from them, holes, sequence behaviour; ``mesh.write``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import FileError, Mesh, MeshError, samples

MESHES = {
    "squares": samples.squares(3),
    "voronoi": samples.voronoi(60, seed=1),
    "coarse": samples.squares(4).coarsen(np.repeat([0, 1, 2, 3], 4)),  # with points that no cell uses
    "two squares": Mesh.from_polygons(
        [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]], [[0, 1, 4, 5], [1, 2, 3, 4]]
    ),
    "one cube": samples.boxes(1),
    "boxes": samples.boxes(2),
    "prisms": samples.prisms(30, 3),
    "coarse boxes": samples.boxes(3).coarsen(np.arange(27) // 9),
}


def rebuilt(mesh: Mesh) -> Mesh:
    """The mesh built from its points and cells alone."""
    if mesh.dim == 3:
        return Mesh.from_polyhedra(mesh.points, mesh.cells)
    return Mesh.from_polygons(mesh.points, mesh.cells, weak=True)


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_a_mesh_is_rebuilt_from_its_cells(mesh: Mesh) -> None:
    again = rebuilt(mesh)
    assert (again.n_cells, again.n_faces) == (mesh.n_cells, mesh.n_faces)
    assert "clockwise" not in str(dict(again.repairs))
    np.testing.assert_allclose(again.cell_measures, mesh.cell_measures, rtol=1e-12)
    assert abs(again.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-12


def test_squares_are_counter_clockwise_from_their_first_corner() -> None:
    cells = samples.squares(2).cells
    assert [cell.tolist() for cell in cells] == [[0, 1, 4, 3], [4, 1, 2, 5], [3, 4, 7, 6], [4, 5, 8, 7]]
    np.testing.assert_array_equal(np.asarray(cells)[3], [4, 5, 8, 7])


def test_faces_of_polyhedra_are_counter_clockwise_from_outside() -> None:
    """Also those that the neighbour owns, which are stored in the other direction."""
    mesh = samples.boxes(2)
    for cell, centroid in zip(mesh.cells, mesh.cell_centroids, strict=True):
        assert len(cell) == 6
        for loop in cell:
            a, b, c = mesh.points[loop[:3]]
            assert np.cross(b - a, c - b) @ (a - centroid) > 0


def test_holes_are_joined_by_an_edge_in_both_directions() -> None:
    mesh = samples.squares(3).coarsen([0, 0, 0, 0, 1, 0, 0, 0, 0])
    ring, hole = mesh.cells
    assert (len(ring), len(hole)) == (12 + 4 + 2, 4)
    edges = {frozenset(edge) for edge in zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True)}
    assert len(edges) == 12 + 4 + 1
    assert rebuilt(mesh).cell_measures.tolist() == pytest.approx([8 / 9, 1 / 9])


@pytest.mark.parametrize("mesh", [samples.squares(2), samples.boxes(2)], ids=["plane", "solid"])
def test_cells_are_a_sequence(mesh: Mesh) -> None:
    cells, n = mesh.cells, mesh.n_cells
    assert mesh.cells is cells
    assert len(cells) == len(list(cells)) == n
    np.testing.assert_array_equal(cells[-1], cells[np.int64(n - 1)])
    np.testing.assert_array_equal(cells[1:3], [cells[1], cells[2]])
    assert repr(cells).endswith(f"List({n} cells)")
    for place in (n, -n - 1):
        with pytest.raises(IndexError, match=rf"cell {place} is out of range: the mesh has {n} cells"):
            cells[place]
    with pytest.raises(TypeError, match="integer"):
        cells["0"]  # type: ignore[index]


@pytest.mark.parametrize("mesh", [samples.squares(2), samples.boxes(2)], ids=["plane", "solid"])
def test_cells_are_views_of_the_arrays_of_the_mesh(mesh: Mesh) -> None:
    source = mesh.face_vertices if mesh.dim == 3 else mesh.boundary_loops.vertices
    for cell in mesh.cells:
        for loop in cell if mesh.dim == 3 else [cell]:
            assert np.shares_memory(loop, source)
            assert not loop.flags.writeable


def test_write_writes_the_mesh(tmp_path: Path) -> None:
    mesh = samples.squares(3).with_tags(rock=np.arange(9))
    mesh.write(tmp_path / "m.npz", compress=True)
    back = agglo.read(tmp_path / "m.npz")
    assert back.fingerprint == mesh.fingerprint
    assert back.cell_tags["rock"].tolist() == list(range(9))
    with pytest.raises(FileError, match=r"m\.foam: OpenFOAM needs a 3-D mesh, given a 2-D one"):
        mesh.write(tmp_path / "m.foam")
    with pytest.raises(MeshError, match="tag"):
        samples.squares(3).with_tags(**{"a\0b": np.arange(9)}).write(tmp_path / "m.vtu")
