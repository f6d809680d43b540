"""Questions to metrics beyond the ordinary ones: troublesome shapes, sizes and numbers of parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_changes import Change, moved, renumbered, turned_over
from agglo_core.mesh import Mesh


def by_hand() -> list[Case]:
    """Parts whose values are worked out by hand in :data:`.metric_values.HAND`."""
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
