"""Graphs and partitions in METIS' text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, MeshError, agglomerate, samples
from agglo_core.interchange import graph_from_metis, graph_to_metis, parts_from_metis, parts_to_metis

PLAIN = "% a path of four, and one alone\n5 3\n2\n1 3\n2 4\n3\n\n"
WEIGHTED = "3 2 111 2\n9 5 6 2 70\n9 1 2 1 70 3 80\n9 3 4 2 80\n"
PLACES = np.array([[0, 0], [1, 0], [2, 0], [3, 0], [9, 0]], float)


def put(folder: Path, text: str) -> Path:
    (folder / "g.graph").write_text(text)
    return folder / "g.graph"


def test_a_plain_graph(tmp_path: Path) -> None:
    graph = graph_from_metis(put(tmp_path, PLAIN), PLACES)
    assert graph.indptr.tolist() == [0, 1, 3, 5, 6, 6]
    assert graph.indices.tolist() == [1, 0, 2, 1, 3, 2]
    assert (graph.centroids + graph.origin).tolist() == PLACES.tolist()
    np.savetxt(tmp_path / "xyz", PLACES)
    assert graph_from_metis(tmp_path / "g.graph", tmp_path / "xyz").indices.tolist() == graph.indices.tolist()


def test_sizes_and_weights(tmp_path: Path) -> None:
    graph = graph_from_metis(put(tmp_path, WEIGHTED), PLACES[:3])
    assert graph.weights.tolist() == [5, 1, 3]
    assert graph.interface.tolist() == [70, 70, 80, 80]


def test_graphs_and_levels_are_written(tmp_path: Path) -> None:
    mesh = samples.voronoi(80, seed=3)
    graph = mesh.graph
    graph_to_metis(tmp_path / "g.graph", graph)
    assert (tmp_path / "g.graph").read_text().split("\n")[0] == f"80 {len(graph.indices) // 2} 011"
    back = graph_from_metis(tmp_path / "g.graph", tmp_path / "g.graph.xyz")
    assert np.array_equal(back.indptr, graph.indptr)
    assert np.array_equal(back.indices, graph.indices)
    np.testing.assert_allclose(back.centroids + back.origin, graph.centroids + graph.origin, rtol=1e-15)
    ratio = back.interface / graph.interface
    np.testing.assert_allclose(ratio[graph.interface > graph.interface.max() / 10], ratio.max(), rtol=1e-2)
    hierarchy = agglomerate(graph, bisector="coordinate", n_parts=(9, 3))
    files = parts_to_metis(tmp_path / "g.graph", hierarchy)
    assert [file.name for file in files] == ["g.graph.part.9", "g.graph.part.3"]
    for file, labels in zip(files, hierarchy.levels, strict=True):
        assert parts_from_metis(file).tolist() == labels.tolist()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", r"begins with \[\]|whole number"),
        ("5\n", r"begins with \[5\], expected 'vertices edges"),
        ("5 3 2\n", "unknown METIS format code 2"),
        ("99999999 3\n2\n", "99999999 vertices are declared, but 1 lines follow|2 lines follow"),
        (PLAIN.replace("5 3", "5 4"), "4 edges are declared, but the lines list 6"),
        (PLAIN.replace("2 4", "2 9"), r"a neighbour outside 1\.\.5"),
        (PLAIN.replace("2 4", "2 x"), "expected a whole number, found 'x'"),
        (WEIGHTED.replace("2 80\n", "2\n"), "lines list 3 neighbours"),
        (WEIGHTED.replace("111 2", "111 0"), "0 weights per vertex are declared"),
        (PLAIN.replace("2 4", "2-4"), "line 5: expected a whole number, found '2-4'"),
        (PLAIN.replace("2 4", "2\0 4"), "g.graph: "),
        (PLAIN.replace("3\n\n", "99999999999999999999\n\n"), "a number too large for an int64"),
        ("0 0\n", "the graph is empty"),
        ("% only this\n", r"begins with \[\]"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(FileError, match=says):
        graph_from_metis(put(tmp_path, text), PLACES)


def test_errors_name_the_file_and_the_line_comments_counted(tmp_path: Path) -> None:
    text = PLAIN.replace("2 4", "% here, too\n2 x")
    with pytest.raises(FileError, match=r"g\.graph: line 6: expected a whole number, found 'x'$"):
        graph_from_metis(put(tmp_path, text), PLACES)
    with pytest.raises(MeshError, match=r"g\.graph: .*symmetric"):
        graph_from_metis(put(tmp_path, PLAIN.replace("2 4", "2 1")), PLACES)
    graph = graph_from_metis(put(tmp_path, PLAIN.replace("2 4", "% 7 7 7\n2 4")), PLACES)
    assert graph.indices.tolist() == [1, 0, 2, 1, 3, 2]
    (tmp_path / "xyz").write_text("0 0\n1 0\n2 nan\n3 0\n9 0\n")
    with pytest.raises(FileError, match=r"xyz: vertex 2 has the coordinates \[2\.0, nan\]"):
        graph_from_metis(put(tmp_path, PLAIN), tmp_path / "xyz")


def test_missing_and_broken_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"none\.graph: no such file"):
        graph_from_metis(tmp_path / "none.graph", PLACES)
    with pytest.raises(FileError, match=r"xyz: no such file"):
        graph_from_metis(put(tmp_path, PLAIN), tmp_path / "xyz")
    (tmp_path / "xyz").write_text("1 2 3\n")
    with pytest.raises(FileError, match="3 coordinates for 5 vertices"):
        graph_from_metis(tmp_path / "g.graph", tmp_path / "xyz")
    (tmp_path / "p").write_text("0\n-1\n")
    with pytest.raises(FileError, match="vertex 1 is in part -1"):
        parts_from_metis(tmp_path / "p")
