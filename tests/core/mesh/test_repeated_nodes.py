"""Elements and rings that repeat nodes, in files and lists, and cells that become flat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from vtu_by_hand import write_ascii

from agglo_core import Mesh, MeshError, OptionError, PluginError, read, samples, write
from agglo_core.mesh.elements import polyhedra_from_elements

CUBE = [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]
SQUARE = CUBE[:4]
SIMPLIFIED = "cells with repeated vertices simplified"

# VTK type and nodes of one element among the corners of a cube, its volume or area, its faces
ELEMENTS: dict[str, tuple[int, list[int], float, int]] = {
    "hexahedron as prism": (12, [0, 1, 3, 3, 4, 5, 7, 7], 1 / 2, 5),
    "hexahedron as prism, of LS-DYNA": (12, [0, 1, 3, 2, 4, 4, 6, 6], 1 / 2, 5),
    "hexahedron as pyramid": (12, [0, 1, 3, 2, 4, 4, 4, 4], 1 / 3, 5),
    "hexahedron as tetrahedron": (12, [0, 1, 2, 2, 4, 4, 4, 4], 1 / 6, 4),
    "hexahedron as tetrahedron, of LS-DYNA": (12, [0, 1, 2, 4, 4, 4, 4, 4], 1 / 6, 4),
    "quadratic hexahedron as prism": (25, [0, 1, 3, 3, 4, 5, 7, 7, *[0] * 12], 1 / 2, 5),
    "voxel as prism": (11, [0, 1, 2, 3, 4, 5, 4, 5], 1 / 2, 5),
    "prism as tetrahedron": (13, [0, 1, 2, 4, 4, 4], 1 / 6, 4),
    "pyramid as tetrahedron": (14, [0, 1, 2, 2, 4], 1 / 6, 4),
    "quadrilateral as triangle": (9, [0, 1, 3, 3], 1 / 2, 3),
    "pixel as triangle": (8, [0, 1, 0, 3], 1 / 2, 3),
    "closed and padded polygon": (7, [0, 1, 3, 2, 0, 0], 1, 4),
}


def pinched() -> tuple[list[list[float]], list[list[int]]]:
    """Two columns of three hexahedra with points of their own; one is flat, and its neighbour a wedge."""
    heights = [[0, 0, 0], [1, 1, 1], [1, 1, 1.5], [2, 2, 2.5]]  # of the interfaces, at x = 0, 1, 2
    points, cells = [], []
    for k in range(3):
        for i in range(2):
            cells.append(list(range(len(points), len(points) + 8)))
            for level in (k, k + 1):
                corners = ((i, 0), (i + 1, 0), (i + 1, 1), (i, 1))
                points += [[x, y, heights[level][x]] for x, y in corners]
    return points, cells


# --- elements -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ELEMENTS)
def test_degenerate_elements_of_vtu(name: str, tmp_path: Path) -> None:
    kind, nodes, measure, faces = ELEMENTS[name]
    points = CUBE if kind > 10 else SQUARE
    mesh = read(write_ascii(tmp_path / "one.vtu", points, [(kind, nodes)]))
    assert mesh.cell_measures == pytest.approx([measure])
    assert (mesh.n_cells, mesh.n_faces) == (1, faces)
    assert mesh.repairs[SIMPLIFIED] == 1


def test_a_degenerate_element_is_a_neighbour(tmp_path: Path) -> None:
    """Two prisms stored as hexahedra fill the cube, and have its diagonal in common."""
    cells = [(12, [0, 1, 3, 3, 4, 5, 7, 7]), (13, [0, 3, 2, 4, 7, 6])]
    mesh = read(write_ascii(tmp_path / "two.vtu", CUBE, cells))
    assert mesh.cell_measures == pytest.approx([0.5, 0.5])
    assert mesh.graph.interface == pytest.approx([np.sqrt(2)] * 2)


def test_boundary_triangles_stored_as_quadrilaterals_are_face_tags(tmp_path: Path) -> None:
    cells = [(12, [0, 1, 3, 3, 4, 5, 7, 7]), (9, [0, 1, 3, 3]), (9, [0, 1, 5, 4])]
    mesh = read(write_ascii(tmp_path / "one.vtu", CUBE, cells, {"side": [0, 7, 8]}))
    tagged = {int(mesh.face_tags["side"][f]): mesh.face_centroids[f].tolist() for f in range(mesh.n_faces)}
    assert tagged[7] == pytest.approx([2 / 3, 1 / 3, 0])
    assert tagged[8] == pytest.approx([0.5, 0, 0.5])
    assert mesh.repairs["lower-dimensional cells kept as face tags"] == 2


def test_gmsh_elements(tmp_path: Path) -> None:
    nodes = "\n".join(f"{i + 1} {x} {y} {z}" for i, (x, y, z) in enumerate(CUBE))
    cells = "1 5 2 1 1 1 2 4 4 5 6 8 8\n2 5 2 2 2 1 4 3 3 5 8 7 7"
    (tmp_path / "m.msh").write_text(
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n8\n{nodes}\n$EndNodes\n"
        f"$Elements\n2\n{cells}\n$EndElements\n"
    )
    mesh = read(tmp_path / "m.msh")
    assert mesh.cell_measures == pytest.approx([0.5, 0.5])
    assert mesh.graph.interface == pytest.approx([np.sqrt(2)] * 2)


def test_legacy_vtk(tmp_path: Path) -> None:
    points = "\n".join(" ".join(map(str, at)) for at in CUBE)
    (tmp_path / "m.vtk").write_text(
        "# vtk DataFile Version 2.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        f"POINTS 8 double\n{points}\nCELLS 1 9\n8 0 1 3 2 4 4 4 4\nCELL_TYPES 1\n12\n"
    )
    assert read(tmp_path / "m.vtk").cell_measures == pytest.approx([1 / 3])


# --- rings --------------------------------------------------------------------------------------------

TEXTS = {
    "m.off": "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 3 0\n4 0 3 2 2\n",
    "m.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 1\nf 1 4 3 3\n",
    "m.typ2": "Vertices\n4\n0 0\n1 0\n0 1\n1 1\ncells\n2\n4 1 2 4 1\n5 1 4 3 3 1\n",
    "m.typ1": "Vertices\n4\n0 0\n1 0\n0 1\n1 1\nquadrangles\n2\n1 2 4 4\n1 4 3 3\n",
    "m.ply": "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n"
    "property double z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 3 3\n4 0 3 2 0\n",
}


@pytest.mark.parametrize("name", [*TEXTS, "rows.mat", "lists.mat", "m.npz"])
def test_closed_and_padded_rings_of_files(name: str, tmp_path: Path) -> None:
    plane = np.array(SQUARE, float)[:, :2]
    lists = np.empty((2, 1), object)
    lists[:, 0] = [np.array([[1, 2, 4, 1]]), np.array([[1, 4, 3, 3, 1]])]
    if name in TEXTS:
        (tmp_path / name).write_text(TEXTS[name])
    elif name == "m.npz":
        np.savez(
            tmp_path / name, points=plane, cell_offsets=[0, 4, 9], cell_vertices=[0, 1, 3, 0, 0, 3, 2, 2, 0]
        )
    else:
        rows: Any = lists if name == "lists.mat" else np.array([[1.0, 2, 4, 4], [1, 4, 3, 3]])
        savemat(tmp_path / name, {"node": plane, "elem": rows})
    mesh = read(tmp_path / name)
    assert mesh.cell_measures == pytest.approx([0.5, 0.5])
    assert (mesh.n_faces, mesh.repairs[SIMPLIFIED]) == (5, 2)


def test_hexahedra_of_matlab(tmp_path: Path) -> None:
    savemat(
        tmp_path / "m.mat", {"node3": np.array(CUBE, float), "elem3": np.array([[1.0, 2, 4, 4, 5, 6, 8, 8]])}
    )
    assert read(tmp_path / "m.mat").cell_measures == pytest.approx([0.5])


def test_rings_of_lists() -> None:
    closed = Mesh.from_polygons([[0, 0], [2, 0], [2, 2], [0, 2]], [[0, 1, 2, 3, 0]])
    assert (closed.cell_measures.tolist(), closed.n_faces, dict(closed.repairs)) == ([4], 4, {SIMPLIFIED: 1})
    padded = Mesh.from_polygons([[0, 0], [2, 0], [2, 2], [0, 2]], np.array([[0, 1, 2, 2], [0, 2, 3, 3]]))
    assert (padded.cell_measures.tolist(), padded.n_faces) == ([2, 2], 5)


def test_faces_of_polyhedra_may_be_closed_rings() -> None:
    cube = polyhedra_from_elements({"hexahedron": [[0, 1, 3, 2, 4, 5, 7, 6]]}).vertices.reshape(6, 4)
    mesh = Mesh.from_polyhedra(CUBE, [[[*face, face[0]] for face in cube.tolist()]])
    assert (mesh.cell_measures.tolist(), mesh.n_faces) == ([1.0], 6)


def test_a_vertex_that_returns_later_is_still_an_error() -> None:
    with pytest.raises(MeshError, match="cell 0: a repeated vertex"):
        Mesh.from_polygons([[0, 0], [2, 0], [1, 1], [2, 2], [0, 2]], [[0, 1, 2, 3, 4, 2, 2]])
    with pytest.raises(MeshError, match="cell 0: a face with a repeated vertex"):
        Mesh.from_polyhedra(CUBE, [[[0, 1, 3, 3, 2, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6]]])


# --- flat cells ---------------------------------------------------------------------------------------


def test_pinched_cells_of_corner_point_grids(tmp_path: Path) -> None:
    points, cells = pinched()
    file = write_ascii(
        tmp_path / "m.vtu", points, [(12, cell) for cell in cells], {"rock": [1, 2, 3, 4, 5, 6]}
    )
    with pytest.raises(MeshError, match=r"m\.vtu: cell 2: zero volume; drop_flat=True leaves such cells out"):
        read(file)
    mesh = read(file, drop_flat=True)
    assert mesh.cell_measures == pytest.approx([1, 1, 0.25, 1, 1])
    assert mesh.cell_tags["rock"].tolist() == [1, 2, 4, 5, 6]
    assert mesh.repairs["cells without volume dropped"] == 1
    # the cells above and below the flat one are neighbours now
    pairs = {tuple(sorted(pair)) for pair in mesh.face_cells.tolist() if -1 not in pair}
    assert pairs == {(0, 1), (0, 3), (1, 2), (2, 4), (3, 4)}


def test_flat_polygons_may_be_dropped() -> None:
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 2], [5, 5]]
    loops = [[0, 1, 1, 0], [0, 1, 2], [0, 2, 4], [0, 2, 3], [5, 5, 5]]
    with pytest.raises(MeshError, match="cells 0, 4: zero area; drop_flat=True leaves such cells out"):
        Mesh.from_polygons(points, loops)
    with pytest.raises(MeshError, match="cell 2: zero area"):
        Mesh.from_polygons(points, [loops[1]] * 2 + [loops[2]])
    mesh = Mesh.from_polygons(points, loops, cell_tags={"id": np.arange(5)}, drop_flat=True)
    assert mesh.cell_measures.tolist() == [0.5, 0.5]
    assert mesh.cell_tags["id"].tolist() == [1, 3]
    assert mesh.n_points == 4
    assert dict(mesh.repairs) == {SIMPLIFIED: 2, "cells without area dropped": 3, "orphan points dropped": 2}


def test_messages_name_the_cells_that_were_given() -> None:
    """Cells left out before do not shift the numbers."""
    flat = [0, 1, 1, 0]
    with pytest.raises(MeshError, match="cells 1 and 2 are duplicates"):
        Mesh.from_polygons(np.array(SQUARE)[:, :2], [flat, [0, 1, 3], [0, 1, 3]], drop_flat=True)
    tetrahedra = polyhedra_from_elements({"tetra": [[0, 1, 2, 2], [0, 1, 2, 4], [0, 1, 2, 5]]})
    with pytest.raises(MeshError, match="cells 1 and 2 overlap"):
        Mesh.from_polyhedra(CUBE, tetrahedra, drop_flat=True)


def test_a_mesh_of_flat_cells_is_empty() -> None:
    with pytest.raises(MeshError, match="the mesh is empty: all 1 cells have zero area"):
        Mesh.from_polygons([[0, 0], [1, 1], [2, 2]], [[0, 1, 2]], drop_flat=True)
    with pytest.raises(MeshError, match="the mesh is empty: all 1 cells have zero volume"):
        Mesh.from_polyhedra(
            np.multiply(CUBE, [1, 1, 0]), polyhedra_from_elements({"tetra": [[0, 1, 2, 3]]}), drop_flat=True
        )


def test_tags_have_a_value_for_each_cell_given() -> None:
    loops = [[0, 1, 2], [0, 1, 1]]
    with pytest.raises(MeshError, match=r"cell tag 'a' has shape \(1,\), expected \(2,\)"):
        Mesh.from_polygons([[0, 0], [1, 0], [1, 1]], loops, cell_tags={"a": [1]}, drop_flat=True)


def test_formats_face_by_face_refuse_the_option(tmp_path: Path) -> None:
    write(tmp_path / "m.foam", samples.boxes(2))
    with pytest.raises((OptionError, PluginError), match="no option 'drop_flat'"):
        read(tmp_path / "m.foam", drop_flat=True)
