"""Which cells a VTU file holds as VTK's own: types and corner orders, by VTK's documentation of each."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vtu_by_hand import arrays_of

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.io.vtk.cells import cells_of
from agglo_core.mesh.elements import polyhedra_from_elements

Points = NDArray[np.float64]

# Corners as VTK documents them: the base of a wedge looks outward, all others towards the rest of the cell.
TETRA = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
HEXAHEDRON = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
WEDGE = [[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1]]
PYRAMID = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]]

# Per type: corners, volume, the faces in any order and sense, tetrahedra that fill it.
SOLIDS: dict[int, tuple[list[list[float]], float, str, list[str]]] = {
    10: (TETRA, 1 / 6, "012 013 123 023", ["0123"]),
    12: (
        HEXAHEDRON,
        1.0,
        "0123 4567 0154 1265 2376 3047",
        ["0126", "0236", "0376", "0746", "0456", "0516"],
    ),
    13: (WEDGE, 0.5, "012 345 0143 1254 2035", ["0213", "2135", "1354"]),
    14: (PYRAMID, 1 / 3, "0123 014 124 234 304", ["0124", "0234"]),
}


def volumes(kind: int, corners: Points) -> list[float]:
    """Signed volumes of tetrahedra that fill a convex cell of VTK's, ``corners (k, 3)`` in its order."""
    tetrahedra = SOLIDS[kind][3]
    return [
        float(np.linalg.det(corners[[int(v) for v in tetra[1:]]] - corners[int(tetra[0])])) / 6
        for tetra in tetrahedra
    ]


def shuffled(kind: int, rng: np.random.Generator) -> tuple[Points, list[list[int]], float]:
    """An affine image of the element whose points, faces and starts of faces come in any order."""
    points, volume, faces, _ = SOLIDS[kind]
    image = rng.normal(size=(3, 3)) + 3 * np.eye(3)
    number = rng.permutation(len(points))
    placed = np.empty((len(points), 3))
    placed[number] = np.asarray(points, float) @ image.T + rng.normal(size=3)
    loops = []
    for face in rng.permutation(faces.split()):
        loop = [int(number[int(v)]) for v in face]
        turn = int(rng.integers(len(loop)))
        loop = loop[turn:] + loop[:turn]
        loops.append(loop[::-1] if rng.random() < 0.5 else loop)
    return placed, loops, volume * abs(float(np.linalg.det(image)))


def corners_in(file: Path, cell: int) -> tuple[int, Points]:
    """Type and corners of a cell in a VTU file, read without our reader."""
    arrays = arrays_of(file)
    offsets = [0, *arrays["offsets"].tolist()]
    places = arrays["connectivity"][offsets[cell] : offsets[cell + 1]]
    return int(arrays["types"][cell]), arrays["Points"].reshape(-1, 3)[places]


@pytest.mark.parametrize("kind", SOLIDS)
def test_the_elements_of_the_test_are_those_of_vtk(kind: int) -> None:
    points, volume, _, _ = SOLIDS[kind]
    found = volumes(kind, np.asarray(points, float))
    assert min(found) > 0
    assert sum(found) == pytest.approx(volume)


@pytest.mark.parametrize("kind", SOLIDS)
def test_single_solids_are_written_as_what_they_are(kind: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(kind)
    for _ in range(12):
        points, loops, volume = shuffled(kind, rng)
        mesh = Mesh.from_polyhedra(points, [loops])
        agglo.write(tmp_path / "one.vtu", mesh)
        found, corners = corners_in(tmp_path / "one.vtu", 0)
        assert found == kind
        parts = volumes(kind, corners)
        assert min(parts) > 0
        assert sum(parts) == pytest.approx(volume)
        back = agglo.read(tmp_path / "one.vtu")
        assert back.cell_measures == pytest.approx(mesh.cell_measures)
        assert faces_of(back) == faces_of(mesh)
        assert back.repairs == {}


def faces_of(mesh: Mesh) -> list[tuple[list[int], list[list[float]]]]:
    """Cells and corner coordinates of every face, in an order that numbering does not change."""
    starts = itertools.pairwise(mesh.face_offsets.tolist())
    loops = [sorted(mesh.points[mesh.face_vertices[a:b]].tolist()) for a, b in starts]
    return sorted(zip(map(sorted, mesh.face_cells.tolist()), loops, strict=True))


def cluster() -> Mesh:
    """A cube with a pyramid on top, a wedge and a cut cube at its sides, and a tetrahedron on the wedge."""
    points = [*HEXAHEDRON, [0.5, 0.5, 2], [2, 0, 0], [2, 0, 1], [2, 1, 1.5]]
    points += [[-1, 0, 0], [-1, 1, 0], [-1, 1, 0.8], [-0.8, 1, 1], [-1, 0.8, 1], [-1, 0, 1]]
    elements = {"hexahedron": [range(8)], "pyramid": [[4, 5, 6, 7, 8]], "wedge": [[2, 9, 1, 6, 10, 5]]}
    solids = polyhedra_from_elements(elements | {"tetra": [[5, 10, 6, 11]]})
    cells = [
        [
            solids.vertices[solids.loop_offsets[f] : solids.loop_offsets[f + 1]].tolist()
            for f in range(solids.cell_offsets[c], solids.cell_offsets[c + 1])
        ]
        for c in range(4)
    ]
    cut = [[0, 3, 7, 4], [0, 12, 13, 3], [12, 0, 4, 17], [3, 13, 14, 15, 7], [12, 17, 16, 14, 13]]
    return Mesh.from_polyhedra(points, [*cells, [*cut, [4, 7, 15, 16, 17], [14, 16, 15]]])


def test_solids_of_all_kinds_in_one_file(tmp_path: Path) -> None:
    mesh = cluster()
    assert mesh.repairs == {}
    agglo.write(tmp_path / "c.vtu", mesh)
    arrays = arrays_of(tmp_path / "c.vtu")
    assert arrays["types"].tolist() == [12, 14, 13, 10, 42]
    assert arrays["faceoffsets"].tolist() == [-1] * 4 + [len(arrays["faces"])]
    assert arrays["faces"][0] == 7
    for cell, measure in enumerate(mesh.cell_measures[:4]):
        parts = volumes(*corners_in(tmp_path / "c.vtu", cell))
        assert min(parts) > 0
        assert sum(parts) == pytest.approx(measure)
    back = agglo.read(tmp_path / "c.vtu")
    assert back.cell_measures == pytest.approx(mesh.cell_measures, rel=1e-14)
    assert faces_of(back) == faces_of(mesh)
    assert back.repairs == {}


def test_a_mesh_without_polyhedra_has_no_face_stream(tmp_path: Path) -> None:
    agglo.write(tmp_path / "b.vtu", samples.boxes(2))
    assert not {"faces", "faceoffsets"} & set(arrays_of(tmp_path / "b.vtu"))


@pytest.mark.parametrize("mesh", [samples.boxes(3), samples.tetrahedra(2), cluster()], ids=repr)
def test_meshes_of_elements_come_back_to_the_last_bit(mesh: Mesh, tmp_path: Path) -> None:
    agglo.write(tmp_path / "m.vtu", mesh)
    assert agglo.read(tmp_path / "m.vtu", merge_points=False).fingerprint == mesh.fingerprint


DART = [[0, 0], [2, -1], [0.5, 0], [2, 1]]  # its third corner looks inward


def on_stilts(plane: list[list[float]]) -> Mesh:
    """The prism of height 1 over a quadrilateral."""
    points = [[x, y, z] for z in (0.0, 1.0) for x, y in plane]
    return Mesh.from_polyhedra(points, polyhedra_from_elements({"hexahedron": [range(8)]}))


@pytest.mark.parametrize(
    ("plane", "kind"),
    [
        ([[0, 0], [1, 0], [1, 1], [0, 1]], (9, 12)),
        ([[0, 0], [1, 0], [3, 2], [0, 1]], (9, 12)),
        (DART, (7, 42)),
        (DART[1:] + DART[:1], (7, 42)),
        ([[0, 0], [1, 0], [2, 0], [0, 1]], (7, 42)),  # a triangle with a vertex on a side
    ],
)
def test_quadrilaterals_must_be_convex(
    plane: list[list[float]], kind: tuple[int, int], tmp_path: Path
) -> None:
    for mesh, expected in zip((Mesh.from_polygons(plane, [range(4)]), on_stilts(plane)), kind, strict=True):
        agglo.write(tmp_path / "q.vtu", mesh)
        assert arrays_of(tmp_path / "q.vtu")["types"].tolist() == [expected]
        back = agglo.read(tmp_path / "q.vtu")
        assert back.cell_measures == pytest.approx(mesh.cell_measures)
        assert faces_of(back) == faces_of(mesh)


def test_far_from_the_origin_squares_are_still_convex() -> None:
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 1e-3 + 1e6
    assert cells_of(Mesh.from_polygons(square, [range(4)])).types.tolist() == [9]


def test_a_cube_with_a_face_in_two_is_a_polyhedron() -> None:
    _, _, faces, _ = SOLIDS[12]
    loops: list[Any] = [[int(v) for v in face] for face in faces.split()]
    split = Mesh.from_polyhedra(HEXAHEDRON, [[*loops[1:], [0, 1, 2], [0, 2, 3]]])
    assert cells_of(split).types.tolist() == [42]


def test_coarse_cells_are_recognised() -> None:
    """Four tetrahedra around a point make one; two triangles make a square; a square with a hole is none."""
    points = [*TETRA, [0.2, 0.2, 0.2]]
    inner = [[0, 1, 2, 4], [0, 3, 1, 4], [1, 3, 2, 4], [0, 2, 3, 4]]
    parted = Mesh.from_polyhedra(points, polyhedra_from_elements({"tetra": inner}))
    assert cells_of(parted.coarsen([0, 0, 0, 0])).types.tolist() == [10]
    square = Mesh.from_polygons([[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]])
    assert cells_of(square).types.tolist() == [5, 5]
    assert cells_of(square.coarsen([0, 0])).types.tolist() == [9]
    ring = samples.squares(3).coarsen([0, 0, 0, 0, 1, 0, 0, 0, 0])
    assert cells_of(ring).types.tolist() == [7, 9]
