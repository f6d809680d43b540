"""Test cases for each component kind, except those that are drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import UInt64, frozen, frozen_float
from agglo_core.conformance.base import Case
from agglo_core.conformance.inputs.drawn import PLANE, DrawnGraph, DrawnMesh, Layout, drawn_labels
from agglo_core.conformance.inputs.mesh_cases import case_on, for_files
from agglo_core.conformance.inputs.multigrid_cases import (
    PARTS,
    DrawnLevel,
    coarsening_of,
    laplacian_of,
    level_of,
    question,
)
from agglo_core.conformance.inputs.solver_cases import DrawnProblem, on_levels
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion, Linear
from agglo_core.protocols import Target

ON_GRAPHS = ("bisector", "refiner", "fixer")
"""Kinds whose components are called with a graph."""

SIBLINGS = (*ON_GRAPHS, "metric", "solver", "smoother")
"""Kinds with cases on different meshes of equal size."""

Place = Literal["plane", "space", "one cell"]
"""Where standard test cases are posed."""

_MESHES: Mapping[Place, Sequence[DrawnMesh]] = {
    "plane": [DrawnMesh(family, cells=20, jitter=0.25) for family in PLANE],
    "space": [DrawnMesh("boxes", cells=12), DrawnMesh("tetrahedra", cells=6)],
    "one cell": [DrawnMesh()],
}
_ON_64 = DrawnMesh(cells=64)
_ON_BOXES = DrawnMesh("boxes", cells=30)
_PROBLEMS: Mapping[Place, Sequence[DrawnProblem]] = {
    "plane": [
        DrawnProblem(_ON_64, layout="grown", parts=16, levels=2),
        DrawnProblem(DrawnMesh("hexagons", cells=20), form="functions"),
        DrawnProblem(DrawnMesh(cells=63, jitter=0.25), parts=6, form="functions"),
        DrawnProblem(_ON_64, "even", layout="grown", parts=16, levels=2),
        DrawnProblem(_ON_64, "even", layout="grown", parts=16, width=3),
    ],
    "space": [DrawnProblem(_ON_BOXES), DrawnProblem(_ON_BOXES, "even")],
    "one cell": [DrawnProblem(DrawnMesh()), DrawnProblem(DrawnMesh(), "even")],
}
_SQUARES = DrawnLevel(DrawnGraph(_ON_64), "grown", 16, steps=2)
_LEVELS: Mapping[Place, Sequence[DrawnLevel]] = {
    "plane": [
        _SQUARES,
        replace(_SQUARES, corrected=True),
        DrawnLevel(DrawnGraph(DrawnMesh(cells=63, jitter=0.25)), parts=7, steps=2),
        replace(_SQUARES, width=3),
    ],
    "space": [],
    "one cell": [DrawnLevel(DrawnGraph()), DrawnLevel(DrawnGraph(DrawnMesh(cells=12)), parts=1)],
}


def cases(kind: str, place: Place = "plane") -> list[Case]:
    """Return the standard test cases for a kind of component, or none if all its test cases are drawn."""
    if kind == "solver":
        return [recipe.case for recipe in _PROBLEMS[place]]
    if kind in ("smoother", *PARTS):
        return [recipe.case(kind) for recipe in _LEVELS[place]]
    if kind == "sample":
        return [Case("it", ())] if place == "plane" else []
    if kind in (*ON_GRAPHS, "metric"):
        return []
    if kind == "format" and place == "plane":
        return [case_on(kind, mesh) for mesh in for_files()]
    return [case_on(kind, recipe.mesh) for recipe in _MESHES[place]]


def failing(kind: str) -> list[Case]:
    """Return test cases with zero or invalid data, which a solver or smoother may refuse or fail on."""
    if kind == "smoother":
        level, b, x = _SQUARES.smoothing
        nothing = replace(level, A=0.0 * level.A, inherited=0.0 * level.A)
        return [
            Case("zeros", (level, frozen_float(0.0 * b), frozen_float(0.0 * x))),
            Case("a right-hand side with NaN", (level, frozen_float(np.nan * b), x)),
            Case("a matrix of zeros", (nothing, b, x)),
        ]
    if kind != "solver":
        return []
    fine, hierarchy = DrawnProblem(_ON_64, "even").posed
    assert isinstance(fine, Linear)
    graph = hierarchy.graph
    problems = {
        "no source": Diffusion(source=0.0),
        "a source of NaN": Diffusion(source=np.nan),
        "a negative coefficient": Diffusion(kappa=-1.0),
        "a right-hand side of zeros": replace(fine, b=frozen_float(np.zeros(graph.n))),
        "a right-hand side with NaN": replace(fine, b=frozen_float(np.full(graph.n, np.nan))),
        "a singular system": DrawnProblem(_ON_64, "singular").posed[0],
        "a matrix of zeros": replace(fine, A=0.0 * fine.A),
        "a system with too few cells": Linear(fine.A[1:, 1:], fine.b[1:], np.arange(graph.n)),
    }
    meshless = Hierarchy(None, graph, list(hierarchy.levels[:1]), list(hierarchy.targets[:1]), nested=True)
    return [
        *(Case(name, (problem, hierarchy)) for name, problem in problems.items()),
        Case("diffusion without a mesh", (Diffusion(), meshless)),
    ]


_CHAIN = DrawnGraph(DrawnMesh("strip", cells=3000))
_WIDE = DrawnGraph(DrawnMesh(cells=2000, jitter=0.25, renumbered=True))
_BLOCKS = DrawnGraph(DrawnMesh(cells=2000, jitter=0.25), blocks=40, weights="steep", faces="steep")
_MANY = DrawnGraph(DrawnMesh("strip", cells=15_000), blocks=6000)
_HUGE = DrawnGraph(DrawnMesh(cells=75_000, jitter=0.25))


def large_case(kind: str) -> Case:
    """Return a test case with 2,000 cells, because some components switch algorithms at some size."""
    return graph_case(kind, _WIDE, "noisy", 20, "both")


def large_cases(kind: str) -> list[Case]:
    """Return test cases on long chains, in hundreds of parts, or in thousands of blocks."""
    return [
        graph_case(kind, _CHAIN, "strips", 2, "size"),
        graph_case(kind, _WIDE, "noisy", 300, "both"),
        graph_case(kind, _BLOCKS, "noisy", 4, "both"),
        graph_case(kind, _MANY, "alone", 1, "both"),
    ]


def huge_case(kind: str) -> Case:
    """Return a test case whose cell count exceeds 16 bits, and its square 32 bits."""
    return graph_case(kind, _HUGE, "noisy", 80, "both")


def graph_case(
    kind: str, recipe: DrawnGraph, layout: Layout = "strips", parts: int = 1, target: str = "count"
) -> Case:
    """Return the test case for a bisector, refiner or fixer on a drawn graph."""
    graph: Graph = recipe.graph
    name, seed = f"a graph of {graph.n} {recipe.drawn.family}", recipe.drawn.seed
    if graph.n_blocks > 1:
        name += f" in {graph.n_blocks} blocks"
    code = f"graph = {recipe!r}.graph"
    # The mesh, where its cells are the nodes of the graph.
    mesh = recipe.drawn.mesh if DrawnGraph(recipe.drawn) == recipe and graph.n_blocks == 1 else None
    if kind == "bisector":
        return Case(name, (graph, seeds_for(graph.n_blocks, seed)), code, mesh)
    labels = drawn_labels(graph, layout, parts, seed)
    code += f"\nlabels = drawn_labels(graph, {layout!r}, {parts}, {seed})"
    if kind == "fixer":
        return Case(name, (graph, labels), code, mesh)
    # As in runs, the part count refers to the whole mesh, and exceeds the part count here.
    count = len(np.unique(labels + (int(labels.max()) + 1) * graph.block_ids)) + 2
    size = 0.4 * float(np.linalg.norm(np.ptp(graph.points, axis=0)))
    aim = Target(None if target == "size" else count, None if target == "count" else size)
    return Case(name, (graph, labels, seeds_for(graph.n_blocks, seed), aim), code, mesh)


def mesh_case(recipe: DrawnMesh, layout: Layout, parts: int) -> Case:
    """Return the test case for a metric or constraint on a drawn mesh."""
    mesh = recipe.mesh
    labels = drawn_labels(mesh.graph, layout, parts, recipe.seed)
    code = f"mesh = {recipe!r}.mesh\nlabels = drawn_labels(mesh.graph, {layout!r}, {parts}, {recipe.seed})"
    return Case(f"{mesh.n_cells} {recipe.family} in {labels.max() + 1} parts", (mesh, labels), code)


def part_of_level(case: Case, blocks: ArrayLike) -> Case:
    """Restrict a test case on a graph of several blocks to the given blocks, in this order."""
    graph, block_indices = case.given[0], np.asarray(blocks)
    nodes = np.concatenate([np.arange(graph.offsets[b], graph.offsets[b + 1]) for b in block_indices])
    chosen = {graph.n: nodes, graph.n_blocks: block_indices}
    arguments = [
        frozen(value[chosen[len(value)]], value.dtype) if isinstance(value, np.ndarray) else value
        for value in case.given[1:]
    ]
    return replace(case, given=(graph.take(block_indices), *arguments))


_STRETCHED = (DrawnMesh(cells=64, jitter=0.25, stretch=3.0), DrawnMesh(cells=64, jitter=0.25, stretch=0.3))


def siblings(kind: str, *, partition: bool = False) -> Iterator[Case]:
    """Yield test cases with equal numbers of cells and faces but different results, to expose wrong caches.

    Each case is built when requested, so that it may reuse the memory of the previous case.
    """
    long, high = _STRETCHED
    recipes = [long, replace(long, turn=True), high, replace(long, seed=1)]
    if kind in ON_GRAPHS:
        layouts: tuple[Layout, ...] = ("scattered",) if kind == "bisector" else ("scattered", "grown")
        for weights in ("measures", "steep"):
            for recipe in recipes:
                for layout in layouts:
                    yield graph_case(kind, DrawnGraph(recipe, weights=weights), layout, 3, "both")
        for recipe in recipes if partition else ():
            for parts in (3, 4):
                yield kway_case(graph_case(kind, DrawnGraph(recipe)), parts)
    elif kind == "metric":
        for recipe in recipes:
            for layout in ("strips", "grown"):
                yield mesh_case(recipe, layout, 4)
            yield _cells_renumbered(mesh_case(recipe, "grown", 4))
    elif kind == "solver":
        for recipe in _STRETCHED:
            linear, hierarchy = DrawnProblem(recipe, "even").posed
            assert isinstance(linear, Linear)
            rough = frozen_float(1.0 + np.arange(64) % 7)
            diffusion = [Diffusion(kappa) for kappa in (1.0, rough, frozen_float(rough[::-1]))]
            for problem in (*diffusion, Diffusion(source=3.0), linear, replace(linear, A=3.0 * linear.A)):
                yield Case("64 cells", (problem, hierarchy))
    else:
        for recipe in _STRETCHED[:1] if kind in PARTS else _STRETCHED:
            yield from _of_equal_trace(kind, recipe)


def _of_equal_trace(kind: str, recipe: DrawnMesh) -> Iterator[Case]:
    """Yield cases with matrices of equal size, trace, norm and entries, in reverse order, or other parts."""
    graph = recipe.mesh.graph
    A = laplacian_of(graph, "uneven")
    layouts: tuple[Layout, ...] = ("strips", "strips", "grown")
    for matrix, layout in zip((A, sparse.csr_array(A[::-1, ::-1]), A), layouts, strict=True):
        name = f"64 cells in four parts ({layout})"
        level = level_of(graph, matrix, drawn_labels(graph, layout, 4), corrected=True)
        if kind == "smoother":
            yield question(name, level)
            continue
        step = coarsening_of(level, 1)
        b = frozen_float(1.0 + np.arange(len(level.labels)))
        given = {"transfer": (step,), "coarse_operator": (step, step.injected)}
        yield Case(name, given.get(kind, (step.A, b)))


def _cells_renumbered(case: Case) -> Case:
    """Permute the cell indices in the mesh of a test case, but not labels, points or faces."""
    mesh, labels = case.given
    number = np.append(np.random.default_rng(3).permutation(mesh.n_cells), -1)
    renumbered = replace(mesh, face_cells=number[mesh.face_cells])
    return Case(f"{case.name}, its cells renumbered and its labels not", (renumbered, labels))


def kway_case(case: Case, parts: int) -> Case:
    """Return the test case of a bisector as a direct partition into a number of parts."""
    return replace(case, name=f"{case.name} in {parts} parts", given=(*case.given, Target(parts=parts)))


def with_tags(kind: str) -> list[Case]:
    """Return test cases with three tags, to detect a dependence on the random order of sets.

    The first element of six sets of three names is the same in two processes by chance once in 700 times.
    """
    recipes = [
        DrawnMesh(cells=20, jitter=0.25, tags=tuple((f"{name} of {number}", "small") for name in "abc"))
        for number in range(6)
    ]
    if kind in ON_GRAPHS:
        return [graph_case(kind, DrawnGraph(recipe), "strips", 2, "both") for recipe in recipes]
    if kind == "metric":
        return [mesh_case(recipe, "strips", 4) for recipe in recipes]
    if kind != "solver":
        return []
    tagged = []
    for recipe in recipes:
        mesh, values = recipe.mesh, {tag: float(tag) for tag in (0, 1, 2)}
        problem = Diffusion(2.0, 1.0, values, boundary=next(iter(mesh.face_tags)))
        labels = drawn_labels(mesh.graph, "strips", 2)
        tagged.append(Case(recipe.tags[0][0], (problem, on_levels(mesh, labels))))
    return tagged


def seeds_for(blocks: int, seed: int = 0) -> UInt64:
    """Return a random seed for each block ``(B,)``.

    The first seed is at least 2^63, like half of the seeds in a run.
    """
    values = np.random.default_rng(seed).integers(2**64, size=blocks, dtype=np.uint64)
    values[:1] |= np.uint64(2**63)
    seeds: UInt64 = frozen(values, np.uint64)
    return seeds


def with_problem(case: Case, **changes: Any) -> Case:
    """Replace some attributes of the problem in a test case for a solver."""
    problem, hierarchy = case.given
    return replace(case, given=(replace(problem, **changes), hierarchy))
