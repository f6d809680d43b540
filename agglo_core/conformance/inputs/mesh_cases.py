"""Test cases on whole meshes: for formats, problems, discretisations, estimators and more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.arrays import frozen_int
from agglo_core.conformance.base import Case
from agglo_core.conformance.inputs.drawn import DrawnMesh, drawn_labels
from agglo_core.conformance.inputs.solver_cases import on_levels
from agglo_core.measure import RunResult, measure_levels
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Problem, Solution, solve

TAG = "region"
"""Name of the tag in cases for formats, which have it on cells, and constraints, also on faces."""

UNSAFE = '<b id="it\'s">R&D</b>'
"""Name of a mesh and a run, with characters that a report section must escape."""


def for_files() -> list[Mesh]:
    """Return meshes for formats: triangles, tagged quadrilaterals, mixed polygons, and a cell with a hole."""
    around = np.ones((5, 5), int)
    around[1:4, 1:4] = 0
    return [
        DrawnMesh("triangles", cells=20).mesh,
        tag_cells(DrawnMesh(cells=25, jitter=0.25).mesh),
        DrawnMesh("hanging").mesh,
        replace(DrawnMesh(cells=25).mesh.coarsen(frozen_int(around.ravel())), name="a cell with a hole"),
    ]


def tag_cells(mesh: Mesh) -> Mesh:
    """Return the mesh with the cell tag :data:`TAG`: 1 in one half, 2 in the other."""
    return replace(mesh, cell_tags={TAG: 1 + drawn_labels(mesh.graph, "strips", 2)})


def tag_cells_and_faces(mesh: Mesh) -> Mesh:
    """Return the mesh with the tag :data:`TAG` on cells and faces.

    Faces have tag 1 between the halves, and 2 or 3 on the boundary.
    """
    mesh = tag_cells(mesh)
    halves, (owner, neighbour) = mesh.cell_tags[TAG], mesh.face_cells.T
    faces = np.where(neighbour < 0, 1 + halves[owner], halves[owner] != halves[neighbour])
    return replace(mesh, face_tags={TAG: faces})


def case_on(kind: str, mesh: Mesh) -> Case:
    """Return the test case on a mesh for a kind of component that is called with whole meshes."""
    arguments: Sequence[object] = (mesh,)
    if kind == "format":
        arguments = (mesh, "")
    elif kind == "constraint":
        arguments = (tag_cells_and_faces(mesh), drawn_labels(mesh.graph, "strips", 3))
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
    labels = drawn_labels(mesh.graph, "strips", 4)
    hierarchy = on_levels(mesh, labels, labels // 2)
    runs = [
        RunResult(mesh.name, hierarchy, measure_levels(mesh, hierarchy), 0.25, cpu_seconds=0.25),
        RunResult(f"another {unsafe}", None, error=f"it could not be run on {unsafe}"),
    ]
    return Case(f"a report on {mesh.name!r}", (mesh, runs if completed else runs[1:]))
