"""Test cases for the laws of quality metrics, and metric values computed by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi, sqrt
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_changes import Change, renumber_mesh, transform_mesh, turn_inner_faces
from agglo_core.mesh import Mesh

_OWN: Final[Mapping[str, Sequence[Sequence[float]]]] = {
    "UF": ((1, 1, 1, 1), (sqrt(0.2), 1), (1, 0.5), (0.6, 1), (sqrt(10 / 26), 1), (1, 1)),
    "CR": (
        (sqrt(0.5),) * 4,
        (sqrt(0.5), sqrt(0.1)),
        (sqrt(2) - 1, sqrt(0.5)),
        (sqrt(0.5), (2 * sqrt(2) - 2) / 5),
        (sqrt(1 / 10), sqrt(1 / 26)),
        (sqrt(1 / 8),) * 2,
    ),
    "CRc": (
        (sqrt(0.5),) * 4,
        (sqrt(0.5), sqrt(0.1)),
        (1 / 6, sqrt(0.5)),
        (sqrt(0.5), 0),
        (sqrt(0.1), 0),
        (0, 0),
    ),
    "interface_length": ((4, 4, 4, 4), (1, 1), (2, 2), (12, 12), (2, 2), (4, 4)),
    "cut": ((4, 4, 4, 4), (1, 1), (2, 2), (12, 12), (2, 2), (4, 4)),
    "ncut": ((1 / 3,) * 4, (1, 1 / 5), (1 / 3, 1), (1 / 3, 3 / 11), (1 / 3, 1), (1, 1)),
    "components": ((1, 1, 1, 1), (1, 1), (1, 1), (1, 1), (1, 2), (2, 2)),
    "cells": ((4, 4, 4, 4), (1, 3), (3, 1), (9, 16), (3, 2), (2, 2)),
    "J": (
        (3 / pi,) * 4,
        (3 / pi, 9 / (5 * pi)),
        (27 / (11 * pi), 3 / pi),
        (3 / pi, 24 / (17 * pi)),
        (9 / (5 * pi), 6 / (25 * pi)),
        (3 / (2 * pi),) * 2,
    ),
    "isoperimetric": (
        (pi / 4,) * 4,
        (pi / 4, 3 * pi / 16),
        (3 * pi / 16, pi / 4),
        (pi / 4, pi / 16),
        (3 * pi / 16, pi / 8),
        (pi / 8, pi / 8),
    ),
    "convexity": ((1, 1, 1, 1), (1, 1), (6 / 7, 1), (1, 16 / 25), (1, 2 / 5), (2 / 3, 2 / 3)),
    "star_shapedness": ((1, 1, 1, 1), (1, 1), (1 / 3, 1), (1, 0), (1, 0), (0, 0)),
    "box_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1, 1), (1, 1), (1 / 3, 1 / 5), (1 / 2, 1 / 2)),
    "edge_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1 / 2, 1), (1, 3 / 5), (1 / 3, 1), (1, 1)),
    "face_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1 / 2, 1), (1, 3 / 5), (1 / 3, 1), (1, 1)),
}

PLAIN: Final[Mapping[str, Sequence[Sequence[float]]]] = {
    "area": ((4, 4, 4, 4), (1, 3), (3, 1), (9, 16), (3, 2), (2, 2)),
    "perimeter": ((8, 8, 8, 8), (4, 8), (8, 4), (12, 32), (8, 8), (8, 8)),
    "diameter": (
        (sqrt(8),) * 4,
        (sqrt(2), sqrt(10)),
        (sqrt(8), sqrt(2)),
        (sqrt(18), sqrt(50)),
        (sqrt(10), sqrt(26)),
        (sqrt(8), sqrt(8)),
    ),
    "solidity": _OWN["convexity"],
    "polsby_popper": _OWN["isoperimetric"],
    "isoperimetric_quotient": _OWN["isoperimetric"],
}
"""Values for metrics whose name has a single common meaning."""

HAND: Final = {**_OWN, **PLAIN}
"""Values computed by hand for the cases of :func:`agglo_core.conformance.inputs.metric_cases.by_hand`.

The keys are metric names. The cases are: four squares of 2 by 2 cells; a square and a 3 by 1 bar; an L of
three squares around a square; a 3 by 3 square in a ring of width one; a 3 by 1 bar between two squares that
form one part; two parts, each of two squares that touch in a point.
"""


def shapes() -> list[Case]:
    """Return test cases with round, thin or pointed parts, and parts that are whole connected components."""
    two_grids = small_meshes.two_grids()
    component = two_grids.graph.components()
    second = component == component[-1]
    cut = np.where(second, 1 + (np.cumsum(second) > np.count_nonzero(second) // 2), 0)
    return [
        Case("a cell of 60 sides", (_polygon(np.ones(60)), frozen_int([0]))),
        Case("a star", (_polygon(np.resize([1.0, 0.1], 14)), frozen_int([0]))),
        Case("needles", (small_meshes.grid(3, 2, height=1e-4), frozen_int(np.arange(6)))),
        Case(
            "a part that is a component, next to parts of the other component", (two_grids, frozen_int(cut))
        ),
        Case("two components, each a part", (two_grids, frozen_int(component))),
    ]


def bodies() -> list[Case]:
    """Return 3-D test cases: extreme shapes, whole connected components, and a shell around another part."""
    shell = np.ones(27)
    shell[13] = 0
    box_row = small_meshes.boxes(5, 1, 1, without=(2,))
    return [
        Case("a globe", (_globe(8, 16), frozen_int([0]))),
        Case("a needle and a plate", (_thin_boxes(), frozen_int([0, 0, 1, 1]))),
        Case("a shell around a box", (small_meshes.boxes(3, 3, 3), frozen_int(shell))),
        Case("boxes in two components, one a part", (box_row, frozen_int([0, 0, 1, 2]))),
        Case("boxes in two components, each a part", (box_row, frozen_int([0, 0, 1, 1]))),
        Case("a part of two boxes that do not touch", (box_row, frozen_int([0, 1, 0, 2]))),
    ]


def ring_case() -> Case:
    """Return a test case with a part close to a disc, inside a part that is a thin ring."""
    return Case("a disc in a thin ring", _disc(24))


def many_alone() -> Case:
    """Return a test case with more than a thousand single-cell parts, labelled in random order."""
    mesh = small_meshes.grid(40, 30, jitter=0.2)
    names = np.random.default_rng(11).permutation(mesh.n_cells)
    return Case(f"{mesh.n_cells} parts of one cell", (mesh, frozen_int(names)))


def cut_finer(case: Case) -> Case:
    """Refine the convex 2-D cells of a test case without changing its parts.

    Each cell is cut into quadrilaterals around its centroid, and each face is halved, also on part
    outlines.
    """
    # Unique edges of all cells.
    mesh, labels = case.given
    loops = mesh.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    ends = np.concatenate([np.stack((cell, np.roll(cell, -1)), axis=1) for cell in cells])
    edges, edge = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    # New points: the midpoint of each edge, and the centroid of each cell.
    owner = np.repeat(np.arange(mesh.n_cells), [len(cell) for cell in cells])
    first = mesh.n_points + edge.ravel()  # midpoint of the edge after each corner
    last = np.concatenate([np.roll(loop, 1) for loop in np.split(first, loops.loop_offsets[1:-1])])
    centre = mesh.n_points + len(edges) + owner
    points = np.concatenate((mesh.points, mesh.points[edges].mean(axis=1), mesh.cell_centroids))
    # A quadrilateral per corner: corner, next midpoint, centroid, previous midpoint.
    corners = np.stack((ends[:, 0], first, centre, last), axis=1)
    finer = Mesh.from_polygons(points, corners, name=f"{mesh.name}, cut finer")
    return Case(f"{case.name}, its cells cut in quadrilaterals", (finer, frozen_int(labels[owner])))


def cut_finer_in_space() -> tuple[Case, Case]:
    """Return a test case with irregular parts of boxes, and the same case with each box cut into eight."""
    coarse, fine = small_meshes.boxes(4, 3, 2), small_meshes.boxes(4, 3, 2, cuts=2)
    labels = np.resize([0, 0, 1, 2, 2, 1, 1], coarse.n_cells).reshape(4, 3, 2)
    finer = labels.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
    return (
        Case("crooked parts of boxes", (coarse, frozen_int(labels.ravel()))),
        Case("crooked parts of boxes, each cut in eight", (fine, frozen_int(finer.ravel()))),
    )


def _polygon(radii: Float) -> Mesh:
    """Return a mesh of a single star-shaped polygon with the given corner radii."""
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    points = radii[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return Mesh.from_polygons(points, [np.arange(len(radii))], name=f"a cell of {len(radii)} sides")


def _disc(n: int) -> tuple[Mesh, Int]:
    """Return a disc with its labels: a fan of triangles (part 0) in a ring of quadrilaterals (part 1)."""
    ring = small_meshes.ring(n)
    radius = np.where(np.arange(2 * n) < n, 1.0, 0.525)[:, None]  # 1 and 1.05
    points = np.concatenate((ring.points * radius, [[0.0, 0.0]]))
    around = ring.boundary_loops.vertices.reshape(n, 4).tolist()
    fan = [[i, (i + 1) % n, 2 * n] for i in range(n)]
    return Mesh.from_polygons(points, [*around, *fan], name="a disc"), frozen_int(np.arange(2 * n) < n)


def _globe(rows: int, around: int) -> Mesh:
    """Return a mesh of one polyhedron inscribed in a sphere, with triangles at the poles, else trapezoids."""
    # Points on circles of latitude, then the two poles.
    polar, turn = np.pi * np.arange(1, rows) / rows, 2 * np.pi * np.arange(around) / around
    theta, phi = np.meshgrid(polar, turn, indexing="ij")
    sphere = np.stack((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1)
    points = np.concatenate((sphere.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    north, south, bottom = len(points) - 2, len(points) - 1, (rows - 2) * around
    # Triangles at both poles, and a column of trapezoids per meridian.
    faces: list[list[int]] = []
    for i in range(around):
        j = (i + 1) % around
        faces += [[north, i, j], [south, bottom + j, bottom + i]]
        faces += [[k + i, k + around + i, k + around + j, k + j] for k in range(0, bottom, around)]
    return Mesh.from_polyhedra(points, [faces], name="a globe")


def _thin_boxes() -> Mesh:
    """Return a mesh of four boxes in a row, stretched by 1000 along x and by 0.001 along z."""
    mesh = small_meshes.boxes(4, 1, 1)
    return replace(mesh, points=mesh.points * np.array([1e3, 1.0, 1e-3]), name="thin boxes")


def by_hand() -> list[Case]:
    """Return the test cases whose metric values have been computed by hand (:data:`HAND`)."""
    row, column = np.divmod(np.arange(16), 4)
    ring = np.ones((5, 5), int)
    ring[1:4, 1:4] = 0
    return [
        Case("four squares", (small_meshes.grid(4, 4), frozen_int(row // 2 * 2 + column // 2))),
        Case("a square and a bar", (small_meshes.grid(4, 1), frozen_int([0, 1, 1, 1]))),
        Case("an L and a square", (small_meshes.grid(2, 2), frozen_int([0, 0, 0, 1]))),
        Case("a square with a ring around it", (small_meshes.grid(5, 5), frozen_int(ring.ravel()))),
        Case("a bar between two squares", (small_meshes.grid(5, 1), frozen_int([1, 0, 0, 0, 1]))),
        Case("squares that touch in a point", (small_meshes.grid(2, 2), frozen_int([0, 1, 1, 0]))),
    ]


def topology_cases() -> list[Case]:
    """Return test cases with a hole, a point contact, a closed ring, or a disconnected agglomerate."""
    around = np.ones((5, 5), int)
    around[1:4, 1:4] = 0
    loose = (np.arange(9) % 8 == 0).astype(int)
    return [
        Case("an agglomerate with a hole", (small_meshes.grid(5, 5), frozen_int(around.ravel()))),
        Case("agglomerates that touch in a point", (small_meshes.grid(2, 2), frozen_int([0, 1, 1, 0]))),
        Case("a closed ring", (small_meshes.ring(12), frozen_int(np.zeros(12)))),
        Case("an agglomerate in loose pieces", (small_meshes.grid(3, 3), frozen_int(loose))),
    ]


def various_cases() -> list[Case]:
    """Return test cases with graded and tagged cells, many parts, single-cell parts, or irregular parts."""
    grid = small_meshes.grid(20, 20, jitter=0.2)
    row, column = np.divmod(np.arange(grid.n_cells), 20)
    grid_labels = np.where(row < 14, np.arange(grid.n_cells), 280 + (row - 14) // 2 * 5 + column // 4)
    strip = small_meshes.grid(50, 2, height=0.7, jitter=0.15)
    strip_labels = np.where(np.arange(100) < 50, 0, np.arange(100) - 49)
    i, j = np.divmod(np.arange(63), 7)
    crooked_labels = np.array([0, 1, 1, 0, 2, 2, 0])[(i + j // 2) % 7] + 3 * (i > 6)
    return [
        Case("tagged cells of unequal sizes", (_graded_mesh(), _shuffle_labels(np.arange(63) * 11 // 63))),
        Case("295 parts, most of one cell", (grid, _shuffle_labels(grid_labels))),
        Case("a long part next to fifty cells", (strip, frozen_int(strip_labels))),
        Case("crooked parts", (small_meshes.grid(7, 9, jitter=0.2), _shuffle_labels(crooked_labels))),
        *(case for case in topology_cases() if "point" not in case.name),
    ]


def solids() -> list[Case]:
    """Return 3-D test cases on boxes: slabs, irregular parts with a hole, and single-cell parts."""
    mesh = small_meshes.boxes()
    rng = np.random.default_rng(2)
    slabs = np.arange(30) // 6
    crooked = np.concatenate([[0, 1, 2], rng.integers(3, size=27)])
    return [
        Case("slabs of 3-D boxes", (mesh, _shuffle_labels(slabs))),
        Case("crooked parts of 3-D boxes", (mesh, frozen_int(crooked))),
        Case("3-D boxes, each alone", (mesh, _shuffle_labels(np.arange(30)))),
    ]


def transform_case(case: Case, change: Change | None) -> tuple[Case, Int]:
    """Transform or renumber the mesh of a test case, and return also the old index per cell.

    If ``change`` is None, cells, faces and points are renumbered, and about half of the inner faces are
    reversed.
    """
    mesh, labels = case.given
    if change is not None:
        transformed_case = replace(case, given=(transform_mesh(mesh, change), labels))
        return transformed_case, frozen_int(np.arange(mesh.n_cells))
    new_mesh, order = renumber_mesh(mesh)
    new_mesh = turn_inner_faces(new_mesh)
    return replace(case, given=(new_mesh, frozen_int(labels[order]))), order


def cells_renumbered(case: Case) -> Case:
    """Permute the cell indices in the mesh of a test case, but not labels, points or faces."""
    mesh, labels = case.given
    number = np.append(np.random.default_rng(3).permutation(mesh.n_cells), -1)
    renumbered_mesh = replace(mesh, face_cells=number[mesh.face_cells])
    return Case(f"{case.name}, its cells renumbered and its labels not", (renumbered_mesh, labels))


def far_from_each_other() -> tuple[Case, list[Case]]:
    """Return a strip of ten parts, and variants with other parts at one end.

    Parts 0 to 5 are equal in all variants and do not touch the changed parts.
    """
    mesh = small_meshes.grid(30, 3, jitter=0.2)
    column, row = np.arange(90) % 30, np.arange(90) // 30
    bands = column // 3
    at_end = bands > 6
    variants = {
        "joined": np.where(at_end, 7, bands),
        "cut finer": np.where(at_end, 7 + column - 21 + 9 * row, bands),
        "mixed up": np.where(at_end, 7 + (column + row) % 3, bands),
    }
    strip = Case("a strip", (mesh, frozen_int(bands)))
    return strip, [
        Case(f"a strip, its end {name}", (mesh, frozen_int(labels))) for name, labels in variants.items()
    ]


def layouts(framed: bool) -> tuple[Case, list[Case]]:
    """Return sixteen square parts, and worse parts of equal cell counts: bars, zigzags, scattered cells.

    If ``framed``, part 16 surrounds them, so that no other part touches the boundary.
    """
    width = framed * 2
    mesh = small_meshes.grid(16 + 2 * width, 16 + 2 * width)
    row, column = np.divmod(np.arange(256), 16)
    worse = {
        "bars": row,
        "zigzags": row // 4 * 4 + (column + 2 * (row % 2)) % 16 // 4,
        "loose cells": row % 4 * 4 + column % 4,
    }

    def case(name: str, labels: np.ndarray) -> Case:
        around = np.pad(labels.reshape(16, 16), width, constant_values=16)
        return Case(name, (mesh, frozen_int(around.ravel())))

    squares = case("squares", row // 4 * 4 + column // 4)
    return squares, [case(name, labels) for name, labels in worse.items()]


def _graded_mesh() -> Mesh:
    """Return a mesh of quadrilaterals that grow along the diagonal, with cell and face tags."""
    mesh = small_meshes.grid(9, 7, jitter=0.2)
    graded_mesh = replace(mesh, points=mesh.points * (1.0 + 0.3 * mesh.points), name="graded quadrilaterals")
    sides = np.where(mesh.face_cells[:, 1] < 0, 1 + np.arange(mesh.n_faces) % 2, 0)
    return replace(graded_mesh, cell_tags={"region": np.arange(63) // 20}, face_tags={"boundary": sides})


def _shuffle_labels(labels: np.ndarray) -> Int:
    """Permute the part numbers at random, so that labels do not increase with the cell index."""
    names = np.random.default_rng(len(labels)).permutation(int(labels.max()) + 1)
    return frozen_int(names[labels])
