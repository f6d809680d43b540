"""Overlaps of plane cells anywhere: the warning and its measures, and meshes without overlaps."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

from agglo_core import Mesh, MeshError, samples
from agglo_core.arrays import frozen_int
from agglo_core.interchange import mesh_from_shapely
from agglo_core.mesh.construction import double_cover

SLOT = [
    [0, 0],
    [4, 0],
    [4, 1],
    [2, 1],
    [2, 1],
    [4, 1],
    [4, 2],
    [0, 2],
    [0, 1],
]  # cut from the right to (2, 1)


def box(x: float, y: float, width: float = 1, height: float = 1) -> list[list[float]]:
    return [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]


def frame(x: float, y: float, inner: float, outer: float) -> list[list[list[float]]]:
    """Four trapezia around a square hole."""
    gap = (outer - inner) / 2
    out, into = box(x, y, outer, outer), box(x + gap, y + gap, inner, inner)
    return [[out[k], out[(k + 1) % 4], into[(k + 1) % 4], into[k]] for k in range(4)]


def soup(cells: list[list[list[float]]], **options: bool) -> Mesh:
    """Mesh of cells that have points of their own."""
    offsets = np.cumsum([0, *map(len, cells)])
    return Mesh.from_polygons(np.concatenate(cells), (offsets, np.arange(offsets[-1])), **options)


def turned(cells: list[list[list[float]]], angle: float) -> list[list[list[float]]]:
    c, s = np.cos(angle), np.sin(angle)
    return [(np.array(cell) @ [[c, s], [-s, c]]).tolist() for cell in cells]


def double_covers(caplog: pytest.LogCaptureFixture) -> list[tuple[float, float, float]]:
    """Total, union and excess of each warning."""
    return [
        record.args
        for record in caplog.records
        if record.levelno == logging.WARNING and record.getMessage().startswith("cells overlap: their total")
    ]


OVERLAPS = {
    "corners": ([box(0, 0), box(0.5, 0.5)], 2, 1.75),
    "a cross": ([box(0, 1, 3, 1), box(1, 0, 1, 3)], 6, 5),
    "inside": ([box(0, 0, 3, 3), box(1, 1)], 10, 9),
    "inside, at a corner": ([box(0, 0, 3, 3), box(0, 0)], 10, 9),
    "inside, along an edge": ([box(0, 0, 3, 3), box(1, 0)], 10, 9),
    "through a vertex": ([box(0, 0, 2, 2), [[1, 1], [2, 0], [3, 1], [2, 2]]], 6, 5),
    "inside a mesh with a hole": ([*frame(0, 0, 2, 6), box(0.5, 2, 1, 1)], 33, 32),
    "over a hole": ([*frame(0, 0, 1, 3), box(0.5, 0.5, 2, 2)], 12, 9),
    "three deep": ([box(0, 0, 5, 5), box(1, 1, 3, 3), box(2, 2)], 35, 25),
    "one of many": ([box(2 * x, 2 * y) for x in range(9) for y in range(9)] + [box(4.5, 4.5)], 82, 81.75),
}


@pytest.mark.parametrize("angle", [0, 0.3])
@pytest.mark.parametrize("allow_gaps", [False, True])
@pytest.mark.parametrize("name", OVERLAPS)
def test_cells_that_overlap_are_warned_about_with_measures(
    name: str, allow_gaps: bool, angle: float, caplog: pytest.LogCaptureFixture
) -> None:
    cells, total, union = OVERLAPS[name]
    mesh = soup(turned(cells, angle), allow_gaps=allow_gaps)
    assert mesh.n_cells == len(cells)
    assert double_covers(caplog) == [pytest.approx((total, union, total - union), rel=1e-9)]


def test_the_warning_names_measures_and_ways_out(caplog: pytest.LogCaptureFixture) -> None:
    soup([box(0, 0), box(0.5, 0.5)])
    assert caplog.messages == [
        "cells overlap: their total measure is 2, that of their union 1.75, so 0.25 is counted twice. "
        "strict=True reports the cells. In a periodic mesh, give cells that wrap around separate points on "
        "the far side"
    ]
    with pytest.raises(MeshError, match="cells 0, 1 overlap a neighbour"):
        soup([box(0, 0), box(0.5, 0.5)], strict=True)


def test_polygons_of_shapely_are_examined_too(caplog: pytest.LogCaptureFixture) -> None:
    mesh_from_shapely([shapely.box(0, 0, 3, 3), shapely.box(1, 1, 2, 2)])
    assert double_covers(caplog) == [pytest.approx((10, 9, 1))]
    hole = shapely.box(0, 0, 3, 3) - shapely.box(1, 1, 2, 2)
    mesh_from_shapely([hole, shapely.box(1, 1, 2, 2)])
    assert len(double_covers(caplog)) == 1


CHECKERBOARD = [box(x, y) for x in range(6) for y in range(6) if (x + y) % 2]
FINE = {
    "apart": [box(2 * x, 2 * y) for x in range(5) for y in range(5)],
    "a checkerboard": CHECKERBOARD,
    "an annulus": frame(0, 0, 1, 3),
    "an island in the hole": [*frame(0, 0, 3, 5), box(2, 2)],
    "an island that touches the hole at a corner": [*frame(0, 0, 3, 5), box(1, 1)],
    "an island that fills the hole": [*frame(0, 0, 1, 3), box(1, 1)],
    "rings in rings": [*frame(0, 0, 6, 8), *frame(2, 2, 2, 4), box(3.5, 3.5)],
    "neighbours": [box(x, y) for x in range(4) for y in range(4)],
    "hanging vertices": [box(0, 0, 3, 3), *(box(3, y) for y in range(3)), box(0, 3, 1.7), box(1.7, 3, 2.3)],
    "a crack": [SLOT],
    "halves of boxes": [box(x, y, 1, 0.5) for x in range(3) for y in (0, 0.5, 1, 2, 2.5)],
    "almost neighbours": [box(0, 0, 4, 4), *(box(4 - 1e-9, y) for y in range(4))],
    "thin": [box(0, 0, 1, 1e-7), box(0, 1e-7, 1, 1e-7)],
}  # fmt: skip


@pytest.mark.parametrize("angle", [0, 0.3])
@pytest.mark.parametrize("allow_gaps", [False, True])
@pytest.mark.parametrize("name", FINE)
def test_cells_that_only_touch_are_not_warned_about(
    name: str, allow_gaps: bool, angle: float, caplog: pytest.LogCaptureFixture
) -> None:
    cells = FINE[name]
    mesh = soup(turned(cells, angle), allow_gaps=allow_gaps, weak=name == "a crack")
    assert mesh.cell_measures == pytest.approx([shapely.Polygon(cell).area for cell in cells])
    assert double_covers(caplog) == []


@pytest.mark.parametrize("name", ["squares:6", "voronoi:80", "ring:12", "disconnected:3", "brain_holes"])
def test_samples_are_not_warned_about(name: str, caplog: pytest.LogCaptureFixture) -> None:
    mesh = samples.from_spec(name)
    loops = mesh.boundary_loops
    again = Mesh.from_polygons(mesh.points, (loops.loop_offsets, loops.vertices))
    assert again.n_cells == mesh.n_cells
    assert double_covers(caplog) == []


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 6), st.integers(0, 6), st.integers(1, 3), st.integers(1, 3)),
        min_size=1,
        max_size=7,
        unique=True,
    ),
    st.booleans(),
)
def test_boxes_are_covered_twice_where_shapely_says_so(
    boxes: list[tuple[int, ...]], with_frame: bool
) -> None:
    """On a lattice, where edges, corners and holes lie on one another exactly."""
    cells = [box(*each) for each in boxes] + (frame(1, 1, 3, 5) if with_frame else [])
    mesh = soup(cells, allow_gaps=True)
    polygons = shapely.polygons(cells)
    excess = shapely.area(polygons).sum() - shapely.union_all(polygons, grid_size=2.0**-20).area
    outer = frozen_int(mesh.face_pairs[mesh.outer_faces])
    assert double_cover._covers_twice(mesh.points, outer) == (excess > 0.1)


@settings(max_examples=40, deadline=None)
@given(st.permutations(range(12)))
def test_loops_are_walked_face_by_face(follower: list[int]) -> None:
    order, starts = double_cover._loops(frozen_int(follower))
    loops = [loop.tolist() for loop in np.split(order, starts[1:])]
    slow, left = [], set(range(len(follower)))
    while left:
        loop = [min(left)]
        while follower[loop[-1]] != loop[0]:
            loop.append(follower[loop[-1]])
        slow.append(loop)
        left -= set(loop)
    assert loops == slow


def test_solids_are_not_examined(caplog: pytest.LogCaptureFixture) -> None:
    mesh = samples.boxes(2)
    double_cover.warn_of_double_cover(mesh)
    assert caplog.messages == []
