"""VTK and meshio open what agglo writes, with the same cells and cell data. Skipped without them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import Hierarchy, Mesh, agglomerate, samples, write

MESHES: dict[str, Callable[[], Mesh]] = {
    "triangles": lambda: samples.triangles(5),
    "squares": lambda: samples.squares(5),
    "polygons": lambda: samples.voronoi(60, seed=4),
    "tetrahedra": lambda: samples.tetrahedra(2),
    "boxes": lambda: samples.boxes(3),
    "polyhedra": lambda: samples.voronoi3d(20),
}
PLANE, ALL = ("triangles", "squares", "polygons"), tuple(MESHES)
WITH_DATA = {".vtu": ALL, ".vtkhdf": ALL, ".vtk": (*PLANE, "tetrahedra")}
VTK = [(suffix, name) for suffix, names in WITH_DATA.items() for name in names]
VTK += [(suffix, name) for suffix in (".ply", ".obj") for name in PLANE]
MESHIO = [(".vtu", name) for name in (*PLANE, "tetrahedra", "boxes")]  # not polyhedra beside other cells
MESHIO += [(".msh", name) for name in ("triangles", "squares", "tetrahedra", "boxes")]
MESHIO += [(".vtk", name) for name in ("triangles", "squares", "tetrahedra")]
MESHIO += [(".ply", name) for name in ("triangles", "squares")]  # polygons of several sizes only without data
MESHIO += [(".obj", "triangles"), (".off", "triangles")]


def written(folder: Path, suffix: str, name: str) -> tuple[Path, Mesh, Hierarchy]:
    """A file with a tag and a level, in a format that can be used here."""
    if suffix == ".vtkhdf":
        pytest.importorskip("h5py")
    mesh = MESHES[name]()
    number = (mesh.cell_centroids[:, 0] * 100).astype(int) - 7
    mesh = mesh.with_tags(rock=lambda x: x[:, 0] < 0.4, number=number)
    mesh = mesh.with_face_tags(inlet=lambda x: np.isclose(x[:, 0], 0))
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=5)
    write(folder / f"m{suffix}", mesh, hierarchy)
    return folder / f"m{suffix}", mesh, hierarchy


def loops_of_cells(mesh: Mesh) -> list[set[tuple[float, ...]]]:
    """The points of each cell, by their coordinates in space."""
    points = np.zeros((mesh.n_points, 3))
    points[:, : mesh.dim] = mesh.points.round(9)
    offsets, vertices = mesh.cell_vertices
    return [set(map(tuple, points[each].tolist())) for each in np.split(vertices, offsets[1:-1])]


def check_data(data: Any, mesh: Mesh, hierarchy: Hierarchy) -> None:
    for tag in ("rock", "number"):
        assert np.asarray(data[tag]).astype(int).tolist() == mesh.cell_tags[tag].tolist()
    assert np.asarray(data["level_0"]).astype(int).tolist() == hierarchy.levels[0].tolist()


@pytest.mark.parametrize(("suffix", "name"), VTK)
def test_vtk_opens_it(suffix: str, name: str, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    file, mesh, hierarchy = written(tmp_path, suffix, name)
    grid = pyvista.read(file)
    cells = [set(map(tuple, np.round(grid.get_cell(i).points, 6).tolist())) for i in range(grid.n_cells)]
    ours = [{tuple(np.round(p, 6).tolist()) for p in cell} for cell in loops_of_cells(mesh)]
    single = suffix in (".ply", ".obj")  # VTK reads their points in single precision
    assert len(cells) == len(ours)
    assert [len(cell) for cell in cells] == [len(cell) for cell in ours]
    if not single:
        assert cells == ours
    if suffix in WITH_DATA:
        check_data(grid.cell_data, mesh, hierarchy)
    if mesh.dim == 2:
        np.testing.assert_allclose(grid.area, mesh.cell_measures.sum(), rtol=1e-5 if single else 1e-12)


@pytest.mark.parametrize("suffix", [".vtu", ".vtkhdf"])
def test_vtk_opens_the_coarse_meshes(suffix: str, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    file, _, hierarchy = written(tmp_path, suffix, "polygons")
    grid = pyvista.read(file.with_name(f"m_level0{suffix}"))
    assert grid.cell_data["agglomerate"].tolist() == list(range(5))
    np.testing.assert_allclose(grid.cell_data["measure"], hierarchy.mesh(0).cell_measures)


@pytest.mark.parametrize(("suffix", "name"), MESHIO)
def test_meshio_opens_it(suffix: str, name: str, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    file, mesh, hierarchy = written(tmp_path, suffix, name)
    found = meshio.read(file)
    own = [i for i, block in enumerate(found.cells) if block.dim == mesh.dim]
    points = np.zeros((len(found.points), 3))
    points[:, : found.points.shape[1]] = found.points
    cells = [set(map(tuple, points[row].round(9).tolist())) for i in own for row in found.cells[i].data]
    assert cells == loops_of_cells(mesh)
    if suffix in (".obj", ".off"):
        return
    data = {key: np.concatenate([values[i] for i in own]) for key, values in found.cell_data.items()}
    for group, sets in found.cell_sets.items():  # physical groups of Gmsh
        if not group.startswith("gmsh:"):
            sizes = [len(found.cells[i].data) for i in own]
            inside = [np.isin(np.arange(n), sets[i]) for i, n in zip(own, sizes, strict=True)]
            data[group] = np.concatenate(inside)
    check_data(data, mesh, hierarchy)
