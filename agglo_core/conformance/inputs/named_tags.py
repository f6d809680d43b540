"""Test cases on meshes with several tags, to detect a dependence on the random order of sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import labelled_case, seeds_for
from agglo_core.conformance.inputs.solver_cases import on_levels
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion

_NAMES: Sequence[Sequence[str]] = (
    ("material", "layer", "zone"),
    ("porosity", "rock", "age"),
    ("inflow", "wall", "outlet"),
    ("one", "two", "three"),
    ("a", "b", "c"),
    ("north", "south", "west"),
)
"""Tag names; the first element of each set agrees in two processes by chance once in 700 times."""


def with_tags(kind: str) -> list[Case]:
    """Return test cases on small meshes with three cell tags and three face tags.

    Smoothers get none.
    """
    return [] if kind == "smoother" else [_case_on(kind, _mesh_with_tags(names)) for names in _NAMES]


def _mesh_with_tags(names: Sequence[str]) -> Mesh:
    mesh, rng = small_meshes.grid(5, 4, jitter=0.2), np.random.default_rng(12)
    outside = mesh.face_cells[:, 1] < 0
    return replace(
        mesh,
        name=f"a mesh with the tags {', '.join(names)}",
        cell_tags={name: rng.integers(3, size=mesh.n_cells) for name in names},
        face_tags={name: np.where(outside, rng.integers(1, 3, mesh.n_faces), 0) for name in names},
    )


def _case_on(kind: str, mesh: Mesh) -> Case:
    halves = frozen_int(np.arange(mesh.n_cells) * 2 // mesh.n_cells)
    if kind == "metric":
        return Case(mesh.name, (mesh, frozen_int(np.arange(mesh.n_cells) // 5)))
    if kind == "solver":
        name = next(iter(mesh.face_tags))
        values = {tag: float(tag) for tag in (1, 2)}
        return Case(mesh.name, (Diffusion(2.0, 1.0, values, boundary=name), on_levels(mesh, halves)))
    graph: Graph = mesh.graph
    carried = {name: frozen_float(np.asarray(tag, float)) for name, tag in mesh.cell_tags.items()}
    graph = replace(graph, data=carried)
    if kind == "bisector":
        return Case(mesh.name, (graph, seeds_for(1)))
    return labelled_case(kind, graph, mesh.name, halves, "both")
