"""Real files of the field, where they are at hand: meshes as an independent reading finds them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from agglo_core import FileError, Mesh, read, write

FILES = Path(os.environ.get("AGGLO_MESH_FILES", Path(__file__).parents[3] / "shared/data/meshes"))
pytestmark = pytest.mark.skipif(not FILES.exists(), reason=f"no meshes at {FILES} (set AGGLO_MESH_FILES)")


def polygon_areas(points: Any, loops: list[Any]) -> list[float]:
    """Areas by the shoelace formula, from the first corner."""
    areas = []
    for loop in loops:
        x, y = (points[loop] - points[loop[0]]).T
        areas.append(0.5 * abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())))
    return areas


def pairs_of_neighbours(loops: list[Any]) -> set[tuple[int, int]]:
    """Pairs of cells with an edge in common, edge by edge."""
    seen: dict[tuple[int, int], int] = {}
    pairs = set()
    for c, loop in enumerate(loops):
        for a, b in zip(loop, np.roll(loop, -1), strict=True):
            key = (int(min(a, b)), int(max(a, b)))
            if key in seen:
                pairs.add((seen[key], c))
            seen[key] = c
    return pairs


def inner_pairs(mesh: Mesh) -> set[tuple[int, int]]:
    cells = mesh.face_cells[mesh.face_cells[:, 1] >= 0]
    return {(int(min(pair)), int(max(pair))) for pair in cells}


def check_plane(mesh: Mesh, points: Any, loops: list[Any]) -> None:
    assert mesh.n_cells == len(loops)
    np.testing.assert_allclose(mesh.cell_measures, polygon_areas(points, loops), rtol=1e-9)
    assert inner_pairs(mesh) == pairs_of_neighbours(loops)


def check_solid(mesh: Mesh, points: Any, cells: list[list[list[int]]], *, warped: bool = False) -> None:
    """Volumes from tetrahedra between the middle of a cell and its edges, neighbours by sets of points."""
    assert mesh.n_cells == len(cells)
    volumes: list[float] = []
    seen: dict[frozenset[int], int] = {}
    pairs = set()
    for c, faces in enumerate(cells):
        middle = points[sorted({v for face in faces for v in face})].mean(axis=0)
        volume = 0.0
        for face in faces:
            corners = points[face] - middle
            centre = corners.mean(axis=0)
            edges = zip(corners, np.roll(corners, -1, axis=0), strict=True)
            volume += sum(abs(np.linalg.det([centre, a, b])) for a, b in edges) / 6
            other = seen.setdefault(frozenset(face), c)
            if other != c:
                pairs.add((other, c))
        volumes.append(volume)
    if warped:  # what a face that is not flat bounds is a matter of definition
        assert mesh.cell_measures.sum() == pytest.approx(sum(volumes), rel=0.02)
    else:
        np.testing.assert_allclose(mesh.cell_measures, volumes, rtol=1e-6)
    assert inner_pairs(mesh) == pairs


@pytest.mark.parametrize("name", ["hexa1_2", "mesh1_3", "mesh3_3", "mesh4_1_2", "non_conforming_3"])
def test_typ2(name: str) -> None:
    file = FILES / f"hardcore2d_{name}.typ2"
    lines = file.read_text().split("\n")
    n = int(lines[1])
    points = np.array([line.split() for line in lines[2 : 2 + n]], float)
    count = int(lines[3 + n])
    loops = [np.array(line.split()[1:], int) - 1 for line in lines[4 + n : 4 + n + count]]
    check_plane(read(file), points, loops)


@pytest.mark.parametrize(
    "name", ["AcousticCavity_4287_el", "DataTestDCLap_250_el", "MeshEmilia", "UnitSquare_300_el"]
)
def test_lymph(name: str) -> None:
    file = FILES / f"lymph_{name}.mat"
    found = loadmat(file, simplify_cells=True)
    region, neighbour = found["region"], found["neighbor"]["neigh"]
    mesh = read(file)
    check_plane(mesh, region["coord"], [loop.astype(int) - 1 for loop in region["connectivity"]])
    np.testing.assert_allclose(mesh.cell_measures, region["area"], rtol=1e-6)
    pairs = {
        (min(c, d - 1), max(c, d - 1)) for c, own in enumerate(neighbour) for d in own.astype(int) if d > 0
    }
    assert inner_pairs(mesh) == pairs
    assert mesh.cell_tags["id"].tolist() == region["id"].tolist()
    values, counts = np.unique(mesh.face_tags["bc_tag"][mesh.face_cells[:, 1] < 0], return_counts=True)
    expected = np.unique(region["bc_tag"], return_counts=True)
    assert (values.tolist(), counts.tolist()) == (expected[0].tolist(), expected[1].tolist())


@pytest.mark.parametrize("name", ["meshLake", "meshdata_nonconvex3"])
def test_mvem(name: str) -> None:
    file = FILES / f"mvem_{name}.mat"
    found = loadmat(file, simplify_cells=True)
    check_plane(read(file), found["node"], [np.asarray(loop).astype(int) - 1 for loop in found["elem"]])


def test_openfoam() -> None:
    """A cavity of 20 by 20 by 1 cubes, 0.1 by 0.1 by 0.01."""
    mesh = read(FILES / "foam_cavity" / "case.foam")
    assert (mesh.n_cells, mesh.n_faces, mesh.n_points) == (400, 1640, 882)
    np.testing.assert_allclose(mesh.cell_measures, 0.005 * 0.005 * 0.01, rtol=1e-9)
    grid = np.arange(400).reshape(20, 20)
    pairs = np.vstack(
        [np.c_[grid[:, :-1].ravel(), grid[:, 1:].ravel()], np.c_[grid[:-1].ravel(), grid[1:].ravel()]]
    )
    assert inner_pairs(mesh) == {(int(a), int(b)) for a, b in pairs}
    counts = {name: int((tag == 1).sum()) for name, tag in mesh.face_tags.items() if name != "patch"}
    assert counts == {"movingWall": 20, "fixedWalls": 60, "frontAndBack": 800}


@pytest.mark.parametrize("name", ["Tetgen-Cube-0_cube.4", "Voro-small-0_voro-4"])
def test_polyhedra_by_their_faces(name: str) -> None:
    lines = (FILES / f"hardcore3d_{name}.node").read_text().split("\n")[3:]
    points = np.array([line.split()[1:] for line in lines if line and line[0] != "#"], float)
    rows = [
        line.split()
        for line in (FILES / f"hardcore3d_{name}.ele").read_text().split("\n")
        if line[:1] not in ("#", "")
    ]
    cells: list[list[list[int]]] = []
    for row in rows[1:]:
        if len(row) == 2:
            cells.append([])
        else:
            cells[-1].append([int(word) for word in row[2:]])
    check_solid(read(FILES / f"hardcore3d_{name}.ele"), points, cells)


def test_obj() -> None:
    lines = (FILES / "cinolib_hele_shaw.obj").read_text().split("\n")
    points = np.array([line.split()[1:3] for line in lines if line.startswith("v ")], float)
    loops = [
        np.array([int(w.split("/")[0]) - 1 for w in line.split()[1:]])
        for line in lines
        if line.startswith("f ")
    ]
    check_plane(read(FILES / "cinolib_hele_shaw.obj"), points, loops)


def elements_of_gmsh(file: Path) -> tuple[int, int]:
    """The highest dimension of elements in a text file of Gmsh, and how many have it."""
    lines = file.read_text().split("$Elements\n")[1].split("$EndElements")[0].strip().split("\n")
    counts: dict[int, int] = {}
    if file.read_text().split("\n")[1].startswith("4"):
        place = 1
        while place < len(lines):
            dim, _, _, n = map(int, lines[place].split())
            counts[dim] = counts.get(dim, 0) + n
            place += n + 1
    else:
        dims = {1: 1, 2: 2, 3: 2, 4: 3, 5: 3, 6: 3, 7: 3, 8: 1, 9: 2, 10: 2, 11: 3, 15: 0}
        for line in lines[1:]:
            dim = dims[int(line.split()[1])]
            counts[dim] = counts.get(dim, 0) + 1
    return max(counts), counts[max(counts)]


@pytest.mark.parametrize("file", sorted(FILES.glob("*.msh")), ids=lambda file: file.stem)
def test_gmsh(file: Path) -> None:
    mesh = read(file)
    assert (mesh.dim, mesh.n_cells) == elements_of_gmsh(file)
    names = [line.split('"')[1] for line in file.read_text().split("\n") if line.count('"') == 2]
    assert set(names) <= {*mesh.cell_tags, *mesh.face_tags}


def check_by_vtk(mesh: Mesh, grid: Any) -> None:
    """Measures and neighbours from what VTK finds of each cell: its points in the plane, else its faces."""
    number = np.unique(grid.points, axis=0, return_inverse=True)[1].ravel()
    points = np.zeros((number.max() + 1, 3))
    points[number] = grid.points
    corners = {5: 3, 7: 99, 9: 4}  # of triangles, polygons, quadrilaterals; tetrahedra have faces of three
    cells = [grid.get_cell(i) for i in range(grid.n_cells)]
    cells = [cell for cell in cells if cell.dimension == mesh.dim]
    assert mesh.n_cells == len(cells)
    if mesh.dim == 2:
        loops = [number[cell.point_ids[: corners[int(cell.type)]]] for cell in cells]
        np.testing.assert_allclose(mesh.cell_measures, polygon_areas(points[:, :2], loops), rtol=1e-9)
        if "overlapping edges left apart" not in mesh.repairs:
            assert inner_pairs(mesh) == pairs_of_neighbours(loops)
        return
    few = {24: 3}  # corners of the faces of quadratic tetrahedra
    solids = [
        [number[face.point_ids[: few.get(int(cell.type), 99)]].tolist() for face in cell.faces]
        for cell in cells
    ]
    check_solid(mesh, points, solids, warped=mesh.name == "vtkdata_can")


GRIDS = [file for pattern in ("*.v*", "*.msh") for file in sorted(FILES.glob(pattern))]


@pytest.mark.slow
@pytest.mark.parametrize("file", GRIDS, ids=lambda file: file.name)
def test_vtk_finds_the_same(file: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    if file.suffix == ".msh":
        meshio = pytest.importorskip("meshio")
        if file.stem.startswith("hardcore3d"):
            pytest.skip("meshio cannot read its groups")
        check_by_vtk(read(file), pyvista.from_meshio(meshio.read(file)))
    else:
        check_by_vtk(read(file), pyvista.read(file))


BACK = ("lymph_MeshEmilia.mat", "hardcore3d_Voro-small-0_voro-4.ele", "foam_cavity/case.foam")


@pytest.mark.parametrize("suffix", [".npz", ".vtu", ".vtkhdf"])
@pytest.mark.parametrize("name", BACK)
def test_real_files_survive_writing_and_reading(name: str, suffix: str, tmp_path: Path) -> None:
    """Where nothing is lost to the last bit, else points and cells."""
    if suffix == ".vtkhdf":
        pytest.importorskip("h5py")
    mesh = read(FILES / name)
    write(tmp_path / f"m{suffix}", mesh)
    back = read(tmp_path / f"m{suffix}")
    if suffix == ".npz":
        for array in ("points", "face_offsets", "face_vertices", "face_cells"):
            assert np.array_equal(getattr(mesh, array), getattr(back, array))
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    assert inner_pairs(back) == inner_pairs(mesh)
    assert back.cell_tags.keys() == mesh.cell_tags.keys()
    for tag, values in mesh.face_tags.items():
        assert np.bincount(back.face_tags[tag] + 1).tolist() == np.bincount(values + 1).tolist()


def test_every_other_file_is_read_or_refused_for_what_it_is() -> None:
    for file in sorted(FILES.rglob("*")):
        if file.is_file() and file.suffix in (".shp", ".dbf", ".html", ".prj", ".cpg", ".shx"):
            with pytest.raises(FileError, match="unknown suffix"):
                read(file)
        elif file.is_file() and file.suffix not in (".msh", ".vtk"):  # read above, in a process for each
            assert read(file).n_cells > 0
