"""Graphs and mappings in Scotch's text files, and Chaco's, which METIS' reader takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agglo_core import AggloError, samples
from agglo_core.interchange import graph_from_metis, graph_from_scotch, parts_from_scotch

CUBE = "0\n8 24\n0 000\n3 4 2 1\n3 5 3 0\n3 6 0 3\n3 7 1 2\n3 0 6 5\n3 1 7 4\n3 2 4 7\n3 3 5 6\n"
CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], float)
PATH = "0 4 6 1 111 4 40 1 7 3 2 20 2 8 3 9 1 1 10 1 9 2 3 30 2 8 2 7 4"
PLACES = np.array([[0, 0], [1, 0], [2, 0], [3, 0]], float)


def put(folder: Path, text: str, name: str = "g.grf") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_a_plain_graph(tmp_path: Path) -> None:
    graph = graph_from_scotch(put(tmp_path, CUBE), CORNERS)
    matrix = graph.to_scipy().toarray()
    distance = np.abs(CORNERS[:, None] - CORNERS[None]).sum(axis=2)
    assert np.array_equal(matrix != 0, distance == 1)


def test_names_and_loads(tmp_path: Path) -> None:
    """A path of four in any order of its vertices, from 1 on."""
    graph = graph_from_scotch(put(tmp_path, PATH), PLACES)
    assert graph.weights.tolist() == [10, 20, 30, 40]
    matrix = graph.to_scipy().toarray()
    assert [matrix[i, i + 1] for i in range(3)] == [9, 8, 7]


@pytest.mark.parametrize("text", ["2\n4\n3 2 0\n1 0 0\n4 3 0\n2 1 0\n", "0 0\n1 0\n2 0\n3 0\n"])
def test_places(tmp_path: Path, text: str) -> None:
    graph = graph_from_scotch(put(tmp_path, PATH), put(tmp_path, text, "g.xyz"))
    assert (graph.centroids + graph.origin).tolist() == PLACES.tolist()


def test_an_isolated_vertex(tmp_path: Path) -> None:
    assert graph_from_scotch(put(tmp_path, "0 3 2 0 0 1 1 1 0 0"), PLACES[:3]).indptr.tolist() == [0, 1, 2, 2]


def test_a_large_graph_is_that_of_its_mesh(tmp_path: Path) -> None:
    own = samples.voronoi(20_000).graph
    rows = [" ".join(map(str, (len(row), *row.tolist()))) for row in np.split(own.indices, own.indptr[1:-1])]
    file = put(tmp_path, f"0\n{own.n} {len(own.indices)}\n0 000\n" + "\n".join(rows))
    graph = graph_from_scotch(file, own.centroids)
    assert np.array_equal(graph.indptr, own.indptr)
    assert np.array_equal(graph.indices, own.indices)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "whole number|begins with"),
        ("1 3 2 0 0", "begins with"),
        ("0 3 2 0 222 1 1", "not valid in a Scotch graph"),
        ("0 0 0 0 0", "the graph is empty"),
        ("0 3 2 0 0 1 1 1 0", "vertex 2"),
        ("0 3 2 0 0 1 1 1 0 0 5", "1 left"),
        ("0 3 4 0 0 1 1 1 0 0", "4 arcs are declared"),
        ("0 3 2 0 0 1 5 1 0 0", r"outside 0\.\.2"),
        ("0 3 2 0 100 0 1 1 0 1 0 2 0", "not named"),
        ("0 3 2 0 0 1 1 1 2 0", "symmetric|both"),
        ("0 3 2 0 0 1 1 -1 0 0", "vertex 1"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(AggloError, match=says):
        graph_from_scotch(put(tmp_path, text), PLACES[:3])


@pytest.mark.parametrize(("text", "base"), [("3\n2\t1\n0\t0\n1\t1\n", 0), ("3\n3 1\n1 0\n2 1\n", 1)])
def test_a_mapping(tmp_path: Path, text: str, base: int) -> None:
    assert parts_from_scotch(put(tmp_path, text), base=base).tolist() == [0, 1, 1]


@pytest.mark.parametrize("text", ["", "3\n0 1\n1 0\n", "2\n0 1\n0 1\n", "2\n0 1\n1 -1\n", "-1\n"])
def test_a_broken_mapping_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(AggloError):
        parts_from_scotch(put(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "4 3\n2\n1 3\n2 4\n3\n",
        "4 3 011\n10 2 9\n20 1 9 3 8\n30 2 8 4 7\n40 3 7\n",
        "% named, in order\n4 3 111\n1 10 2 9\n2 20 1 9 3 8\n3 30 2 8 4 7\n4 40 3 7\n",
        "4 3 111\n4 40 3 7\n2 20 1 9 3 8\n1 10 2 9\n3 30 2 8 4 7\n",
    ],
)
def test_chaco(tmp_path: Path, text: str) -> None:
    """Its files are METIS', but a first number may be the name of the vertex."""
    graph = graph_from_metis(put(tmp_path, text, "g.graph"), PLACES)
    assert graph.indptr.tolist() == [0, 1, 3, 5, 6]
    assert graph.indices.tolist() == [1, 0, 2, 1, 3, 2]
    if "1\n" in text[:9]:
        assert graph.interface.tolist() == [9, 9, 8, 8, 7, 7]
        assert graph.weights.tolist() == [10, 20, 30, 40]
