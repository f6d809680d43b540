"""Parts on which metrics are judged, and their values worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi, sqrt
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_changes import Change, moved, renumbered, turned_over
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
"""The same of names that mean one thing to everybody."""

HAND: Final = {**_OWN, **PLAIN}
"""Values in the cases :func:`agglo_core.conformance.inputs.metric_cases.by_hand`, by the name of the metric.

Four squares of 2 by 2 cells; a square beside a 3 by 1 bar; an L of three squares around a square; a square
of 3 by 3 in a ring one cell wide; a 3 by 1 bar between the two squares of one part; two parts of two squares
that touch in a point.
"""


def shapes() -> list[Case]:
    """As round, as thin and as pointed as parts may be, and parts that are whole components."""
    apart = small_meshes.apart()
    component = apart.graph.components()
    second = component == component[-1]
    cut = np.where(second, 1 + (np.cumsum(second) > np.count_nonzero(second) // 2), 0)
    return [
        Case("a cell of 60 sides", (_polygon(np.ones(60)), frozen_int([0]))),
        Case("a star", (_polygon(np.resize([1.0, 0.1], 14)), frozen_int([0]))),
        Case("needles", (small_meshes.grid(3, 2, height=1e-4), frozen_int(np.arange(6)))),
        Case("a part that is a component, beside parts of the other", (apart, frozen_int(cut))),
        Case("two components, each a part", (apart, frozen_int(component))),
    ]


def bodies() -> list[Case]:
    """Parts of extreme shape in 3-D, whole components, and a shell: its one part surrounds the other."""
    shell = np.ones(27)
    shell[13] = 0
    apart = small_meshes.boxes(5, 1, 1, without=(2,))
    return [
        Case("a globe", (_globe(8, 16), frozen_int([0]))),
        Case("a needle and a plate", (_flattened(), frozen_int([0, 0, 1, 1]))),
        Case("a shell around a box", (small_meshes.boxes(3, 3, 3), frozen_int(shell))),
        Case("boxes in two components, one a part", (apart, frozen_int([0, 0, 1, 2]))),
        Case("boxes in two components, each a part", (apart, frozen_int([0, 0, 1, 1]))),
        Case("a part of two boxes that do not touch", (apart, frozen_int([0, 1, 0, 2]))),
    ]


def ringed() -> Case:
    """A part that is nearly a disc, in another that is a thin ring."""
    return Case("a disc in a thin ring", _disc(24))


def many_alone() -> Case:
    """More than a thousand cells, each alone, their labels in no order."""
    mesh = small_meshes.grid(40, 30, jitter=0.2)
    names = np.random.default_rng(11).permutation(mesh.n_cells)
    return Case(f"{mesh.n_cells} parts of one cell", (mesh, frozen_int(names)))


def cut_finer(case: Case) -> Case:
    """The parts of a case on finer cells: each convex plane cell is cut in quadrilaterals about its centre.

    Every face is two halves then, those on the outlines of parts too.
    """
    mesh, labels = case.given
    loops = mesh.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    ends = np.concatenate([np.stack((cell, np.roll(cell, -1)), axis=1) for cell in cells])
    edges, edge = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    owner = np.repeat(np.arange(mesh.n_cells), [len(cell) for cell in cells])
    first = mesh.n_points + edge.ravel()  # the middle of the edge after each corner
    last = np.concatenate([np.roll(each, 1) for each in np.split(first, loops.loop_offsets[1:-1])])
    centre = mesh.n_points + len(edges) + owner
    points = np.concatenate((mesh.points, mesh.points[edges].mean(axis=1), mesh.cell_centroids))
    corners = np.stack((ends[:, 0], first, centre, last), axis=1)
    finer = Mesh.from_polygons(points, corners, name=f"{mesh.name}, cut finer")
    return Case(f"{case.name}, its cells cut in quadrilaterals", (finer, frozen_int(labels[owner])))


def cut_finer_in_space() -> tuple[Case, Case]:
    """Crooked parts of boxes, and the same of boxes cut in eight."""
    coarse, fine = small_meshes.boxes(4, 3, 2), small_meshes.boxes(4, 3, 2, cuts=2)
    labels = np.resize([0, 0, 1, 2, 2, 1, 1], coarse.n_cells).reshape(4, 3, 2)
    finer = labels.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
    return (
        Case("crooked parts of boxes", (coarse, frozen_int(labels.ravel()))),
        Case("crooked parts of boxes, each cut in eight", (fine, frozen_int(finer.ravel()))),
    )


def _polygon(radii: Float) -> Mesh:
    """One cell with corners at these distances from its middle."""
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    points = radii[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return Mesh.from_polygons(points, [np.arange(len(radii))], name=f"a cell of {len(radii)} sides")


def _disc(n: int) -> tuple[Mesh, Int]:
    """Triangles about a point, part 0, and quadrilaterals around them, part 1."""
    ring = small_meshes.ring(n)
    radius = np.where(np.arange(2 * n) < n, 1.0, 0.525)[:, None]  # 1 and 1.05
    points = np.concatenate((ring.points * radius, [[0.0, 0.0]]))
    around = ring.boundary_loops.vertices.reshape(n, 4).tolist()
    fan = [[i, (i + 1) % n, 2 * n] for i in range(n)]
    return Mesh.from_polygons(points, [*around, *fan], name="a disc"), frozen_int(np.arange(2 * n) < n)


def _globe(rows: int, around: int) -> Mesh:
    """One cell inscribed in a sphere: triangles at its poles, trapezia between them."""
    polar, turn = np.pi * np.arange(1, rows) / rows, 2 * np.pi * np.arange(around) / around
    theta, phi = np.meshgrid(polar, turn, indexing="ij")
    sphere = np.stack((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), axis=-1)
    points = np.concatenate((sphere.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    north, south, bottom = len(points) - 2, len(points) - 1, (rows - 2) * around
    faces: list[list[int]] = []
    for i in range(around):
        j = (i + 1) % around
        faces += [[north, i, j], [south, bottom + j, bottom + i]]
        faces += [[k + i, k + around + i, k + around + j, k + j] for k in range(0, bottom, around)]
    return Mesh.from_polyhedra(points, [faces], name="a globe")


def _flattened() -> Mesh:
    """Four boxes in a row that is a thousand times as long as wide, then a thousand times as wide as high."""
    mesh = small_meshes.boxes(4, 1, 1)
    return replace(mesh, points=mesh.points * np.array([1e3, 1.0, 1e-3]), name="thin boxes")


def by_hand() -> list[Case]:
    """Parts whose values are worked out by hand in :data:`HAND`."""
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


def holed() -> list[Case]:
    """Agglomerates with a hole, touching in a point, forming a closed ring, and in loose pieces."""
    around = np.ones((5, 5), int)
    around[1:4, 1:4] = 0
    loose = (np.arange(9) % 8 == 0).astype(int)
    return [
        Case("an agglomerate with a hole", (small_meshes.grid(5, 5), frozen_int(around.ravel()))),
        Case("agglomerates that touch in a point", (small_meshes.grid(2, 2), frozen_int([0, 1, 1, 0]))),
        Case("a closed ring", (small_meshes.ring(12), frozen_int(np.zeros(12)))),
        Case("an agglomerate in loose pieces", (small_meshes.grid(3, 3), frozen_int(loose))),
    ]


def various() -> list[Case]:
    """Tagged cells of unequal sizes, many parts, single cells, many neighbours, crooked parts."""
    many = small_meshes.grid(20, 20, jitter=0.2)
    row, column = np.divmod(np.arange(many.n_cells), 20)
    lone = np.where(row < 14, np.arange(many.n_cells), 280 + (row - 14) // 2 * 5 + column // 4)
    long = small_meshes.grid(50, 2, height=0.7, jitter=0.15)
    alone = np.where(np.arange(100) < 50, 0, np.arange(100) - 49)
    i, j = np.divmod(np.arange(63), 7)
    crooked = np.array([0, 1, 1, 0, 2, 2, 0])[(i + j // 2) % 7] + 3 * (i > 6)
    return [
        Case("tagged cells of unequal sizes", (_graded(), _shuffled(np.arange(63) * 11 // 63))),
        Case("295 parts, most of one cell", (many, _shuffled(lone))),
        Case("a long part beside fifty cells", (long, frozen_int(alone))),
        Case("crooked parts", (small_meshes.grid(7, 9, jitter=0.2), _shuffled(crooked))),
        *(case for case in holed() if "point" not in case.name),
    ]


def solids() -> list[Case]:
    """Parts of boxes in 3-D: slabs, crooked ones with a hole, and single cells."""
    mesh = small_meshes.boxes()
    rng = np.random.default_rng(2)
    slabs = np.arange(30) // 6
    crooked = np.concatenate([[0, 1, 2], rng.integers(3, size=27)])
    return [
        Case("slabs of 3-D boxes", (mesh, _shuffled(slabs))),
        Case("crooked parts of 3-D boxes", (mesh, frozen_int(crooked))),
        Case("3-D boxes, each alone", (mesh, _shuffled(np.arange(30)))),
    ]


def changed(case: Case, change: Change | None) -> tuple[Case, Int]:
    """The question about the mesh moved; or, if ``change`` is None, renumbered, with the cells' order.

    Renumbered, about half of the inner faces are seen from their other cell too.
    """
    mesh, labels = case.given
    if change is not None:
        return replace(case, given=(moved(mesh, change), labels)), frozen_int(np.arange(mesh.n_cells))
    there, order = renumbered(mesh)
    there = turned_over(there)
    return replace(case, given=(there, frozen_int(labels[order]))), order


def cells_renumbered(case: Case) -> Case:
    """A question with the same labels, points and faces, in which the cells go by other numbers."""
    mesh, labels = case.given
    number = np.append(np.random.default_rng(3).permutation(mesh.n_cells), -1)
    there = replace(mesh, face_cells=number[mesh.face_cells])
    return Case(f"{case.name}, its cells renumbered and its labels not", (there, labels))


def far_from_each_other() -> tuple[Case, list[Case]]:
    """A strip of ten parts, and the same with the last three cut otherwise.

    Parts 0 to 5 are the same in all, and touch none of those.
    """
    mesh = small_meshes.grid(30, 3, jitter=0.2)
    column, row = np.arange(90) % 30, np.arange(90) // 30
    bands = column // 3
    far = bands > 6
    others = {
        "joined": np.where(far, 7, bands),
        "cut finer": np.where(far, 7 + column - 21 + 9 * row, bands),
        "mixed up": np.where(far, 7 + (column + row) % 3, bands),
    }
    strip = Case("a strip", (mesh, frozen_int(bands)))
    return strip, [Case(f"a strip, its end {how}", (mesh, frozen_int(it))) for how, it in others.items()]


def layouts(framed: bool) -> tuple[Case, list[Case]]:
    """Sixteen squares of sixteen cells each, and worse parts of as many cells: bars, zigzags, loose cells.

    With a frame around them, part 16, none of them touches the boundary.
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


def _graded() -> Mesh:
    """Quadrilaterals that grow from one corner to the other, with tags of cells and faces."""
    mesh = small_meshes.grid(9, 7, jitter=0.2)
    grown = replace(mesh, points=mesh.points * (1.0 + 0.3 * mesh.points), name="graded quadrilaterals")
    sides = np.where(mesh.face_cells[:, 1] < 0, 1 + np.arange(mesh.n_faces) % 2, 0)
    return replace(grown, cell_tags={"region": np.arange(63) // 20}, face_tags={"boundary": sides})


def _shuffled(labels: np.ndarray) -> Int:
    """The labels by other names, so that they do not grow with the number of the cell."""
    names = np.random.default_rng(len(labels)).permutation(int(labels.max()) + 1)
    return frozen_int(names[labels])
