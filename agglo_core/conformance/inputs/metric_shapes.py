"""Questions to metrics about extreme shapes, whole components, many parts, and cells cut finer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.mesh import Mesh


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
    """The same in 3-D, and a shell: its one part surrounds the other."""
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
    """The same parts of a plane mesh of convex cells, each cut in quadrilaterals about its centre.

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
