"""Bad input: each fault is refused by a message that names the cells, points or faces at fault."""

from __future__ import annotations

import dataclasses
import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import Diffusion, Graph, Mesh, MeshError, OptionError, agglomerate, read, samples
from agglo_core.authoring import System

GRID = [[x, y] for y in range(3) for x in range(3)]  # points 0..8 of 2 x 2 unit squares
CELLS = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]]
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
HEX = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
QUADS = np.arange(0, 25, 4)
TET_POINTS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 1]]


def tet(a: int, b: int, c: int, d: int) -> list[list[int]]:
    return [[a, c, b], [a, b, d], [b, c, d], [c, a, d]]


def moved(point: int, to: Any) -> list[Any]:
    return [to if k == point else at for k, at in enumerate(GRID)]


def replaced(cell: int, by: Any) -> list[Any]:
    return [by if k == cell else loop for k, loop in enumerate(CELLS)]


# what is wrong: (points, cells, what the message says)
FAULTS: dict[str, tuple[Any, Any, str]] = {
    "NaN": (moved(5, [np.nan, 1]), CELLS, r"point 5 is not finite: \[nan, 1.0\]"),
    "infinite": (moved(8, [2, -np.inf]), CELLS, r"point 8 is not finite"),
    "bow-tie": (GRID, replaced(1, [1, 5, 2, 4]), r"cell 1: .*bow-tie"),
    "crossing hexagon": (
        [[0, 0], [4, 0], [4, 4], [3, 4], [3, -1], [0, 4]], [[0, 1, 2, 3, 4, 5]], r"cell 0: .*bow-tie",
    ),
    "a loop walked twice": (GRID, [[0, 1, 4, 3, 0, 1, 4, 3]], r"cell 0: a repeated vertex"),
    "zero area, triangle": (GRID, [[0, 1, 4], [0, 1, 2]], r"cell 1: zero area"),
    "zero area, quadrilateral": ([[0, 0], [1, 0], [3, 0], [2, 0]], [[0, 1, 2, 3]], r"cell 0: zero area"),
    "zero area, started midway": ([[1, 0], [2, 0], [3, 0], [0, 0]], [[0, 1, 2, 3]], r"cell 0: zero area"),
    "folds back": ([[0, 0], [2, 0], [1, 0], [1, 1]], [[0, 1, 2, 3]], r"cell 0: .*folds back"),
    "passes through its own vertex": (
        [[0, 0], [4, 0], [4, 4], [2, 0], [0, 4]], [[0, 1, 2, 3, 4]], r"cell 0: .*crosses itself",
    ),
    "duplicate cell": (GRID, [*CELLS, CELLS[0]], r"cells 0 and 4 are duplicates"),
    "duplicate alone": (GRID, [CELLS[0], CELLS[0]], r"cells 0 and 1 are duplicates"),
    "duplicate, other way around": (GRID, [*CELLS, [4, 3, 0, 1][::-1]], r"cells 0 and 4 are duplicates"),
    "repeated vertices, one left": (GRID, replaced(2, [4, 4, 4]), r"cell 2: zero area; drop_flat=True"),
    "repeated vertex, apart": (GRID, [[0, 1, 4, 1, 2]], r"cell 0: a repeated vertex"),
    "repeated vertex, triangle": (GRID, [[0, 1, 0]], r"cell 0: zero area"),
    "too few vertices": (GRID, replaced(3, [4, 5]), r"cell 3: fewer than 3 vertices"),
    "no vertices": (GRID, replaced(3, []), r"cell 3: fewer than 3 vertices"),
    "nothing but empty loops": (GRID, [[], []], r"cells 0, 1: fewer than 3 vertices"),
    "columns missing": (GRID, np.array([[0, 1], [1, 2]]), r"cells 0, 1: fewer than 3 vertices"),
    "no columns": (GRID, np.zeros((2, 0), int), r"cells 0, 1: fewer than 3 vertices"),
    "index out of range": (GRID, replaced(1, [1, 2, 9, 4]), r"cell 1 uses point 9, but there are 9 points"),
    "index far out of range": (GRID, replaced(1, [1, 2, 2**40, 4]), r"cell 1 uses point 1099511627776"),
    "unsigned wrap": (GRID, np.array([[0, 1, 2**64 - 1]], np.uint64), r"cells must be .* fit in int64"),
    "negative index": (GRID, replaced(0, [0, 1, -1, 3]), r"cell 0 uses point -1"),
    "three cells on a face": (
        [*GRID, [3, 0.5]], [[0, 1, 4], [1, 9, 4], [1, 2, 4]], r"(1 and 4|4 and 1) has .*: cells 0, 1, 2",
    ),
    "three cells, two on one side first": (
        [*GRID, [3, 0.5]], [[1, 9, 4], [1, 2, 4], [0, 1, 4]], r"(1 and 4|4 and 1) has .*: cells 0, 1, 2",
    ),
    "no cells": (GRID, [], r"empty"),
    "no cells, as an array": (GRID, np.zeros((0, 3), int), r"empty"),
    "no cells, as offsets": (GRID, (np.zeros(1, int), np.zeros(0, int)), r"empty"),
    "no points": ([], CELLS, r"points must have shape"),
    "no points, but columns": (np.zeros((0, 2)), CELLS, r"cell 0 uses point 0, but there are 0 points"),
    "surface": ([[*at, at[0] * at[1]] for at in GRID], CELLS, r"surface.*z runs from 0 to 4"),
    "upright plane": ([[0, *at] for at in GRID], CELLS, r"surface"),
    "one coordinate": ([[0], [1], [2]], [[0, 1, 2]], r"points must have shape"),
    "flat list of points": ([0, 1, 2], [[0, 1, 2]], r"points must have shape"),
    "words for points": ([["a", "b"]], [[0, 1, 2]], r"points must be numbers"),
    "ragged points": ([[0, 0], [1]], [[0, 1, 2]], r"points must be an array of numbers"),
    "no points at all": (None, CELLS, r"points must"),
    "fractional cells": (GRID, [[0, 1, 4.5]], r"cells must hold integers.*float64"),
    "whole floats": (GRID, np.array([[0.0, 1, 4]]), r"cells must hold integers.*float64"),
    "boolean cells": (GRID, np.ones((2, 3), bool), r"cells must hold integers.*bool"),
    "words for cells": (GRID, ["abc"], r"cells must hold integers"),
    "a flat list of cells": (GRID, [0, 1, 4], r"cells must be vertex loops"),
    "one number": (GRID, 3, r"cells must be vertex loops"),
    "nothing": (GRID, None, r"cells must be vertex loops"),
    "ragged nonsense": (GRID, [[0, [1, 2], 3]], r"cells must"),
    "three levels": (GRID, np.zeros((1, 2, 3), int), r"cells must"),
    "three levels, lists": (GRID, [[[0, 1, 4, 3]]], r"cells must"),
    "offsets that do not start at 0": (GRID, (np.array([1, 4]), np.arange(4)), r"cell offsets must increase"),
    "offsets that stop short": (GRID, (np.array([0, 3]), np.array([0, 1, 4, 3])), r"offsets must increase"),
    "offsets that fall": (GRID, (np.array([0, 5, 3, 6]), np.array([0, 1, 4, 1, 2, 5])), "must increase"),
    "no offsets": (GRID, (np.array([], int), np.array([], int)), r"offsets must increase"),
    "fractional offsets": (GRID, (np.array([0, 3.5]), np.array([0, 1, 4])), r"offsets must hold int"),
    "matrix of offsets": (GRID, (np.zeros((2, 2), int), np.array([0, 1, 4])), r"one-dimensional"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("merge_points", [False, True])
def test_polygons(fault: str, merge_points: bool) -> None:
    points, cells, message = FAULTS[fault]
    with pytest.raises(MeshError, match=message):
        Mesh.from_polygons(points, cells, merge_points=merge_points)


def test_merging_may_degenerate_a_cell() -> None:
    points = [[0, 0], [1, 0], [1, 0], [1, 1]]
    with pytest.raises(MeshError, match="cell 0: a repeated vertex"):
        Mesh.from_polygons([*points, [0, 1]], [[0, 1, 4, 2, 3]], merge_points=True)
    with pytest.raises(MeshError, match="cell 1: zero area; drop_flat=True leaves such cells out"):
        Mesh.from_polygons(points, [[0, 1, 3], [0, 1, 2]], merge_points=True)


def test_many_faulty_cells_are_counted_and_the_first_named() -> None:
    cells = [[0, 1, 4, 3], *[[0, 1, 2]] * 9]
    with pytest.raises(MeshError, match=re.escape("cells 1, 2, 3, 4, 5, … (9 in all): zero area")):
        Mesh.from_polygons(GRID, cells)


@pytest.mark.parametrize("scale", [1e-49, 1e-9, 1.0, 1e9, 1e49])
def test_zero_area_does_not_depend_on_the_unit(scale: float) -> None:
    thin = [[0, 0], [1, 0], [0.5, 1e-9]]
    assert Mesh.from_polygons(np.multiply(thin, scale), [[0, 1, 2]]).n_cells == 1
    with pytest.raises(MeshError, match="zero area"):
        Mesh.from_polygons(np.multiply([[0, 0], [1, 1], [3, 3]], scale), [[0, 1, 2]])


def test_collinear_vertices_are_not_a_fault() -> None:
    ring = [[x, 0] for x in range(4)] + [[3, y] for y in range(1, 4)] + [[0, 3]]
    assert Mesh.from_polygons(ring, [list(range(8))]).cell_measures.tolist() == [9.0]


# --- overlaps and unlisted hanging nodes: only strict=True -----------------------------------------------

HANGING = ([[0, 0], [1, 0], [1, 0.5], [1, 1], [0, 1], [2, 0], [2, 0.5], [2, 1]],
           [[0, 1, 3, 4], [1, 5, 6, 2], [2, 6, 7, 3]])  # fmt: skip
INSIDE = (
    [[0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [2, 1], [2, 2], [1, 2]],
    [[0, 1, 2, 3], [4, 5, 6, 7]],
)
ACROSS = (
    [[0, 0], [2, 0], [2, 2], [0, 2], [1, 1], [3, 1], [3, 3], [1, 3]],
    [[0, 1, 2, 3], [4, 5, 6, 7]],
)


@pytest.mark.parametrize(
    ("mesh", "cells"),
    [(HANGING, {0, 1, 2}), (INSIDE, {0, 1}), (ACROSS, {0, 1})],
    ids=["hanging", "inside", "across"],
)
def test_the_strict_check_names_cells_and_an_edge(mesh: tuple[Any, Any], cells: set[int]) -> None:
    points, loops = mesh
    assert Mesh.from_polygons(points, loops).n_cells == len(loops)
    with pytest.raises(MeshError, match=r"first along the edge from \[.*\] to \[.*\]") as caught:
        Mesh.from_polygons(points, loops, strict=True)
    named = re.match(r"cells? ([\d, ]+)", str(caught.value))
    assert named is not None
    assert set(map(int, named[1].split(","))) <= cells


def test_the_strict_check_gives_user_coordinates() -> None:
    points, loops = HANGING
    with pytest.raises(MeshError, match=r"from \[1001.0, 1000.0\] to \[1001.0, 1001.0\]"):
        Mesh.from_polygons(np.add(points, 1000), loops, strict=True)


@pytest.mark.parametrize(("periodic", "area", "pairs"), [((1, 0), 24, 8), ((0, 1), 24, 8), ((1, 1), 36, 16)])
@pytest.mark.parametrize("cut", [False, True])
def test_cells_that_wrap_around_are_warned_about(
    periodic: tuple[int, int], area: float, pairs: int, cut: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """A periodic grid of 4 × 4 squares, or of their halves, whose last cells use the points of the first."""
    nx, ny = (5 - each for each in periodic)
    points = [[x, y] for y in range(ny) for x in range(nx)]
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    squares = [[(y + dy) % ny * nx + (x + dx) % nx for dx, dy in corners] for y in range(4) for x in range(4)]
    halves = [half for a, b, c, d in squares for half in ([a, b, c], [a, c, d])]
    mesh = Mesh.from_polygons(points, halves if cut else squares)
    assert mesh.cell_measures.sum() == pytest.approx(area)
    (warning,) = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    assert warning.startswith(f"{pairs} pairs of cells overlap at an edge, such as cells ")
    assert "In a periodic mesh, give cells that wrap around separate points" in warning


def test_two_cells_on_one_side_of_an_edge(caplog: pytest.LogCaptureFixture) -> None:
    points, cells = [*GRID, [3, 0.5]], [[1, 9, 4], [1, 2, 4]]
    with caplog.at_level(logging.INFO, logger="agglo"):
        mesh = Mesh.from_polygons(points, cells)
    assert dict(mesh.repairs) == {"orphan points dropped": 6, "overlapping edges left apart": 1}
    assert "overlapping edges left apart: 1" in caplog.text
    (warning,) = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    assert warning.startswith("1 pairs of cells overlap at an edge, such as cells 0 and 1: ")
    with pytest.raises(MeshError, match="cells 0 and 1 overlap"):
        Mesh.from_polygons(points, cells, strict=True)


@pytest.mark.parametrize("name", ["squares:4", "random_triangles:30", "voronoi:50", "hexagons:4", "ring:12"])
def test_good_meshes_pass_the_strict_check(name: str) -> None:
    mesh = samples.from_spec(name)
    loops = mesh.boundary_loops
    again = Mesh.from_polygons(mesh.points, (loops.loop_offsets, loops.vertices), strict=True)
    assert again.n_faces == mesh.n_faces


# --- tags and labels ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1, 2, 3], r"cell tag 'm' has shape \(3,\), expected \(4,\)"),
        ([[1, 2], [3, 4]], r"cell tag 'm' has shape \(2, 2\)"),
        (5, r"cell tag 'm' has shape \(\)"),
        ([0.5, 1, 2, 3], r"cell tag 'm' must hold integers, not float64"),
        (["a", "b", "c", "d"], r"cell tag 'm' must hold integers"),
    ],
)
def test_tags(values: Any, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        Mesh.from_polygons(GRID, CELLS, cell_tags={"m": values})


def test_a_face_tag_of_wrong_length() -> None:
    mesh = Mesh.from_polygons(GRID, CELLS)
    with pytest.raises(MeshError, match=r"face tag 'side' has shape \(3,\), expected \(12,\)"):
        replace(mesh, face_tags={"side": np.zeros(3, int)})


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ([0, 0, 1], r"labels must be \(4,\) integers.*given shape \(3,\)"),
        ([0, 0, 1.0, 1], r"dtype float64"),
        ([True, False, True, True], r"dtype bool"),
        ([0, -1, 1, 1], r"label of cell 1 is negative"),
        ([0, 2, 2, 0], r"no cell has label 1 \(of 0..2\)"),
        ([0, 1, 2, 10**15], r"no cell has label 3 \(of 0..1000000000000000\)"),
    ],
)
def test_labels(labels: Any, message: str) -> None:
    mesh = Mesh.from_polygons(GRID, CELLS)
    for coarsen in (mesh.coarsen, mesh.graph.coarsen, mesh.graph.part_diameters):
        with pytest.raises(MeshError, match=message):
            coarsen(labels)


# --- polyhedra ----------------------------------------------------------------------------------------

SOLIDS: dict[str, tuple[Any, Any, str]] = {
    "NaN": (np.where(CUBE == 1, np.nan, CUBE), [HEX], r"point 1 is not finite"),
    "plane points": (CUBE[:, :2], [HEX], r"points of shape \(n_points, 3\)"),
    "open": (CUBE, [HEX[:-1]], r"cell 0: the faces do not close"),
    "open, among others": (TET_POINTS, [tet(0, 1, 2, 3), [*tet(0, 2, 1, 4)[:3], [0, 1, 5]]], r"cell 1: the"),
    "the same face twice": (CUBE, [[*HEX, HEX[0], HEX[0][::-1]]], r"cell 0: the same face twice"),
    "fewer than 4 faces": (CUBE, [HEX[:3]], r"cell 0: fewer than 4 faces"),
    "a face of two vertices": (CUBE, [[*HEX[:-1], [1, 3]]], r"cell 0: a face with fewer than 3 vertices"),
    "an empty face": (CUBE, [HEX, [*HEX[:-1], []]], r"cell 1: a face with fewer than 3 vertices"),
    "a repeated vertex": (CUBE, [[*HEX[:-1], [1, 3, 7, 3]]], r"cell 0: a face with a repeated vertex"),
    "index out of range": (CUBE, [[*HEX[:-1], [1, 3, 8, 5]]], r"cell 0 uses point 8, but there are 8 points"),
    "negative index": (TET_POINTS, [tet(0, 1, 2, 3), tet(0, 2, 1, -2)], r"cell 1 uses point -2"),
    "zero volume": (CUBE * [1, 1, 0], [HEX], r"cell 0: zero volume"),
    "flat tetrahedron": (np.eye(4, 3) * [1, 1, 0], [tet(0, 1, 2, 3)], r"cell 0: zero volume"),
    "duplicates alone": (CUBE, [HEX, HEX], r"cells 0 and 1 are duplicates"),
    "duplicates": (
        TET_POINTS, [tet(0, 1, 2, 3), tet(0, 2, 1, 4), tet(1, 2, 0, 3)], r"cells 0 and 2 are duplicates",
    ),
    "three cells on a face": (
        TET_POINTS, [tet(0, 1, 2, 3), tet(0, 2, 1, 4), tet(0, 1, 2, 5)],
        r"face with points \[0, 1, 2\] has more than two cells: cells 0, 1, 2",
    ),
    "three cells, points renumbered": (
        [[9, 9, 9], *TET_POINTS], [[[v + 1 for v in f] for f in tet(0, 1, 2, k)] for k in (3, 5, 4)],
        r"face with points \[1, 2, 3\] has more than two cells: cells 0, 1, 2",
    ),
    "overlap": (TET_POINTS, [tet(0, 1, 2, 3), tet(0, 1, 2, 5)], r"cells 0 and 1 overlap"),
    "no cells": (CUBE, [], r"empty"),
    "no cells, as offsets": (CUBE, (np.zeros(1, int), np.zeros(1, int), np.zeros(0, int)), r"empty"),
    "polygons": (CUBE, [[0, 1, 3, 2]], r"cells must be lists of faces"),
    "fractional": (CUBE, [[[0.5, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]]], r"cells must hold integers"),
    "nothing": (CUBE, None, r"cells must be lists of faces"),
    "wrong cell offsets": (CUBE, (np.array([0, 5]), QUADS, np.ravel(HEX)), r"offsets must increase"),
    "wrong face offsets": (CUBE, (np.array([0, 6]), QUADS[::-1], np.ravel(HEX)), r"face offsets"),
    "fractional offsets": (CUBE, (np.array([0, 6.0]), QUADS, np.ravel(HEX)), r"offsets must hold"),
}  # fmt: skip


@pytest.mark.parametrize("fault", SOLIDS)
def test_polyhedra(fault: str) -> None:
    points, cells, message = SOLIDS[fault]
    with pytest.raises(MeshError, match=message):
        Mesh.from_polyhedra(points, cells)


def test_a_tag_of_the_wrong_length_in_3d() -> None:
    with pytest.raises(MeshError, match=r"cell tag 'm' has shape \(2,\), expected \(1,\)"):
        Mesh.from_polyhedra(CUBE, [HEX], cell_tags={"m": [1, 2]})


# --- graphs -------------------------------------------------------------------------------------------

PATH: dict[str, Any] = {
    "indptr": [0, 1, 3, 4],
    "indices": [1, 0, 2, 1],
    "centroids": [[0, 0], [1, 0], [2, 0]],
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"indices": [1, 0, 3, 1]}, r"indices must lie in 0..2"),
        ({"indices": [1, 0, -1, 1]}, r"indices must lie in 0..2"),
        ({"indptr": [0, 1, 3]}, r"indptr must have 4 entries increasing from 0 to 4"),
        ({"indptr": [1, 1, 3, 4]}, r"indptr must have 4 entries increasing from 0 to 4"),
        ({"indptr": [0, 3, 1, 4]}, r"indptr must have 4 entries increasing"),
        ({"indptr": [0, 2, 3, 4], "indices": [1, 2, 2, 1]}, r"symmetric"),
        ({"indptr": [0, 2, 4, 5], "indices": [0, 1, 0, 2, 1]}, r"node 0 has an edge to itself"),
        ({"interface": [1, 2, 3, 3]}, r"symmetric"),
        ({"interface": [1, 1, 1]}, r"interface must have shape \(4,\), not \(3,\)"),
        ({"interface": [1, 1, np.nan, 1]}, r"interface\[2\] is nan"),
        ({"interface": [0] * 4, "indptr": [0, 2, 3, 4], "indices": [1, 2, 2, 1]}, r"symmetric"),
        ({"measures": [1, -1, 1]}, r"measures\[1\] is -1"),
        ({"measures": [1, 1]}, r"must have shape"),
        ({"weights": [1, np.inf, 1]}, r"weights\[1\] is inf"),
        ({"boundary": [[1, 1, 1]]}, r"boundary must have shape"),
        ({"centroids": [[0, 0], [np.nan, 0], [2, 0]]}, r"centroids\[.*\] is nan"),
        ({"centroids": [0, 1, 2]}, r"centroids must have shape"),
        ({"centroids": np.zeros((0, 2)), "indptr": [0], "indices": []}, r"empty"),
        ({"data": {"material": np.zeros(2)}}, r"data 'material' has 2 rows, expected 3"),
    ],
)  # fmt: skip
def test_graph_arrays(change: dict[str, Any], message: str) -> None:
    assert Graph.from_arrays(**PATH).n == 3
    with pytest.raises(MeshError, match=message):
        Graph.from_arrays(**(PATH | change))


# --- points that no cell uses -------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_unused_points_need_not_be_finite(value: float, tmp_path: Path) -> None:
    square = [[value, value], [0, 0], [1, 0], [0, value], [1, 1], [0, 1]]
    mesh = Mesh.from_polygons(square, [[1, 2, 4, 5]])
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert mesh.repairs == {"orphan points dropped": 2}
    cube = np.vstack(([value] * 3, CUBE, [[value] * 3]))
    solid = Mesh.from_polyhedra(cube, [[[v + 1 for v in face] for face in HEX]])
    assert solid.points.tolist() == CUBE.tolist()
    assert solid.cell_measures.tolist() == Mesh.from_polyhedra(CUBE, [HEX]).cell_measures.tolist()
    rows = "".join(f"{x} {y} {'nan' if x != x else 0}\n" for x, y in square)
    (tmp_path / "m.off").write_text(f"OFF\n6 1 0\n{rows}4 1 2 4 5\n")
    assert read(tmp_path / "m.off").points.tolist() == mesh.points.tolist()
    with pytest.raises(MeshError, match=r"point 3 is not finite: \[0.0, .*\] \(1 such points\)"):
        Mesh.from_polygons(square, [[1, 2, 3, 4, 5]])


# --- constructors and masked entries ------------------------------------------------------------------------
FIELDS = ("points", "face_offsets", "face_vertices", "face_cells", "cell_tags", "face_tags")


def at(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
    changed = array.astype(np.result_type(array, value))
    changed[place] = value
    return changed


def masked(array: np.ndarray) -> np.ma.MaskedArray:
    hidden = np.ma.array(array)
    hidden[(1,) * array.ndim] = np.ma.masked
    return hidden


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: {"points": at(m.points, 0, np.nan)}, "point 0 is not finite"),
        (lambda m: {"points": m.points + 1j}, "points must be numbers, given complex128"),
        (lambda m: {"points": m.points.astype("M8[s]")}, "points must be numbers, given datetime64"),
        (lambda m: {"points": m.points.astype(str)}, "points must be numbers, given <U"),
        (lambda m: {"points": masked(m.points)}, "points has masked entries"),
        (lambda m: {"points": 1e60 * m.points}, "choose another unit of length"),
        (lambda m: {"face_offsets": at(m.face_offsets, 3, 10**9)}, "face_offsets: a face must have"),
        (lambda m: {"face_offsets": m.face_offsets + 0.25}, "face_offsets must hold integers"),
        (lambda m: {"face_offsets": m.face_offsets[1:]}, "face_offsets must be .* increase from 0"),
        (lambda m: {"face_offsets": m.face_offsets[::-1].copy()}, "face_offsets must be .* increase from 0"),
        (lambda m: {"face_vertices": at(m.face_vertices, 0, m.n_points)}, "face_vertices must lie in 0"),
        (lambda m: {"face_vertices": at(m.face_vertices, 0, -1)}, "face_vertices must lie in 0"),
        (lambda m: {"face_vertices": masked(m.face_vertices)}, "face_vertices has masked entries"),
        (lambda m: {"face_vertices": at(m.face_vertices, 0, m.face_vertices[-1])}, "faces do not close"),
        (lambda m: {"face_cells": m.face_cells + 0.4}, "face_cells must hold integers"),
        (lambda m: {"face_cells": masked(m.face_cells)}, "face_cells has masked entries"),
        (lambda m: {"face_cells": at(m.face_cells, (0, 0), 10**11)}, "faces cannot bound 100000000001 cells"),
        (lambda m: {"face_cells": at(m.face_cells, 0, 3)}, "face 0 has cell 3 on both sides"),
        (lambda m: {"face_cells": at(m.face_cells, (0, 0), -1)}, "every face needs an owner"),
        (lambda m: {"face_cells": m.face_cells + (m.face_cells > 0)}, "cell 1 of 9 have no faces"),
        (lambda m: {"points": m.points * np.append(-1, np.ones(m.dim - 1))}, "turned inside out"),
        (lambda m: {"cell_tags": {"rock": masked(np.arange(m.n_cells))}}, "tag 'rock' has masked entries"),
        (lambda m: {"face_tags": {"wall": np.full(m.n_faces, 0.5)}}, "face tag 'wall' must hold integers"),
        (lambda m: {"cell_tags": {"rock": np.full(m.n_cells, 2**63, np.uint64)}}, "'rock' must be .* int64"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("mesh", [samples.boxes(2), samples.strip(8)], ids=["solid", "plane"])
def test_the_constructor_refuses_what_is_no_mesh(mesh: Mesh, change: Any, message: str) -> None:
    fields = {name: getattr(mesh, name) for name in FIELDS}
    assert Mesh(**fields).cell_measures.tolist() == pytest.approx(mesh.cell_measures.tolist(), rel=1e-14)
    with pytest.raises(MeshError, match=message):
        Mesh(**fields | change(mesh))


def test_masked_vertices_at_the_end_of_a_row_are_padding() -> None:
    points = [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]]
    rows = np.ma.array([[0, 1, 4, 5, 0], [1, 2, 3, 4, 0], [0, 1, 2, 3, 0]])
    rows.mask = [[0, 0, 0, 0, 1], [0, 0, 0, 1, 1], [1, 1, 1, 1, 1]]
    for cells in (rows[:2], list(rows[:2]), [rows[0], np.array([1, 2, 3])]):
        assert Mesh.from_polygons(points, cells).cell_measures.tolist() == [1.0, 0.5]
    for cells in (rows, list(rows)):
        with pytest.raises(MeshError, match="cell 2: fewer than 3 vertices"):
            Mesh.from_polygons(points, cells)
    rows.mask = [[0, 0, 0, 0, 1], [0, 1, 0, 0, 1], [0, 0, 0, 0, 1]]
    with pytest.raises(MeshError, match="cell 1: masked vertices must be at the end of the row"):
        Mesh.from_polygons(points, rows)
    with pytest.raises(MeshError, match=r"masked vertices must be at the end of a loop, given \[1, None, 3"):
        Mesh.from_polygons(points, list(rows))
    with pytest.raises(MeshError, match="cells has masked entries"):
        Mesh.from_polygons(points, [[0, 1, 4, 5], [1, 2, np.ma.masked]])
    with pytest.raises(MeshError, match="cell offsets has masked entries"):
        Mesh.from_polygons(points, (np.ma.masked_equal([0, 4, 7], 4), np.array([0, 1, 4, 5, 1, 2, 3])))


def test_masked_vertices_at_the_end_of_a_face_are_padding() -> None:
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]]
    faces = np.ma.array([[0, 3, 2, 1], [0, 1, 4, 9], [1, 2, 4, 9], [2, 3, 4, 9], [3, 0, 4, 9]])
    pyramid = Mesh.from_polyhedra(points, [np.ma.masked_equal(faces, 9)])
    assert pyramid.cell_measures.tolist() == pytest.approx([1 / 3], rel=1e-14)
    assert pyramid.n_faces == 5


@pytest.mark.parametrize(
    ("name", "changed", "message"),
    [
        ("indptr", lambda g: g.indptr + 0.5, "indptr must be an array of integers"),
        (
            "indices",
            lambda g: g.indices.astype(np.int64) + 2**32,
            "indices must be whole numbers that fit in int32",
        ),
        ("indices", lambda g: masked(g.indices), "indices has masked entries"),
        ("interface", lambda g: masked(g.interface), "interface has masked entries"),
        ("centroids", lambda g: g.centroids * 1j, "centroids must be an array of numbers, not of complex128"),
        ("measures", lambda g: -g.measures, "finite and not negative"),
        ("weights", lambda g: masked(g.weights), "weights has masked entries"),
        ("weights", lambda g: g.weights.astype("m8[s]"), "weights must be an array of numbers"),
        ("vertex_offsets", lambda g: g.vertex_offsets[::-1], "vertex_offsets must have 5 entries increasing"),
        ("vertices", lambda g: g.vertices + 100, "vertices must lie in 0..8"),
        ("points", lambda g: g.points[:, :1], r"points must have shape \(p, 2\)"),
        ("offsets", lambda g: [0, 2, 4], "an edge joins nodes 0 and 2, which are in different blocks"),
        ("origin", lambda g: np.zeros(3), r"origin must have shape \(2,\)"),
        ("data", lambda g: {"rock": masked(np.arange(4))}, "data 'rock' has masked entries"),
    ],
)
def test_the_constructor_refuses_what_is_no_graph(name: str, changed: Any, message: str) -> None:
    graph = samples.squares(2).graph
    fields = {field.name: getattr(graph, field.name) for field in dataclasses.fields(Graph)}
    assert Graph(**fields).indices.tolist() == graph.indices.tolist()
    with pytest.raises(MeshError, match=message):
        Graph(**fields | {name: changed(graph)})


@pytest.mark.parametrize(
    "indices", [np.array([2**32 + 1, 2**32]), np.array([1, -(2**32)]), np.array([2**63, 0], np.uint64)]
)
def test_neighbours_beyond_32_bits_do_not_wrap(indices: np.ndarray) -> None:
    with pytest.raises(MeshError, match="indices must be whole numbers that fit in int32"):
        Graph.from_arrays([0, 1, 2], indices, [[0, 0], [1, 0]])


def test_masked_arguments_are_refused_by_name() -> None:
    mesh, error = samples.squares(4), (MeshError, OptionError)
    cells = np.ma.masked_equal(np.arange(16), 3)
    for word, call in {
        "labels": lambda: mesh.coarsen(np.ma.array(np.arange(16) // 4, mask=cells.mask)),
        "cells": lambda: mesh.renumbered(cells),
        "cell tag 'rock'": lambda: mesh.with_tags(rock=cells),
        "face tag 'wall'": lambda: mesh.with_face_tags(wall=np.ma.masked_equal(np.arange(mesh.n_faces), 2)),
        "weights": lambda: agglomerate(mesh, n_parts=2, weights=cells),
        "regions": lambda: agglomerate(mesh, n_parts=2, regions=cells),
        "where": lambda: agglomerate(mesh, n_parts=2, where=cells > 2),
        "metric": lambda: agglomerate(mesh, n_parts=2, metric=masked(np.eye(2))),
        "mass": lambda: mesh.graph.with_mass(cells),
        "the indicator": lambda: agglomerate(mesh, n_parts=2).cut(4, cells),
        "b": lambda: System(np.eye(16), cells),
        "A": lambda: System(masked(np.eye(16)), np.ones(16)),
        "near_null": lambda: System(np.eye(16), np.ones(16), near_null=cells[:, None]),
        "block_offsets": lambda: System(np.eye(15), np.ones(15), cells),
        "kappa": lambda: Diffusion(kappa=1 + cells),
        r"dirichlet\[3\]": lambda: Diffusion(dirichlet={3: cells}),
    }.items():
        with pytest.raises(error, match=f"^{word} has masked entries"):
            call()


def test_a_cell_array_of_matlab_is_refused_with_its_conversion() -> None:
    array = np.empty((2, 1), object)
    array[:, 0] = [np.array([[1.0, 2.0, 5.0, 6.0]]), np.array([[2.0, 3.0, 4.0, 5.0]])]
    points = [[0, 0], [1, 0], [2, 0], [2, 1], [1, 1], [0, 1]]
    says = r"\[np.ravel\(cell\).astype\(int\) - 1 for cell in cells.ravel\(\)\]"
    for cells in (array, array.ravel(), list(array.ravel())):
        with pytest.raises(MeshError, match=says):
            Mesh.from_polygons(points, cells)
    loops = [np.ravel(cell).astype(int) - 1 for cell in array.ravel()]
    assert Mesh.from_polygons(points, loops).cell_measures.tolist() == [1.0, 1.0]
