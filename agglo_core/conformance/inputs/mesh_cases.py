"""Test cases on whole meshes: for formats, problems, discretisations, estimators and more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.drawn import PLANE, DrawnMesh
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure import RunResult, measure_levels
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Problem, Solution, solve

TAG = "region"
"""Name of the tag in cases for formats, which have it on cells, and constraints, also on faces."""

UNSAFE = '<b id="it\'s">R&D</b>'
"""Name of a mesh and a run, with characters that a report section must escape."""


def on_meshes(kind: str) -> list[Case]:
    """Return the test cases on 2-D meshes for a kind of component."""
    if kind == "section":
        return [
            report_case(small_meshes.grid(6, 4)),
            report_case(replace(small_meshes.mixed_polygons(), name=UNSAFE)),
        ]
    if kind != "format":
        return [_case_on(kind, DrawnMesh(family, cells=20, jitter=0.25).mesh) for family in PLANE]
    # Formats: triangles, tagged quadrilaterals, mixed polygons, and a cell with a hole.
    around = np.ones((5, 5), int)
    around[1:4, 1:4] = 0
    meshes = [
        replace(small_meshes.halved_squares(), name="triangles"),
        tag_cells(small_meshes.grid(6, 4, jitter=0.2)),
        small_meshes.mixed_polygons(),
        replace(small_meshes.grid(5, 5).coarsen(frozen_int(around.ravel())), name="a cell with a hole"),
    ]
    return [_case_on(kind, mesh) for mesh in meshes]


def in_space(kind: str) -> list[Case]:
    """Return the test cases on 3-D meshes for a kind of component.

    Formats also get tetrahedra, because some formats support nothing else.
    """
    boxes = _case_on(kind, replace(small_meshes.boxes(3, 2, 2), name="3-D boxes"))
    return [boxes, _case_on(kind, small_meshes.tetrahedra())] if kind == "format" else [boxes]


def of_one_cell(kind: str) -> list[Case]:
    """Return a test case on a mesh with a single cell."""
    return [_case_on(kind, replace(small_meshes.grid(1, 1), name="one cell"))]


def bands(mesh: Mesh, parts: int) -> Int:
    """Return labels of strips with equal cell counts, cut across the longest axis."""
    centres = mesh.local_centroids
    axis = int(np.argmax(np.ptp(centres, axis=0)))
    rank = np.argsort(np.argsort(centres[:, axis], kind="stable"), kind="stable")
    return frozen_int(rank * min(parts, mesh.n_cells) // mesh.n_cells)


def tag_cells(mesh: Mesh) -> Mesh:
    """Return the mesh with the cell tag :data:`TAG`: 1 in one half, 2 in the other."""
    return replace(mesh, cell_tags={TAG: 1 + bands(mesh, 2)})


def tag_cells_and_faces(mesh: Mesh) -> Mesh:
    """Return the mesh with the tag :data:`TAG` on cells and faces.

    Faces have tag 1 between the halves, and 2 or 3 on the boundary.
    """
    mesh = tag_cells(mesh)
    halves, (owner, neighbour) = mesh.cell_tags[TAG], mesh.face_cells.T
    faces = np.where(neighbour < 0, 1 + halves[owner], halves[owner] != halves[neighbour])
    return replace(mesh, face_tags={TAG: faces})


def _case_on(kind: str, mesh: Mesh) -> Case:
    arguments: Sequence[object] = (mesh,)
    if kind == "format":
        arguments = (mesh, "")
    elif kind == "constraint":
        arguments = (tag_cells_and_faces(mesh), bands(mesh, 3))
    elif kind == "discretisation":
        arguments = (Diffusion(source=lambda x: 1.0 + x[:, 0]), mesh)
    elif kind == "estimator":
        arguments = (solved(Diffusion(source=lambda x: 1.0 + x[:, 0]), mesh),)
    elif kind == "section":
        return report_case(mesh)
    return Case(mesh.name, tuple(arguments))


def solved(problem: Problem, mesh: Mesh) -> Solution:
    """Return the solution by elimination, which has no error of iteration."""
    return solve(mesh, problem, "direct")


def report_case(mesh: Mesh, unsafe: str = UNSAFE, *, completed: bool = True) -> Case:
    """Return a test case for report sections: a completed run with two levels, and a failed run."""
    levels = [bands(mesh, 4), bands(mesh, 4) // 2]
    targets = [{"n_parts": int(labels.max()) + 1} for labels in levels]
    hierarchy = Hierarchy(mesh, mesh.graph, levels, targets, nested=True)
    runs = [
        RunResult(mesh.name, hierarchy, measure_levels(mesh, hierarchy), 0.25, cpu_seconds=0.25),
        RunResult(f"another {unsafe}", None, error=f"it could not be run on {unsafe}"),
    ]
    return Case(f"a report on {mesh.name!r}", (mesh, runs if completed else runs[1:]))
