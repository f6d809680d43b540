"""Parallel VTU: a list of files, whose pieces become one mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from core.io.test_io_vtu import SQUARE, Writer, boxes

from agglo_core import FileError, Mesh, agglomerate, read, read_hierarchy, samples, write


def listing(*sources: str) -> str:
    """A .pvtu as VTK writes it."""
    pieces = "".join(f'<Piece Source="{source}"/>' for source in sources)
    return (
        '<?xml version="1.0"?><VTKFile type="PUnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64"><PUnstructuredGrid GhostLevel="1"><PPoints><PDataArray type="Float64" '
        f'NumberOfComponents="3"/></PPoints>{pieces}</PUnstructuredGrid></VTKFile>'
    )


def squares_of(folder: Path, *, ghosts: bool = False) -> Path:
    """Two squares side by side, each in a file; the first may hold the other as a ghost."""
    w, cells = Writer(), [(9, [0, 1, 2, 3]), (9, [1, 4, 5, 2])]
    mine, others = cells if ghosts else cells[:1], cells[1:]
    flags = w.array("vtkGhostType", [0, 1], "u1") if ghosts else ""
    tags = w.array("mat", [4, 5][: len(mine)], "i4")
    folder.mkdir(exist_ok=True)
    (folder / "a.vtu").write_bytes(w.file(w.piece(SQUARE, mine, data=flags + tags)))
    (folder / "b.vtu").write_bytes(w.file(w.piece(SQUARE, others, data=w.array("mat", [6], "i4"))))
    return folder


def test_pieces_are_joined_and_their_points_merged(tmp_path: Path) -> None:
    squares_of(tmp_path / "parts")
    (tmp_path / "all.pvtu").write_text(listing("parts/a.vtu", "parts\\b.vtu"))
    mesh = read(tmp_path / "all.pvtu")
    assert (mesh.name, mesh.n_cells, mesh.n_faces, mesh.n_points) == ("all", 2, 7, 6)
    assert mesh.cell_tags["mat"].tolist() == [4, 6]
    apart = read(tmp_path / "all.pvtu", merge_points=False, allow_gaps=True)
    assert (apart.n_faces, apart.n_points) == (8, 8)


def test_ghosts_are_dropped_also_where_only_some_files_have_them(tmp_path: Path) -> None:
    squares_of(tmp_path, ghosts=True)
    (tmp_path / "all.pvtu").write_text(listing("a.vtu", "b.vtu"))
    mesh = read(tmp_path / "all.pvtu")
    assert (mesh.n_cells, mesh.n_faces) == (2, 7)
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"mat": [4, 6]}
    assert mesh.repairs["ghost cells dropped"] == 1


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_mesh_in_pieces_is_the_mesh(tmp_path: Path, seed: int) -> None:
    mesh = samples.voronoi(120, seed=seed)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(12, 3))
    loops = mesh.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    owner, order = hierarchy.levels[1], []
    for part in range(3):
        own = np.flatnonzero(owner == part)
        order += own.tolist()
        tags = {f"level_{i}": labels[own] for i, labels in enumerate(hierarchy.levels)}
        piece = Mesh.from_polygons(mesh.points, [cells[i].tolist() for i in own], cell_tags=tags)
        write(tmp_path / f"p{part}.vtu", piece)
    (tmp_path / "all.pvtu").write_text(listing("p0.vtu", "p1.vtu", "p2.vtu"))
    back, found = read_hierarchy(tmp_path / "all.pvtu")
    assert (back.n_cells, back.n_faces, back.n_points) == (mesh.n_cells, mesh.n_faces, mesh.n_points)
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures[order], rtol=1e-12)
    assert found is not None
    assert [labels.tolist() for labels in found.levels] == [each[order].tolist() for each in hierarchy.levels]


def test_solids_in_pieces(tmp_path: Path) -> None:
    cubes = boxes(2)
    right = replace(cubes, points=cubes.points + np.array([2.0, 0, 0]))
    write(tmp_path / "a.vtu", cubes)
    write(tmp_path / "b.vtu", right)
    (tmp_path / "all.pvtu").write_text(listing("a.vtu", "b.vtu"))
    mesh = read(tmp_path / "all.pvtu")
    assert (mesh.n_cells, mesh.n_faces) == (16, 2 * cubes.n_faces - 4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (listing("a.vtu", "c.vtu"), "piece 'c.vtu': no such file"),
        (listing("a.vtu", "broken.vtu"), "piece 'broken.vtu': not well-formed XML"),
        (listing("a.vtu", "a.vtu"), "piece 'a.vtu' is listed twice"),
        (listing("a.vtu", "./a.vtu"), "piece './a.vtu' is listed twice"),
        (listing("/etc/a.vtu"), "piece '/etc/a.vtu' is outside the folder"),
        (listing("../a.vtu"), "piece '../a.vtu' is outside the folder"),
        (listing("x/../../a.vtu"), "is outside the folder"),
        (listing("C:/a.vtu"), "is outside the folder"),
        (listing(""), "piece 0 has no attribute Source"),
        (listing("."), "piece 0 has no attribute Source"),
        (listing(), "it has no element Piece"),
        (listing("all.pvtu"), "piece 'all.pvtu': expected a VTKFile of type UnstructuredGrid"),
        ("<VTKFile", "not well-formed XML"),
        ("<!DOCTYPE x>" + listing("a.vtu"), "document type declaration"),
    ],
)
def test_lists_that_cannot_be_read_are_refused(tmp_path: Path, text: str, says: str) -> None:
    squares_of(tmp_path)
    (tmp_path / "broken.vtu").write_text("<VTKFile")
    file = tmp_path / "all.pvtu"
    file.write_text(text)
    with pytest.raises(FileError, match=says) as caught:
        read(file)
    assert str(caught.value).startswith(f"{file}: ")


def test_other_names_and_writing(tmp_path: Path) -> None:
    squares_of(tmp_path)
    (tmp_path / "all.xml").write_text(listing("a.vtu", "b.vtu"))
    assert read(tmp_path / "all.xml").n_cells == 2
    with pytest.raises(FileError, match="not write them"):
        write(tmp_path / "out.pvtu", samples.squares(2))
