"""MATLAB's .mat: what scipy writes is read, what is written scipy reads; lymph, mVEM, PolyMesher."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from agglo_core import FileError, Hierarchy, MeshError, agglomerate, read, read_hierarchy, samples, write
from agglo_core.io.matlab import mat5
from agglo_core.io.matlab.mat5 import variables

POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], float)
CUBES = [  # two unit cubes side by side, one face of each turned inward
    [[1, 4, 10, 7], [0, 6, 9, 3], [0, 1, 7, 6], [3, 9, 10, 4], [0, 3, 4, 1], [6, 7, 10, 9]],
    [[1, 4, 10, 7], [2, 5, 11, 8], [1, 2, 8, 7], [4, 10, 11, 5], [1, 4, 5, 2], [7, 8, 11, 10]],
]
IN_SPACE = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)], float)


def cell(rows: list[Any], column: bool = True) -> Any:
    """A cell array."""
    array = np.empty((len(rows), 1) if column else (1, len(rows)), object)
    for place, row in enumerate(rows):
        array.ravel()[place] = row
    return array


def put(folder: Path, compress: bool = False, **given: Any) -> Path:
    savemat(folder / "m.mat", given, do_compression=compress)
    return folder / "m.mat"


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("kind", ["u1", "i2", "u2", "i4", "f4", "f8", "i8"])
def test_cells_in_a_cell_array(tmp_path: Path, kind: str, compress: bool) -> None:
    elem = cell([np.array([[1, 2, 3, 4]], kind), np.array([[2], [5], [6], [3]], kind)])
    mesh = read(put(tmp_path, compress, node=POINTS, elem=elem, mat=[7, -8], nx=2.5))
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.points.tolist() == POINTS.tolist()
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"mat": [7, -8]}


@pytest.mark.parametrize("missing", [np.nan, 0])
@pytest.mark.parametrize("names", [("node", "elem"), ("Node", "Element")])
def test_cells_in_rows(tmp_path: Path, missing: float, names: tuple[str, str]) -> None:
    rows = [[1, 2, 3, missing], [2, 5, 6, 3]]
    assert read(put(tmp_path, **dict(zip(names, (POINTS, rows), strict=True)))).cell_measures.tolist() == [
        0.5,
        1,
    ]


@pytest.mark.parametrize("names", [("node3", "elem3"), ("node", "elem")])
def test_solids(tmp_path: Path, names: tuple[str, str]) -> None:
    solids = cell([cell([np.array([face]) + 1 for face in faces]) for faces in CUBES])
    mesh = read(put(tmp_path, **dict(zip(names, (IN_SPACE, solids), strict=True))))
    np.testing.assert_allclose(mesh.cell_measures, [1, 1])
    tetra = np.array([[1, 2, 4, 7], [2, 5, 4, 8]])
    np.testing.assert_allclose(read(put(tmp_path, node=IN_SPACE, elem=tetra)).cell_measures, [1 / 6, 1 / 6])


def test_the_struct_of_lymph(tmp_path: Path) -> None:
    region = {
        "ne": 2,
        "coord": POINTS,
        "connectivity": cell([np.array([[1, 2, 3, 4]], np.uint8), np.array([[2, 5, 6, 3]], np.uint8)], False),
        "id": np.array([[3], [9]]),
        "connectivity_bc": np.array([[2, 1], [5, 6], [2, 3]]),
        "bc_tag": [[4, 5, 6]],
        "label": "P",
    }
    mesh = read(put(tmp_path, region=region, neighbor={"nedges": [4, 4]}))
    assert mesh.cell_tags["id"].tolist() == [3, 9]
    tag = mesh.face_tags["bc_tag"]
    middles = mesh.points[mesh.face_pairs].mean(axis=1)
    assert middles[tag == 4].tolist() == [[0.5, 0]]
    assert middles[tag == 5].tolist() == [[2, 0.5]]
    assert (tag == 6).sum() == 0  # an inner edge
    assert (tag == -1).sum() == mesh.n_faces - 2


def test_coarse_cells_of_several_materials_have_no_id(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A wrong id would be a wrong material in lymph."""
    mesh = samples.squares(4).with_tags(id=[7, 7, 8, 8] * 4)
    halves = [np.tile(columns, 4) for columns in ([0, 0, 1, 1], [0, 1, 1, 1])]
    for place, (labels, ids) in enumerate(zip(halves, ([7, 8], None), strict=True)):
        with caplog.at_level("INFO", "agglo"):
            write(tmp_path / f"{place}.mat", mesh, Hierarchy(mesh, mesh.graph, [labels], [{}], True))
        region = loadmat(tmp_path / f"{place}_level0.mat")["region"][0, 0]
        assert ("id" in region.dtype.names) == (ids is not None)
        assert ids is None or region["id"].ravel().tolist() == ids
    assert [record.getMessage() for record in caplog.records] == [
        "the mesh of level 0 has no id: values vary within agglomerates, unless regions keep them apart"
    ]


def test_real_values_per_cell_are_counted(tmp_path: Path) -> None:
    rows = [[1, 2, 3, 4], [2, 5, 6, 3]]
    mesh = read(put(tmp_path, node=POINTS, elem=rows, kappa=[[0.5], [2.0]], rock=[[1], [2]]))
    assert list(mesh.cell_tags) == ["rock"]
    assert dict(mesh.repairs)["cell data that are not integers left out"] == 1


@pytest.mark.parametrize("place", ["variable", "field"])
def test_numbers_that_are_no_tags_are_noted(
    tmp_path: Path, place: str, caplog: pytest.LogCaptureFixture
) -> None:
    data = {
        "rock": [[1], [2]],
        "kappa": [[0.5], [2.0]],  # one real number per cell
        "tensor": [[1.0, 0.5], [0.5, 2.0]],
        "at_points": [[0.5, 1, 2, 3, 4, 5]],
        "degree": 2.5,  # no data of the mesh
        "author": "P",
    }
    lists = cell([np.array([[1, 2, 3, 4]], np.uint8), np.array([[2, 5, 6, 3]], np.uint8)], False)
    region = {"coord": POINTS, "connectivity": lists, "max_kb": cell([[[1.0, 2.0]]]), "area": [1.5, 1.5]}
    given = {"region": region, **data} if place == "variable" else {"region": {**region, **data}}
    with caplog.at_level("INFO", "agglo"):
        mesh = read(put(tmp_path, **given))
    assert {name: values.tolist() for name, values in mesh.cell_tags.items()} == {"rock": [1, 2]}
    assert dict(mesh.repairs) == {"cell data that are not integers left out": 3}
    prefix = "" if place == "variable" else "region."
    (note,) = (record.getMessage() for record in caplog.records)
    assert set(note.partition(": ")[2].split(", ")) == {
        prefix + name for name in ("kappa", "tensor", "at_points")
    }


@pytest.mark.parametrize("compress", [False, True])
def test_what_is_written_scipy_reads(tmp_path: Path, compress: bool) -> None:
    mesh = samples.voronoi(60, seed=2)
    tags = {"mat": np.arange(60) % 4, "region": np.arange(60), "a b": np.arange(60) + 2**60}
    mesh = replace(mesh, cell_tags=tags, face_tags={"bc_tag": np.where(mesh.face_cells[:, 1] < 0, 3, -1)})
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(12, 3))
    write(tmp_path / "m.mat", mesh, hierarchy, compress=compress)
    found = loadmat(tmp_path / "m.mat", simplify_cells=True)
    assert np.array_equal(found["node"], mesh.points)
    region, neighbor = found["region"], found["neighbor"]
    np.testing.assert_array_equal(found["level_0"], hierarchy.levels[0] + 1)
    assert region["ne"] == 60
    for c, loop in enumerate(found["elem"]):
        assert np.array_equal(region["connectivity"][c], loop)
        assert np.array_equal(region["coords_element"][c], mesh.points[loop - 1])
        assert (
            region["BBox"][c].tolist()
            == np.array([mesh.points[loop - 1].min(0), mesh.points[loop - 1].max(0)]).T.ravel().tolist()
        )
        for j, (other, edge) in enumerate(zip(neighbor["neigh"][c], neighbor["neighedges"][c], strict=True)):
            ends = {loop[j], loop[(j + 1) % len(loop)]}
            if other < 0:
                assert sorted(ends) in np.sort(region["connectivity_bc"], axis=1).tolist()
                assert edge == -1
            else:
                back = found["elem"][other - 1]
                assert {back[edge - 1], back[edge % len(back)]} == ends
                assert neighbor["neigh"][other - 1][edge - 1] == c + 1
    np.testing.assert_allclose(region["area"], mesh.cell_measures)
    assert set(region["bc_tag"].tolist()) == {3}
    back, levels = read_hierarchy(tmp_path / "m.mat")
    assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {
        name: tag.tolist() for name, tag in tags.items()
    }
    assert levels is not None
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert np.array_equal(back.points, mesh.points)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() == 0
    assert (back.face_tags["bc_tag"] == 3).sum() == (mesh.face_tags["bc_tag"] == 3).sum()
    assert read(tmp_path / "m_level0.mat").n_cells == 12


def test_solids_are_written_as_scipy_reads_them(tmp_path: Path) -> None:
    mesh = samples.boxes(3).coarsen(np.arange(27) // 2)
    write(tmp_path / "m.mat", mesh)
    found = loadmat(tmp_path / "m.mat", simplify_cells=True)
    cells = [[np.asarray(face) - 1 for face in faces] for faces in found["elem3"]]
    again = type(mesh).from_polyhedra(found["node3"], cells)
    back = read(tmp_path / "m.mat")
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-14)
    np.testing.assert_allclose(again.cell_measures, mesh.cell_measures, rtol=1e-14)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-14


def test_big_endian_files_are_read(tmp_path: Path) -> None:
    def matrix(name: bytes, rows: np.ndarray[Any, Any]) -> bytes:
        data = rows.astype(">f8").tobytes("F")
        body = struct.pack(">IIIIIIii", 6, 8, 6, 0, 5, 8, *rows.shape)
        body += (
            struct.pack(">HH4s", len(name), 1, name.ljust(4, b"\0")) + struct.pack(">II", 9, len(data)) + data
        )
        return struct.pack(">II", 14, len(body)) + body

    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    rows = np.array([[1, 2, 3, 4], [2, 5, 6, 3]], float)
    (tmp_path / "m.mat").write_bytes(head + matrix(b"node", POINTS) + matrix(b"elem", rows))
    assert read(tmp_path / "m.mat").cell_measures.tolist() == [1, 1]
    assert loadmat(tmp_path / "m.mat")["elem"].tolist() == rows.tolist()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"a": [1.0]}, r"variables a; expected region \(lymph\), node and elem.* to Mesh\.from_polygons"),
        (
            {"node": POINTS, "elem": [[1, 2, 9]]},
            r"elem: list 0 \(counted from 0\) uses point 9, expected 1 to 6",
        ),
        ({"node": POINTS, "elem": [[1, 2, 2.5]]}, "elem holds 2.5, expected whole numbers"),
        ({"node": POINTS, "elem": [[1, np.nan, 2, 3]]}, "elem: a row has a number after a missing one"),
        ({"node": POINTS, "elem": cell(["abc"])}, "cell 0 is not a list of numbers|uses point|fewer than 3"),
        ({"node": POINTS.T, "elem": [[1, 2, 3]]}, r"node has the shape \(2, 6\), expected 2 or 3 columns"),
        ({"node": POINTS * 1j, "elem": [[1, 2, 3]]}, "node holds complex numbers"),
        ({"node": IN_SPACE, "elem": [[1, 2, 3]]}, r"elem has rows of 3, expected 4 \(tetrahedra\)"),
        ({"region": {"coord": POINTS}}, "region has no field 'connectivity'; it has coord"),
        ({"region": 3.0}, "region is not a single struct"),
        (
            {"region": {"coord": POINTS, "connectivity": cell([[[1, 2, 3, 4]]]), "id": [1, 2, 3]}},
            "region.id has 3 values, expected one for each of 1 cells",
        ),
    ],
)
def test_faults_are_named(tmp_path: Path, given: dict[str, Any], says: str) -> None:
    with pytest.raises((FileError, ValueError), match=f"m.mat: .*({says})"):
        read(put(tmp_path, **given))


def test_other_versions_are_named(tmp_path: Path) -> None:
    (tmp_path / "m.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(600))
    with pytest.raises(FileError, match=r"saved by MATLAB with -v7\.3, which is HDF5; save it with -v7"):
        read(tmp_path / "m.mat")
    savemat(tmp_path / "m.mat", {"node": POINTS}, format="4")
    with pytest.raises(FileError, match="not a MATLAB level-5 file"):
        read(tmp_path / "m.mat")


def test_content_is_recognised(tmp_path: Path) -> None:
    put(tmp_path, node=POINTS, elem=[[1, 2, 3]]).rename(tmp_path / "m.dat2")
    assert read(tmp_path / "m.dat2").n_cells == 1


def test_texts_and_empty_cells_are_skipped(tmp_path: Path) -> None:
    given = {
        "node": POINTS,
        "elem": [[1, 2, 3]],
        "word": "abc",
        "none": np.empty((0, 0)),
        "deep": cell([{"a": 1}]),
    }
    assert set(variables(put(tmp_path, **given).read_bytes())) == {"node", "elem", "none", "deep"}


def test_what_inflates_beyond_measure_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mat5, "_ROOM", 1 << 16)
    file = put(tmp_path, compress=True, node=np.zeros((30_000, 2)), elem=[[1, 2, 3]])
    with pytest.raises(FileError, match=r"a compressed variable of \d+ bytes declares a size of 4800\d\d"):
        read(file)


# -- MRST --------------------------------------------------------------------------------------


def grid(points: Any, faces: list[list[int]], neighbours: Any, **cells: Any) -> dict[str, Any]:
    """The structure G; nodes and cells from 1 on, 0 is outside."""
    starts = np.cumsum([1, *map(len, faces)])
    nodes = np.concatenate(faces)[:, None]
    return {
        "cells": {"num": int(np.max(neighbours)), **cells},
        "faces": {
            "num": len(faces),
            "nodePos": starts[:, None],
            "nodes": nodes,
            "neighbors": np.array(neighbours),
        },
        "nodes": {"num": len(points), "coords": np.array(points, float)},
        "griddim": len(points[0]),
        "type": cell(["byHand"]),
    }


SQUARES = grid(
    POINTS,
    [[2, 3], [1, 2], [3, 4], [4, 1], [2, 5], [6, 5], [6, 3]],
    [[1, 2], [1, 0], [1, 0], [1, 0], [2, 0], [0, 2], [2, 0]],  # the outside may come first
)


@pytest.mark.parametrize("compress", [False, True])
def test_grids_of_mrst(tmp_path: Path, compress: bool) -> None:
    mesh = read(put(tmp_path, compress, G=SQUARES, p=[[2], [5]], level_0=[[1], [2]]))
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.points.tolist() == POINTS.tolist()
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"p": [2, 5], "level_0": [0, 1]}
    assert mesh.face_cells.tolist() == [[0, 1], [0, -1], [0, -1], [0, -1], [1, -1], [1, -1], [1, -1]]


@pytest.mark.parametrize("make", [lambda: samples.voronoi(60, seed=4), lambda: samples.tetrahedra(2)])
def test_grids_are_written_as_mrst_has_them(tmp_path: Path, make: Any) -> None:
    mesh = make()
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=5)
    write(tmp_path / "m.mat", mesh, hierarchy)
    found = loadmat(tmp_path / "m.mat", simplify_cells=True)
    g = found["G"]
    assert (g["cells"]["num"], g["faces"]["num"], g["nodes"]["num"]) == (
        mesh.n_cells,
        mesh.n_faces,
        mesh.n_points,
    )
    for c in range(mesh.n_cells):
        own = g["cells"]["faces"][g["cells"]["facePos"][c] - 1 : g["cells"]["facePos"][c + 1] - 1]
        assert (g["faces"]["neighbors"][own - 1] == c + 1).any(axis=1).all()
        assert len(own) == (g["faces"]["neighbors"] == c + 1).sum()
    savemat(tmp_path / "g.mat", {"G": g, "level_0": found["level_0"][:, None]})
    back, levels = read_hierarchy(tmp_path / "g.mat")
    assert back.fingerprint == mesh.fingerprint
    assert levels is not None
    assert levels.levels[0].tolist() == hierarchy.levels[0].tolist()


@pytest.mark.parametrize(
    ("part", "field", "value", "says"),
    [
        ("faces", "nodes", np.arange(3)[:, None], "G.faces.nodePos must increase from 1 to 4"),
        ("faces", "neighbors", np.zeros((7, 2)), "has an invalid cell number"),
        ("faces", "neighbors", np.ones((6, 2)), r"has the shape \(6, 2\), expected \(7, 2\)"),
        ("faces", "neighbors", np.ones((7, 2)), "has cell 0 on both sides"),
        ("nodes", "coords", POINTS[:5], "G.faces.nodes uses points outside 1..5"),
        ("nodes", "coords", POINTS[:, :1], "expected 2 or 3 columns"),
        ("nodes", "coords", None, "G.nodes has no field 'coords'; it has num"),
    ],
)
def test_faults_of_grids_are_named(tmp_path: Path, part: str, field: str, value: Any, says: str) -> None:
    changed = {key: dict(each) if isinstance(each, dict) else each for key, each in SQUARES.items()}
    changed[part][field] = value
    if value is None:
        del changed[part][field]
    with pytest.raises((FileError, MeshError), match=f"m.mat: .*({says})"):
        read(put(tmp_path, G=changed))


def test_coarse_grids_of_mrst(tmp_path: Path) -> None:
    """Two by two blocks of four by four squares, by hand, and the rules of the structure on any mesh."""
    mesh = samples.squares(4)
    blocks = [0, 0, 1, 1, 0, 0, 1, 1, 2, 2, 3, 3, 2, 2, 3, 3]
    hierarchy = Hierarchy(mesh, mesh.graph, [mesh.check_labels(blocks)], [{"n_parts": 4}], nested=True)
    write(tmp_path / "m.mat", mesh, hierarchy)
    found = loadmat(tmp_path / "m.mat", simplify_cells=True)
    coarse = found["CG_0"]
    assert coarse["partition"].tolist() == [block + 1 for block in blocks]
    inner, outer = [[1, 2], [1, 3], [2, 4], [3, 4]], [[1, 0], [2, 0], [3, 0], [4, 0]]
    assert coarse["faces"]["neighbors"].tolist() == inner + outer
    assert coarse["cells"]["facePos"].tolist() == [1, 4, 7, 10, 13]
    assert coarse["cells"]["faces"].tolist() == [1, 2, 5, 1, 3, 6, 2, 4, 7, 3, 4, 8]
    sides = found["G"]["faces"]["neighbors"]
    position, fine = coarse["faces"]["connPos"] - 1, coarse["faces"]["fconn"] - 1
    assert np.diff(position).tolist() == [2, 2, 2, 2, 4, 4, 4, 4]
    labels = np.concatenate(([0], coarse["partition"]))  # 0 is outside
    for i, pair in enumerate(coarse["faces"]["neighbors"].tolist()):
        for face in fine[position[i] : position[i + 1]]:
            assert sorted(labels[sides[face]]) == sorted(pair)
