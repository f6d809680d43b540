"""Standard test cases for each component kind, on small meshes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import Float, Int, UInt64, frozen, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_cases import in_space, of_one_cell, on_meshes
from agglo_core.conformance.inputs.multigrid_cases import PARTS, on_levels
from agglo_core.conformance.inputs.unusual_graphs import fresh, level_in_space, ragged_level_in_space, tower
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Linear
from agglo_core.protocols import Target

_ABOUT_MESHES = ("format", "problem", "discretisation", "constraint", "section")


def cases(kind: str, seed: int = 0) -> list[Case]:
    """Return the standard test cases for a kind of component, on 2-D meshes."""
    if kind == "solver":
        return _problems()
    if kind in ("smoother", *PARTS):
        return on_levels(kind)
    if kind == "sample":
        return [Case("it", ())]
    if kind in _ABOUT_MESHES:
        return on_meshes(kind)
    meshes = small_meshes.plane_meshes()
    if kind == "bisector":
        return [Case(mesh.name, (mesh.graph, seeds_for(1, seed))) for mesh in meshes]
    if kind == "metric":
        return [
            Case(mesh.name, (mesh, stripes(mesh.graph, 3))) for mesh in [*meshes, small_meshes.two_grids()]
        ]
    return [
        labelled_case(kind, mesh.graph, mesh.name, labels(mesh.graph), target, seed)
        for mesh in meshes
        for labels, target in ((_halves, "count"), (_quarters, "size"), (_scatter_labels, "both"))
    ]


def cases_in_3d(kind: str) -> list[Case]:
    """Return the standard 3-D test cases for a kind of component.

    The list is empty for kinds without mesh or graph.
    """
    if kind in _ABOUT_MESHES:
        return in_space(kind)
    if kind in ("smoother", "sample", *PARTS):
        return []
    # Graphs for bisectors, refiners and fixers; metrics and solvers get a mesh of boxes.
    mesh = small_meshes.boxes()
    graphs = {
        "3-D boxes": mesh.graph,
        "a column of boxes": fresh(tower()),
        "a level in 3-D": fresh(level_in_space()),
        "tetrahedra": small_meshes.solids()[1].graph,
    }
    if kind == "bisector":
        return [Case(name, (graph, seeds_for(graph.n_blocks))) for name, graph in graphs.items()]
    if kind == "metric":
        return [Case("3-D boxes", (mesh, stripes(mesh.graph, 3)))]
    if kind == "solver":
        hierarchy = _hierarchy(mesh, stripes(mesh.graph, 4))
        return [
            Case("3-D boxes", (problem, hierarchy)) for problem in (Diffusion(), laplacian(mesh.graph, 1))
        ]
    ragged, labels = ragged_level_in_space()
    return [
        labelled_case(kind, graph, name, labelled(graph), target)
        for name, graph in graphs.items()
        for labelled, target in ((_halves, "size"), (_scatter_labels, "count"))
    ] + [labelled_case(kind, ragged, "a level of pieces of tetrahedra", labels, "both")]


def tiny(kind: str) -> list[Case]:
    """Return degenerate test cases: single cells, coincident centroids, interfaces of measure zero."""
    if kind in _ABOUT_MESHES:
        return of_one_cell(kind)
    if kind in ("smoother", *PARTS):
        return on_levels(kind, degenerate=True)
    if kind == "sample":
        return []
    if kind == "solver":
        hierarchy = _hierarchy(small_meshes.grid(1, 1), frozen_int([0]))
        return [
            Case("one cell", (problem, hierarchy)) for problem in (Diffusion(), laplacian(hierarchy.graph, 1))
        ]
    if kind == "metric":
        return [
            Case("one cell", (small_meshes.grid(1, 1), frozen_int([0]))),
            Case("every cell alone", (small_meshes.grid(3, 2), frozen_int(np.arange(6)))),
            Case(
                "all cells in one",
                (small_meshes.mixed_polygons(), frozen_int(np.zeros(small_meshes.mixed_polygons().n_cells))),
            ),
        ]
    # Bisectors, refiners and fixers: short chains, coincident cells, interfaces without measure.
    graphs = {
        "one cell": small_meshes.line(1),
        "two cells": small_meshes.line(2),
        "three cells": small_meshes.line(3),
        "eight cells in the same place": small_meshes.coincident(8),
        "eight cells whose interfaces have no measure": small_meshes.line(8, interface=0.0),
    }
    if kind == "bisector":
        return [Case(name, (graph, seeds_for(1))) for name, graph in graphs.items()]
    return [
        labelled_case(kind, graph, name, frozen_int(np.arange(graph.n) % 2), "both")
        for name, graph in graphs.items()
    ]


def level_case(kind: str) -> Case:
    """Return a test case on a graph whose blocks have very different sizes.

    For refiners and fixers with 1 to 3 parts per block.
    """
    level = small_meshes.level()
    if kind == "bisector":
        return Case("a level", (level, seeds_for(level.n_blocks)))
    labels = np.concatenate(
        [
            np.arange(size) * (1 + b % 3) // size if b % 2 else np.arange(size) // 4 % (1 + b % 3)
            for b, size in enumerate(np.diff(level.offsets))
        ]
    )
    labels[: level.offsets[1]] = np.arange(level.offsets[1]) // 80 % 7 % 3
    return labelled_case(kind, level, "a level", frozen_int(labels), "count")


def part_of_level(case: Case, blocks: ArrayLike) -> Case:
    """Restrict a test case on a graph of several blocks to the given blocks, in this order."""
    graph, block_indices = case.given[0], np.asarray(blocks)
    nodes = np.concatenate([np.arange(graph.offsets[b], graph.offsets[b + 1]) for b in block_indices])
    counts = {graph.n: nodes, graph.n_blocks: block_indices}
    arguments = [
        frozen(value[counts[len(value)]], value.dtype) if isinstance(value, np.ndarray) else value
        for value in case.given[1:]
    ]
    return Case(case.name, (graph.take(block_indices), *arguments))


def seeds_for(blocks: int, seed: int = 0) -> UInt64:
    """Return a random seed for each block ``(B,)``.

    The first seed is at least 2^63, like half of the seeds in a run.
    """
    values = np.random.default_rng(seed).integers(2**64, size=blocks, dtype=np.uint64)
    values[:1] |= np.uint64(2**63)
    seeds: UInt64 = frozen(values, np.uint64)
    return seeds


def stripes(graph: Graph, parts: int) -> Int:
    """Return labels of strips with equal cell counts, cut across the longest axis."""
    axis = int(np.argmax(np.ptp(graph.centroids, axis=0)))
    rank = np.argsort(np.argsort(graph.centroids[:, axis], kind="stable"))
    return frozen_int(np.unique(rank * min(parts, graph.n) // graph.n, return_inverse=True)[1])


def laplacian(graph: Graph, per_cell: int, shift: float = 0.1) -> Linear:
    """Return a linear system with a shifted graph Laplacian, for ``per_cell`` unknowns per cell.

    With ``shift=0`` it is singular.
    """
    adjacency = graph.to_scipy()
    diagonal = adjacency.sum(axis=1) + shift
    scalar = sparse.diags_array(diagonal) - adjacency
    A = sparse.csr_array(sparse.kron(scalar, sparse.eye_array(per_cell)))
    b: Float = frozen(1.0 + np.arange(A.shape[0]) / A.shape[0], np.float64)
    return Linear(A, b, frozen_int(np.arange(graph.n + 1) * per_cell))


def with_problem(case: Case, **changes: Any) -> Case:
    """Replace some attributes of the problem in a test case for a solver."""
    problem, hierarchy = case.given
    return replace(case, given=(replace(problem, **changes), hierarchy))


def labelled_case(kind: str, graph: Graph, name: str, labels: Int, told: str, seed: int = 0) -> Case:
    """Return a test case for a refiner or fixer, with the given part labels.

    ``told`` selects the target: "count", "size" or "both". As in runs, the part count refers to the
    whole mesh, and exceeds the part count here.
    """
    if kind == "fixer":
        return Case(name, (graph, labels))
    # Number of distinct (block, label) pairs, plus a margin of 2.
    parts = len(np.unique(labels + (int(labels.max()) + 1) * graph.block_ids)) + 2
    size = 0.4 * float(np.linalg.norm(np.ptp(graph.points, axis=0)))
    target = Target(None if told == "size" else parts, None if told == "count" else size)
    return Case(name, (graph, labels, seeds_for(graph.n_blocks, seed), target))


def _halves(graph: Graph) -> Int:
    return _stripe_blocks(graph, 2)


def _quarters(graph: Graph) -> Int:
    return _stripe_blocks(graph, 4)


def _stripe_blocks(graph: Graph, parts: int) -> Int:
    return frozen_int(np.concatenate([stripes(graph[b], parts) for b in range(graph.n_blocks)]))


def _scatter_labels(graph: Graph) -> Int:
    """Return random labels 0, 1, 2, so that parts are disconnected.

    The first cells of each block ensure that each label occurs.
    """
    labels = np.random.default_rng(graph.n).integers(min(3, graph.n), size=graph.n)
    for first, stop in zip(graph.offsets[:-1], graph.offsets[1:], strict=True):
        labels[first:stop][:3] = np.arange(min(3, stop - first))
    return frozen_int(labels)


def _problems() -> list[Case]:
    mesh = small_meshes.grid(8, 8)
    column, row = np.arange(64) % 8, np.arange(64) // 8
    four, two = row // 2 * 4 + column // 2, row // 4 * 2 + column // 4
    hexagons, jittered = small_meshes.hexagons(5, 4), small_meshes.grid(9, 7, jitter=0.2)
    waves = Diffusion(source=lambda x: np.sin(x[:, 0]) + x[:, 1])
    return [
        Case("diffusion on squares, two levels", (Diffusion(), _hierarchy(mesh, four, two))),
        Case("diffusion on hexagons", (waves, _hierarchy(hexagons, stripes(hexagons.graph, 4)))),
        Case("diffusion on quadrilaterals", (waves, _hierarchy(jittered, stripes(jittered.graph, 6)))),
        Case("a linear system on squares", (laplacian(mesh.graph, 1), _hierarchy(mesh, four, two))),
        Case("a linear system of three per cell", (laplacian(mesh.graph, 3), _hierarchy(mesh, four))),
    ]


def _hierarchy(mesh: Mesh, *levels: Int) -> Hierarchy:
    targets = [{"n_parts": int(labels.max()) + 1} for labels in levels]
    return Hierarchy(mesh, mesh.graph, list(levels), targets, nested=True)
