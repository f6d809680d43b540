"""VTU: every coding, pieces, cell kinds, both polyhedron layouts; round trips; broken files."""

from __future__ import annotations

import base64
import lzma
import os
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from vtu_by_hand import replace_bytes

import agglo_core
from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import check_writable, read, read_hierarchy, write
from agglo_core.io.to_mesh.bridges import single_loops
from agglo_core.io.vtk import xml_write as vtu_document
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import polyhedra_from_elements

# -- meshes ------------------------------------------------------------------------------------


def squares(n: int, m: int | None = None) -> Mesh:
    """Grid of n by m unit squares, cell (i, j) has number j n + i."""
    m = n if m is None else m
    points = np.stack(np.meshgrid(np.arange(n + 1), np.arange(m + 1)), axis=-1).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(n), np.arange(m))
    corner = (j * (n + 1) + i).ravel()
    cells = np.stack((corner, corner + 1, corner + n + 2, corner + n + 1), axis=1)
    return Mesh.from_polygons(points, cells, name="squares")


def boxes(n: int) -> Mesh:
    """n x n x n unit cubes."""
    axis = np.arange(n + 1)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j, k = (part.ravel() for part in np.meshgrid(*[np.arange(n)] * 3, indexing="ij"))

    def at(a: int, b: int, c: int) -> NDArray[np.int64]:
        return np.asarray(((i + a) * (n + 1) + j + b) * (n + 1) + k + c)

    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = np.stack([at(*corner) for corner in corners], axis=1)
    return Mesh.from_polyhedra(points, polyhedra_from_elements({"hexahedron": cells}), name="boxes")


def contiguous(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(labels, return_inverse=True)[1]


def hierarchy_of(mesh: Mesh, *levels: NDArray[np.int64]) -> Hierarchy:
    targets = [{"parts": int(labels.max()) + 1} for labels in levels]
    return Hierarchy(mesh, mesh.graph, levels, targets, True, {"seconds": 0.5})


# -- files by hand -----------------------------------------------------------------------------

NAMES = {
    "i1": "Int8",
    "i4": "Int32",
    "i8": "Int64",
    "u1": "UInt8",
    "u8": "UInt64",
    "f4": "Float32",
    "f8": "Float64",
}


class Writer:
    """An independent, slow VTU writer with every coding the format knows."""

    def __init__(self, form: str = "ascii", packing: str = "", header: str = "u8", order: str = "<") -> None:
        self.form, self.packing, self.header, self.order = form, packing, header, order
        self.appended = b""

    def coded(self, values: NDArray[np.generic], *, raw: bool) -> bytes:
        content = values.astype(values.dtype.newbyteorder(self.order)).tobytes()
        code: Callable[[bytes], bytes] = (lambda data: data) if raw else base64.b64encode
        head = np.dtype(self.order + self.header)
        if not self.packing:
            return code(np.array([len(content)], head).tobytes() + content)
        pack = zlib.compress if self.packing == "zlib" else lzma.compress
        blocks = [pack(content[i : i + 16]) for i in range(0, len(content), 16)]
        sizes = [len(blocks), 16, len(content) % 16, *(len(block) for block in blocks)]
        return code(np.array(sizes, head).tobytes()) + code(b"".join(blocks))

    def array(self, name: str, values: object, dtype: str, components: int = 1) -> str:
        given = np.asarray(values, dtype).ravel()
        head = f'<DataArray type="{NAMES[dtype]}" Name="{name}" NumberOfComponents="{components}"'
        if self.form == "ascii":
            return f'{head} format="ascii">{" ".join(str(v) for v in given.tolist())}</DataArray>'
        if self.form == "binary":
            return f'{head} format="binary">\n {self.coded(given, raw=False).decode()}\n</DataArray>'
        offset = len(self.appended)
        self.appended += self.coded(given, raw=self.form == "raw")
        return f'{head} format="appended" offset="{offset}"/>'

    def piece(
        self, points: object, cells: list[tuple[int, list[int]]], extra: str = "", data: str = ""
    ) -> str:
        given = np.asarray(points, float).reshape(-1, 3)
        ends = np.cumsum([len(nodes) for _, nodes in cells])
        return (
            f'<Piece NumberOfPoints="{len(given)}" NumberOfCells="{len(cells)}"><Points>'
            + self.array("Points", given, "f8", 3)
            + "</Points><Cells>"
            + self.array("connectivity", [v for _, nodes in cells for v in nodes], "i4")
            + self.array("offsets", ends, "i8")
            + self.array("types", [kind for kind, _ in cells], "u1")
            + f"{extra}</Cells><CellData>{data}</CellData></Piece>"
        )

    def file(self, *pieces: str) -> bytes:
        order = "LittleEndian" if self.order == "<" else "BigEndian"
        packer = {
            "": "",
            "zlib": 'compressor="vtkZLibDataCompressor"',
            "lzma": 'compressor="vtkLZMADataCompressor"',
        }
        text = (
            f'<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="1.0" byte_order="{order}" '
            f'header_type="{"UInt64" if self.header == "u8" else "UInt32"}" {packer[self.packing]}>'
            f"<UnstructuredGrid>{''.join(pieces)}</UnstructuredGrid>"
        ).encode()
        if self.form in ("raw", "base64"):
            text += (
                f'<AppendedData encoding="{self.form}">\n  _'.encode() + self.appended + b"\n</AppendedData>"
            )
        return text + b"</VTKFile>"


SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]]


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("header", ["u4", "u8"])
@pytest.mark.parametrize("packing", ["", "zlib", "lzma"])
@pytest.mark.parametrize("form", ["ascii", "binary", "raw", "base64"])
def test_every_encoding_of_arrays_is_read(
    tmp_path: Path, form: str, packing: str, header: str, order: str
) -> None:
    w = Writer(form, packing, header, order)
    data = (
        w.array("mat", [7, -9], "i4") + w.array("heat", [0.5, 1], "f8") + w.array("pair", range(4), "i4", 2)
    )
    piece = w.piece(SQUARE, [(9, [0, 1, 2, 3]), (7, [1, 4, 5, 2])], data=data)
    file = tmp_path / "two.vtu"
    file.write_bytes(w.file(piece))
    mesh = read(file)
    assert mesh.name == "two"
    assert mesh.n_cells == 2
    assert mesh.n_faces == 7
    np.testing.assert_array_equal(mesh.cell_measures, [1, 1])
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"mat": [7, -9]}


def test_inline_header_coded_apart(tmp_path: Path) -> None:
    w = Writer("binary", header="u4")
    piece = w.piece(SQUARE[:4], [(9, [0, 1, 2, 3])])
    content = np.asarray(SQUARE[:4], "<f8").tobytes()
    joined = base64.b64encode(np.array([len(content)], "<u4").tobytes() + content).decode()
    apart = base64.b64encode(np.array([len(content)], "<u4").tobytes()) + base64.b64encode(content)
    file = tmp_path / "a.vtu"
    file.write_bytes(w.file(piece.replace(joined, apart.decode())))
    assert read(file).cell_measures.tolist() == [1]


def test_cell_kinds_2d(tmp_path: Path) -> None:
    w = Writer()
    points = [[x, y, 3] for y in range(3) for x in range(9)]  # 9 columns, spacing 1
    cells = [
        (8, [0, 2, 18, 20]),  # pixel
        (5, [2, 4, 20]),
        (22, [4, 22, 20, 13, 21, 12]),  # quadratic triangle
        (23, [4, 6, 24, 22, 5, 15, 23, 13]),  # quadratic quad
        (36, [6, 8, 26, 24, 7, 17, 25, 15]),  # quadratic polygon
        (3, [0, 2]),
        (1, [0]),
    ]
    file = tmp_path / "kinds.vtu"
    file.write_bytes(w.file(w.piece(points, cells, data=w.array("tag", [1, 2, 3, 4, 5, 66, 7], "i8"))))
    mesh = read(file)
    np.testing.assert_allclose(mesh.cell_measures, [4, 2, 2, 4, 4])
    assert mesh.cell_tags["tag"].tolist() == [1, 2, 3, 4, 5]
    assert sorted(mesh.face_tags["tag"].tolist())[-1] == 66
    assert (mesh.face_tags["tag"] >= 0).sum() == 1
    face = int(np.argmax(mesh.face_tags["tag"]))
    assert mesh.points[mesh.face_pairs[face]].tolist() == [[0, 0], [2, 0]]
    assert mesh.repairs["higher-order cells reduced to their corners"] == 3
    assert mesh.repairs["lower-dimensional cells dropped"] == 1
    assert mesh.repairs["lower-dimensional cells kept as face tags"] == 1


def prism(sides: int) -> list[list[float]]:
    """Corners of a regular prism of height 1, the lower end first."""
    angles = 2 * np.pi * np.arange(sides) / sides
    return [[np.cos(angle), np.sin(angle), z] for z in (0, 1) for angle in angles.tolist()]


ELEMENTS = {
    10: ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], 1 / 6),
    11: ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]], 1),
    12: ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], 1),
    13: ([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1]], 1 / 2),
    14: ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]], 1 / 3),
    15: (prism(5), 5 / 2 * np.sin(2 * np.pi / 5)),
    16: (prism(6), 3 * np.sin(np.pi / 3)),
    41: ([[0, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 0], [1, 0, 1], [1, 1, 0]], 1),
}


@pytest.mark.parametrize("kind", ELEMENTS)
def test_cell_kinds_3d(tmp_path: Path, kind: int) -> None:
    points, volume = ELEMENTS[kind]
    w = Writer()
    file = tmp_path / "one.vtu"
    file.write_bytes(w.file(w.piece(points, [(kind, list(range(len(points))))])))
    mesh = read(file)
    np.testing.assert_allclose(mesh.cell_measures, [volume], rtol=1e-14)
    assert mesh.repairs == {}


@pytest.mark.parametrize("kind", [15, 16, 41])
def test_prisms_and_point_sets_are_neighbours(tmp_path: Path, kind: int) -> None:
    """A second cell on top has the same face, whichever way it is made of triangles."""
    points, volume = ELEMENTS[kind]
    upper = [[x, y, 1 + z] for x, y, z in points]
    n, w = len(points), Writer()
    cells = [(kind, list(range(n))), (kind, list(range(n, 2 * n)))]
    file = tmp_path / "two.vtu"
    file.write_bytes(w.file(w.piece(points + upper, cells)))
    mesh = read(file)
    np.testing.assert_allclose(mesh.cell_measures, [volume] * 2, rtol=1e-14)
    np.testing.assert_allclose(mesh.graph.interface, [volume] * 2)
    assert mesh.n_faces == 2 * (8 if kind == 16 else 7 if kind == 15 else 6) - 1


def test_convex_point_sets(tmp_path: Path) -> None:
    """Points inside the hull are not used; points in a plane have none."""
    points, w = [*ELEMENTS[41][0], [0.5, 0.25, 0.5], [0.5, 0.5, 0]], Writer()
    file = tmp_path / "one.vtu"
    file.write_bytes(w.file(w.piece(points, [(41, list(range(10)))])))
    mesh = read(file)
    assert (mesh.n_points, mesh.n_faces) == (8, 6)
    np.testing.assert_allclose(mesh.cell_measures, [1])
    file.write_bytes(w.file(w.piece(points, [(12, [5, 1, 7, 2, 3, 6, 4, 0]), (41, [1, 2, 5, 7])])))
    with pytest.raises(FileError, match=r"cell 1 of VTK type 41 .*: its 4 points do not span a volume"):
        read(file)


@pytest.mark.parametrize("n", [3, 4, 5, 8, 9])
def test_triangle_strips_are_one_cell(tmp_path: Path, n: int) -> None:
    points, w = [[i / 2, i % 2, 0] for i in range(n)], Writer()
    file = tmp_path / "strip.vtu"
    file.write_bytes(w.file(w.piece(points, [(6, list(range(n)))], data=w.array("tag", [4], "i8"))))
    mesh = read(file)
    assert mesh.cell_measures == pytest.approx([(n - 2) / 2])
    assert (mesh.n_faces, mesh.cell_tags["tag"].tolist()) == (n, [4])


CUBE_FACES = [[3, 0, 4, 7], [1, 2, 6, 5], [0, 1, 5, 4], [2, 3, 7, 6], [3, 2, 1, 0], [4, 5, 6, 7]]


def polyhedra(w: Writer, layout: str) -> str:
    """A pyramid on a cube; the cube a polyhedron; between them in the list a quad (2-D)."""
    if layout == "stream":
        stream = [6, *(v for face in CUBE_FACES for v in (4, *face))]
        return w.array("faces", stream, "i8") + w.array("faceoffsets", [-1, -1, len(stream)], "i8")
    return (
        w.array("face_connectivity", CUBE_FACES, "i8")
        + w.array("face_offsets", range(4, 25, 4), "i8")
        + w.array("polyhedron_to_faces", range(6), "i8")
        + w.array("polyhedron_offsets", [0, 0, 6], "i8")
    )


@pytest.mark.parametrize("layout", ["stream", "csr"])
@pytest.mark.parametrize("form", ["ascii", "raw"])
def test_polyhedra_in_pieces(tmp_path: Path, layout: str, form: str) -> None:
    w, points = Writer(form), [*ELEMENTS[12][0], [0.5, 0.5, 4]]
    cells = [(14, [4, 5, 6, 7, 8]), (9, [0, 1, 2, 3]), (42, list(range(8)))]
    pieces = [
        w.piece(
            np.asarray(points) + np.array([shift, 0, 0]),
            cells,
            polyhedra(w, layout),
            w.array("mat", np.array([1, 5, 2]) + 10 * shift, "i4"),
        )
        for shift in (0, 1)
    ]
    empty = '<Piece NumberOfPoints="0" NumberOfCells="0"><Points/><Cells/></Piece>'
    file = tmp_path / "poly.vtu"
    file.write_bytes(w.file(pieces[0], empty, pieces[1]))
    mesh = read(file)
    np.testing.assert_allclose(mesh.cell_measures, [1, 1, 1, 1])
    assert mesh.cell_tags["mat"].tolist() == [1, 2, 11, 12]
    assert sorted(tag for tag in mesh.face_tags["mat"].tolist() if tag >= 0) == [5, 15]
    assert mesh.n_faces == 2 * 10 - 1  # the cubes share a face once equal points are merged
    assert read(file, merge_points=False).n_faces == 20


def test_ghost_cells_dropped(tmp_path: Path) -> None:
    w = Writer()
    cells = [(9, [0, 1, 2, 3]), (9, [1, 4, 5, 2])]
    data = w.array("vtkGhostType", [0, 1], "u1") + w.array("mat", [4, 5], "i4")
    file = tmp_path / "ghost.vtu"
    file.write_bytes(w.file(w.piece(SQUARE, cells, data=data)))
    mesh = read(file)
    assert mesh.n_cells == 1
    assert mesh.cell_tags["mat"].tolist() == [4]
    assert list(mesh.cell_tags) == ["mat"]
    assert mesh.repairs["ghost cells dropped"] == 1


# -- round trips -------------------------------------------------------------------------------


def test_hierarchy_round_trip(tmp_path: Path) -> None:
    mesh = squares(6)
    fine = contiguous((mesh.cell_centroids // 2) @ np.array([1, 3])).astype(np.int64)
    levels = hierarchy_of(mesh, fine, fine // 3)
    tagged = Mesh(mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells, {"a <b>&": fine % 2})
    write(tmp_path / "out.vtu", tagged, levels)
    assert sorted(os.listdir(tmp_path)) == ["out.vtu", "out_level0.vtu", "out_level1.vtu"]
    back, found = read_hierarchy(tmp_path / "out.vtu")
    np.testing.assert_array_equal(back.points, mesh.points)
    np.testing.assert_array_equal(back.cell_measures, mesh.cell_measures)
    assert list(back.cell_tags) == ["a <b>&"]
    assert back.cell_tags["a <b>&"].tolist() == (fine % 2).tolist()
    assert found is not None
    assert found.nested
    assert back.repairs == {}
    for labels, expected in zip(found.levels, levels.levels, strict=True):
        np.testing.assert_array_equal(labels, expected)
    assert sorted(read(tmp_path / "out.vtu").cell_tags) == ["a <b>&", "level_0", "level_1"]
    np.testing.assert_array_equal(read(tmp_path / "out_level1.vtu").cell_measures, [12, 12, 12])


def test_hole_is_bridged(tmp_path: Path) -> None:
    mesh = squares(5)
    ring = np.ones(25, np.int64)
    ring[[6, 7, 8, 11, 12, 13, 16, 17, 18]] = 0
    write(tmp_path / "ring.vtu", mesh.coarsen(ring))
    back = read(tmp_path / "ring.vtu")
    np.testing.assert_array_equal(back.cell_measures, [9, 16])
    assert back.n_faces == 12 + 20
    assert np.diff(back.boundary_loops.cell_offsets).tolist() == [1, 2]
    assert back.cell_tags == {}
    assert back.repairs == {}
    assert b'Name="agglo_loops"' in (tmp_path / "ring.vtu").read_bytes()


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 7), st.integers(2, 7), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_coarse_polygons_keep_their_areas(n: int, m: int, k: int, seed: int) -> None:
    """Random labels: holes, holes in holes, pinches, disconnected parts."""
    import tempfile

    mesh = squares(n, m)
    labels = contiguous(np.random.default_rng(seed).integers(0, k, mesh.n_cells))
    coarse = mesh.coarsen(labels)
    offsets, vertices, _ = single_loops(coarse)
    for c in range(coarse.n_cells):  # shoelace, one polygon at a time
        x, y = coarse.points[vertices[offsets[c] : offsets[c + 1]]].T
        area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
        assert area == pytest.approx(coarse.cell_measures[c], rel=1e-12)
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "c.vtu", coarse)
        back = read(Path(folder) / "c.vtu")
    np.testing.assert_allclose(back.cell_measures, coarse.cell_measures, rtol=1e-12)
    pairs, expected = (sorted(map(sorted, mesh.face_cells.tolist())) for mesh in (back, coarse))
    assert pairs == expected
    np.testing.assert_array_equal(
        np.diff(back.boundary_loops.cell_offsets), np.diff(coarse.boundary_loops.cell_offsets)
    )


def test_an_earlier_hierarchy_is_replaced_whole(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = squares(4)
    half, whole = np.repeat([0, 1], 8), np.zeros(16, np.int64)
    write(tmp_path / "o.vtu", mesh, hierarchy_of(mesh, np.arange(16), half, whole))
    for name in ("o_level7.vtu", "o_level.vtu", "o_level02.vtu", "other_level2.vtu", "o_level2.npz"):
        (tmp_path / name).write_text("mine")
    before = set(os.listdir(tmp_path))
    back = read(tmp_path / "o.vtu")
    assert sorted(back.cell_tags) == ["level_0", "level_1", "level_2"]
    write(tmp_path / "o.vtu", back)  # without a hierarchy, nothing is replaced
    assert set(os.listdir(tmp_path)) == before
    assert sorted(read(tmp_path / "o.vtu").cell_tags) == ["level_0", "level_1", "level_2"]
    with caplog.at_level("INFO", "agglo"):
        write(tmp_path / "o.vtu", back, hierarchy_of(back, half))
    assert "earlier hierarchy left out: level_0, level_1, level_2" in caplog.text
    assert before - set(os.listdir(tmp_path)) == {"o_level1.vtu", "o_level2.vtu"}
    assert read(tmp_path / "o.vtu").cell_tags.keys() == {"level_0"}
    assert read(tmp_path / "o_level0.vtu").cell_tags == {}
    found = agglo_core.read_hierarchy(tmp_path / "o.vtu")[1]
    assert found is not None
    assert [labels.tolist() for labels in found.levels] == [half.tolist()]


def test_levels_without_the_first_are_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = replace(squares(2), cell_tags={"level_1": np.zeros(4, np.int64)})
    write(tmp_path / "o.vtu", mesh)
    back, found = read_hierarchy(tmp_path / "o.vtu")
    assert found is None
    assert list(back.cell_tags) == ["level_1"]
    assert "level_1 not read as levels: there is no level_0" in caplog.text


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize(
    ("name", "match"), [("", "empty name"), ("agglo_loops", "reserved"), ("a\x01", "control characters")]
)
def test_names_that_files_cannot_hold_are_refused(tmp_path: Path, suffix: str, name: str, match: str) -> None:
    mesh = replace(squares(2), cell_tags={name: np.arange(4)})
    with pytest.raises(MeshError, match=rf"o\{suffix}: .*{match}"):
        write(tmp_path / f"o{suffix}", mesh)
    assert os.listdir(tmp_path) == []
    write(tmp_path / "o.npz", mesh)
    assert list(read(tmp_path / "o.npz").cell_tags) == [name]


def test_a_tag_named_loops_is_a_tag(tmp_path: Path) -> None:
    mesh = replace(squares(2), cell_tags={"loops": np.arange(4)})
    write(tmp_path / "o.vtu", mesh)
    assert read(tmp_path / "o.vtu").cell_tags["loops"].tolist() == [0, 1, 2, 3]


def test_cell_data_that_are_no_tags_are_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path / "o.vtu", replace(squares(2), cell_tags={"id": np.arange(4)}))
    more = b"""<DataArray type="Float64" Name="pressure" format="ascii">1 2 3 4.5</DataArray>
<DataArray type="Int32" Name="pair" NumberOfComponents="2" format="ascii">1 2 3 4 5 6 7 8</DataArray>
<DataArray type="Int32" format="ascii">1 2 3 4</DataArray></CellData>"""
    replace_bytes(tmp_path / "o.vtu", b"</CellData>", more)
    with caplog.at_level("INFO", "agglo"):
        mesh = read(tmp_path / "o.vtu")
    assert list(mesh.cell_tags) == ["id"]
    assert mesh.repairs == {"cell data that are not integers left out": 3}
    assert "pressure, pair, (without a name)" in caplog.text


@pytest.mark.parametrize(("value", "fits"), [(2**63 - 1, True), (2**63, False)])
def test_tags_beyond_int64_are_refused(tmp_path: Path, value: int, fits: bool) -> None:
    write(tmp_path / "o.vtu", squares(1))
    more = f'<DataArray type="UInt64" Name="big" format="ascii">{value}</DataArray></CellData>'
    replace_bytes(tmp_path / "o.vtu", b"</CellData>", more.encode())
    if fits:
        assert read(tmp_path / "o.vtu").cell_tags["big"].tolist() == [value]
    else:
        refused(tmp_path / "o.vtu", f"'big' holds {value}")


def test_arguments_of_a_wrong_kind_are_explained(tmp_path: Path) -> None:
    mesh = squares(2)
    levels, file = hierarchy_of(mesh, np.zeros(4, np.int64)), tmp_path / "o.vtu"
    for arguments, match in (
        ((file, levels), "the mesh comes before the hierarchy"),
        ((file, mesh.graph), "the mesh must be a Mesh, given Graph"),
        ((mesh, file), "the path must be a str or a Path, given Mesh"),
        ((file, mesh, levels.levels[0]), "the hierarchy must be a Hierarchy, given ndarray"),
    ):
        with pytest.raises(OptionError, match=match):
            write(*arguments)
    for function in (read, read_hierarchy, check_writable):
        with pytest.raises(OptionError, match="given NoneType"):
            function(None)
    assert os.listdir(tmp_path) == []


def test_boxes_round_trip(tmp_path: Path) -> None:
    mesh = boxes(3)
    hollow = np.zeros(27, np.int64)
    hollow[13] = 1  # the cube in the middle: level 0 is a shell around it
    write(tmp_path / "b.vtu", mesh, hierarchy_of(mesh, hollow))
    back = read(tmp_path / "b.vtu")
    np.testing.assert_allclose(back.cell_measures, 1, rtol=1e-14)
    np.testing.assert_allclose(back.cell_centroids, mesh.cell_centroids, rtol=1e-14)
    assert back.n_faces == mesh.n_faces
    assert back.repairs == {}
    np.testing.assert_array_equal(back.cell_tags["level_0"], hollow)
    np.testing.assert_allclose(read(tmp_path / "b_level0.vtu").cell_measures, [26, 1], rtol=1e-14)


def test_other_meshs_hierarchy_refused(tmp_path: Path) -> None:
    levels = hierarchy_of(squares(3), np.zeros(9, np.int64))
    with pytest.raises(MeshError, match="another mesh"):
        write(tmp_path / "out.vtu", squares(4), levels)
    assert os.listdir(tmp_path) == []


# -- broken files ------------------------------------------------------------------------------


def refused(file: Path, match: str) -> None:
    with pytest.raises(AggloError, match=match) as caught:
        read(file)
    assert str(file) in str(caught.value)
    assert not isinstance(caught.value, PluginError)


def test_not_a_file(tmp_path: Path) -> None:
    refused(tmp_path, "is a folder")
    refused(tmp_path / "absent.vtu", "no such file")
    (tmp_path / "mesh.typ3").write_text("1")
    refused(tmp_path / "mesh.typ3", r"unknown suffix '.typ3' \(did you mean '.typ2' or '.typ1'\?\)")
    (tmp_path / "none").write_text("1")
    refused(tmp_path / "none", "no suffix")
    (tmp_path / "empty.vtu").write_bytes(b"")
    refused(tmp_path / "empty.vtu", "is empty")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("UnstructuredGrid", "PolyData", "not well-formed|expected a VTKFile"),
        ("</VTKFile>", "", "not well-formed"),
        ("LittleEndian", "MiddleEndian", "byte order"),
        ('header_type="UInt64"', 'header_type="UInt16"', "header type"),
        (
            'header_type="UInt64"',
            'header_type="UInt64" compressor="vtkLZ4DataCompressor"',
            "LZ4.*not supported",
        ),
        ('Name="types"', 'Name="kinds"', "'types' is missing"),
        ('Name="offsets"', 'Name="ends"', "'offsets' is missing"),
        (">9 7<", ">9 99<", "type 99 is not supported"),
        (">9 7<", ">9<", "2 cells has 1 types"),
        (">9 7<", ">9 x<", "'types'"),
        (">4 8<", ">4 7<", "'offsets' must increase to 8"),
        (">4 8<", ">5 4<", "'offsets' must increase"),
        ("0 1 2 3 1 4 5 2", "0 1 2 3 1 4 5 6", "outside 0..5"),
        ("0 1 2 3 1 4 5 2", "0 1 2 -3 1 4 5 2", "outside 0..5"),
        ("0 1 2 3 1 4 5 2", "0 1 2 3 0 1 2 3", "duplicates"),
        ('NumberOfCells="2"', 'NumberOfCells="1000000000000"', "1000000000000 cells"),
        ('NumberOfPoints="6"', 'NumberOfPoints="x"', "NumberOfPoints"),
        ('NumberOfPoints="6"', 'NumberOfPoints="1000000000000"', "coordinates"),
        ('type="Float64"', 'type="Float99"', "unknown type 'Float99'"),
        ('format="ascii"', 'format="morse"', "unknown format 'morse'"),
        ("0.0 0.0", "nan 0.0", "not finite"),
        ("0.0 0.0", "0.0 " + "1" * 100, "not a number"),
        ("7 -9", "7", "1 values for 2 cells"),
    ],
)
def test_broken_text(tmp_path: Path, old: str, new: str, match: str) -> None:
    w = Writer()
    cells = [(9, [0, 1, 2, 3]), (7, [1, 4, 5, 2])]
    text = w.file(w.piece(SQUARE, cells, data=w.array("mat", [7, -9], "i4"))).decode()
    assert old in text
    file = tmp_path / "broken.vtu"
    file.write_text(text.replace(old, new, 1))
    refused(file, match)


def test_forged_sizes(tmp_path: Path) -> None:
    """Headers that claim far more than the file holds allocate nothing."""
    for packing, sizes in (("", [10**12]), ("zlib", [10**12, 16, 0]), ("zlib", [1, 10**12, 0, 10])):
        w = Writer("raw", packing)
        content = w.file(w.piece(SQUARE[:4], [(9, [0, 1, 2, 3])]))
        start = content.index(b"\n  _") + 4
        forged = np.array(sizes, "<u8").tobytes()
        file = tmp_path / "forged.vtu"
        file.write_bytes(content[:start] + forged + content[start + len(forged) :])
        refused(file, "truncated|declares a size of|declares 12")
    stream = '<DataArray type="Int64" Name="faces" format="ascii">1000000000000 1</DataArray>'
    ends = '<DataArray type="Int64" Name="faceoffsets" format="ascii">2</DataArray>'
    w = Writer()
    file.write_bytes(w.file(w.piece(ELEMENTS[12][0], [(42, list(range(8)))], stream + ends)))
    refused(file, "more faces than it holds")


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(["ascii", "binary", "raw", "base64"]), st.sampled_from(["", "zlib", "lzma"]), st.data()
)
def test_mutations_never_leak(form: str, packing: str, data: st.DataObject) -> None:
    """Cut or altered bytes: a mesh or our error, nothing else."""
    import tempfile

    w = Writer(form, packing)
    cells = [(14, [4, 5, 6, 7, 8]), (9, [0, 1, 2, 3]), (42, list(range(8)))]
    points = [*ELEMENTS[12][0], [0.5, 0.5, 4]]
    content = bytearray(
        w.file(w.piece(points, cells, polyhedra(w, "stream"), w.array("mat", [1, 2, 3], "i4")))
    )
    for _ in range(data.draw(st.integers(0, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    del content[data.draw(st.integers(len(content) // 2, 2 * len(content))) :]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "m.vtu"
        file.write_bytes(bytes(content))
        named = True
        try:
            read(file)
        except AggloError as error:
            named = str(file) in str(error) and not isinstance(error, PluginError)
        assert named


# -- writing -----------------------------------------------------------------------------------


def test_check_writable(tmp_path: Path) -> None:
    check_writable(tmp_path / "a.vtu")
    (tmp_path / "folder.vtu").mkdir()
    for name, match in (
        ("a.xyz", "unknown suffix"),
        ("no/a.vtu", "does not exist"),
        ("folder.vtu", "is a folder"),
    ):
        with pytest.raises(FileError, match=match):
            check_writable(tmp_path / name)
        with pytest.raises(FileError, match=match):
            write(tmp_path / name, squares(1))
    assert os.listdir(tmp_path) == ["folder.vtu"]


def test_nothing_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failure in the second file of a group leaves the first unwritten and the old one as it was."""
    mesh = squares(4)
    (tmp_path / "out.vtu").write_text("old")
    (tmp_path / "out_level0.vtu").mkdir()
    levels = hierarchy_of(mesh, np.zeros(16, np.int64))
    with pytest.raises(FileError, match="not a regular file"):
        write(tmp_path / "out.vtu", mesh, levels)
    assert (tmp_path / "out.vtu").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["out.vtu", "out_level0.vtu"]

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(vtu_document, "_store", full)
    with pytest.raises(FileError, match=r"out.vtu: No space left"):
        write(tmp_path / "out.vtu", mesh)
    assert (tmp_path / "out.vtu").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["out.vtu", "out_level0.vtu"]


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    real = tmp_path / "real" / "mesh.vtu"
    real.write_text("old")
    real.chmod(0o640)
    (tmp_path / "link.vtu").symlink_to(real)
    write(tmp_path / "link.vtu", squares(2))
    assert (tmp_path / "link.vtu").is_symlink()
    assert read(real).n_cells == 4
    assert real.stat().st_mode & 0o777 == 0o640
    before = os.umask(0o027)
    try:
        write(tmp_path / "new.vtu", squares(2))
    finally:
        os.umask(before)
    assert (tmp_path / "new.vtu").stat().st_mode & 0o777 == 0o640
