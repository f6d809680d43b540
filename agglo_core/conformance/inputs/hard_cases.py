"""Hard test cases: unusual graphs, many blocks, meshes of equal size, and direct k-way partitions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes, unusual_graphs
from agglo_core.conformance.inputs.cases import labelled_case, laplacian, seeds_for, stripes
from agglo_core.conformance.inputs.multigrid_cases import (
    PARTS,
    coarsening_of,
    laplacian_of,
    level_of,
    question,
)
from agglo_core.conformance.inputs.unusual_graphs import clumps, fresh
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, MultigridLevel
from agglo_core.protocols import Target

_KWAY_PARTS = (2, 5)

SIBLINGS = ("bisector", "refiner", "fixer", "metric", "solver", "smoother")
"""Kinds with cases on different meshes of equal size."""


def large_cases(kind: str) -> list[Case]:
    """Return test cases on a chain of 2,000 cells and on 600 cells, in hundreds of parts."""
    chain, graph = small_meshes.line(2000), small_meshes.grid(25, 24, jitter=0.2).graph
    if kind == "bisector":
        return [
            Case("a chain of 2000 cells", (chain, seeds_for(1))),
            Case("600 cells", (graph, seeds_for(1))),
        ]
    hundreds = {
        "600 cells in 300 parts": np.arange(600) // 2,
        "600 cells, each alone": np.arange(600),
        "600 cells in 150 parts, some of them disconnected": clumps(graph, 150, strays=0.2),
    }
    return [
        labelled_case(kind, chain, "a chain of 2000 cells", frozen_int(np.arange(2000) // 1500), "size"),
        *(labelled_case(kind, graph, name, frozen_int(labels), "both") for name, labels in hundreds.items()),
    ]


def large_case(kind: str, seed: int = 0) -> list[Case]:
    """Return a test case with 2,000 cells in a single block.

    The list is empty for kinds without graph.
    """
    if kind not in ("bisector", "refiner", "fixer"):
        return []
    graph = fresh(unusual_graphs.large())
    if kind == "bisector":
        return [Case("2000 cells", (graph, seeds_for(1, seed)))]
    return [labelled_case(kind, graph, "2000 cells", clumps(graph, 20, strays=0.02), "both", seed)]


def crowd_case(kind: str, blocks: int = 300) -> Case:
    """Return a test case with many small blocks and a large block, and 1 to 4 parts per block.

    Parts are in pieces in every other block. The level carries data with block-dependent magnitude; for
    refiners and fixers, the interfaces and measures of neighbouring blocks differ by a factor up to 1e9.
    """
    level = unusual_graphs.crowd(blocks, 2 if kind == "bisector" else 1)  # single cells cannot be split
    # Cell data with a different magnitude in each block.
    place = np.arange(level.n) - level.offsets[level.block_ids]
    carried = 10.0 ** (level.block_ids * 3 % 7) * (1.0 + place * 5 % 3)
    level = fresh(replace(level, data={"permeability": frozen_float(carried)}))
    name = f"a level of {blocks} blocks"
    if kind == "bisector":
        return Case(name, (level, seeds_for(blocks, 7)))
    # In odd blocks labels alternate from cell to cell, in even blocks parts are strips.
    sizes = level.sizes[level.block_ids]
    parts = np.minimum(sizes, 1 + level.block_ids % 4)
    position = np.empty(level.n, np.int64)
    position[np.lexsort((level.centroids[:, 1], level.centroids[:, 0], level.block_ids))] = place
    labels = np.where(level.block_ids % 2, place % parts, position * parts // sizes)
    # Scale interfaces, measures and weights by block.
    rows = np.repeat(level.block_ids, np.diff(level.indptr))
    small, faces = 10.0 ** (-3.0 * (level.block_ids % 4)), 10.0 ** (-3.0 * (rows % 4))
    level = replace(
        level,
        interface=frozen_float(level.interface * faces),
        measures=frozen_float(level.measures * small),
        weights=frozen_float(level.weights * small),
    )
    return labelled_case(kind, level, name, frozen_int(labels), "both")


def many_parts(kind: str) -> Case:
    """Return a test case of 5,000 blocks with more than 65,536 possible (block, label) pairs.

    The first block has 60 cells. In every third block cells alternate between two parts. Elsewhere each
    cell is a part.
    """
    level = fresh(unusual_graphs.small_blocks())
    name = f"a level of {level.n_blocks} blocks"
    if kind == "bisector":
        return Case(name, (level, seeds_for(level.n_blocks, 3)))
    place = np.arange(level.n) - level.offsets[level.block_ids]
    labels = np.where(level.block_ids % 3 == 1, place % 2, place)
    return labelled_case(kind, level, name, frozen_int(labels), "both")


def partitions(seed: int = 0) -> list[Case]:
    """Return test cases for direct k-way partitions."""
    meshes = [mesh for mesh in small_meshes.plane_meshes() if mesh.n_cells > max(_KWAY_PARTS)]
    return [_in_parts(mesh.name, mesh.graph, parts, seed) for mesh in meshes for parts in _KWAY_PARTS]


def partitions_in_3d() -> list[Case]:
    """Return 3-D test cases for direct k-way partitions."""
    return [_in_parts("3-D boxes", small_meshes.boxes().graph, parts) for parts in _KWAY_PARTS]


def siblings(kind: str, *, partition: bool = False) -> Iterator[Case]:
    """Yield test cases with equal numbers of cells and faces but different results, to expose wrong caches.

    Each case is built when requested, so that it may reuse the memory of the previous case.
    """
    if kind == "bisector":
        yield from _of_bisectors(partition)
    # Refiners and fixers: different labels on each graph, then equal labels on all graphs.
    elif kind in ("refiner", "fixer"):
        for place, graph in enumerate(_graphs()):
            for parts in (3, 4 - place % 2):
                labels = clumps(graph, parts, strays=0.1 * (1 + place))
                yield labelled_case(kind, graph, f"63 cells ({place})", labels, "both", seed=place)
        for graph in _graphs():
            labels = np.random.default_rng(6).integers(3, size=graph.n)
            yield labelled_case(kind, graph, "63 cells with the same labels", frozen_int(labels), "both")
    elif kind == "metric":
        for make in _MESHES:
            for labels in (np.arange(63) // 16, np.arange(63) % 9 // 3):
                yield Case("63 cells", (make(), frozen_int(labels)))
    elif kind == "solver":
        for make in _MESHES[:2]:
            mesh = make()
            hierarchy = _hierarchy(mesh, stripes(mesh.graph, 4))
            for problem in (Diffusion(), Diffusion(source=3.0), laplacian(mesh.graph, 1)):
                yield Case("63 cells", (problem, hierarchy))
    elif kind == "smoother":
        for make in _MESHES:
            graph = make().graph
            yield question(
                "63 cells", level_of(graph, laplacian_of(graph), stripes(graph, 4), corrected=True)
            )
        yield from (question("63 cells, in reverse order", level) for level in _of_equal_trace())
    elif kind in PARTS:
        for level in _of_equal_trace():
            step = coarsening_of(level, 1)
            given = {"transfer": (step,), "coarse_operator": (step, step.injected)}
            b = frozen_float(1.0 + np.arange(len(level.labels)))
            yield Case("63 cells, in reverse order", given.get(kind, (step.A, b)))


def _of_equal_trace() -> Iterator[MultigridLevel]:
    """Yield levels whose matrices have equal size, trace, norm and entries, in reverse order."""
    graph = _wide_grid().graph
    A = laplacian_of(graph, "uneven")
    for matrix in (A, sparse.csr_array(A[::-1, ::-1])):
        yield level_of(graph, matrix, stripes(graph, 4))


def _of_bisectors(partition: bool) -> Iterator[Case]:
    for place, graph in enumerate(_graphs()):
        yield Case(f"63 cells ({place})", (graph, seeds_for(1, place)))
    if partition:
        for graph in _graphs():
            for parts in (3, 4):
                yield _in_parts("63 cells", graph, parts)


def _graphs() -> Iterator[Graph]:
    for make in _MESHES:
        yield make().graph
    graph = _wide_grid().graph
    yield replace(graph, weights=frozen_float(graph.measures * np.linspace(0.1, 4.0, graph.n)))


def _wide_grid() -> Mesh:
    return small_meshes.grid(9, 7, width=3.0, jitter=0.2)


def _high_grid() -> Mesh:
    """Return a grid stretched along y and then turned by 90°, with the connectivity of ``_wide_grid``."""
    quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])
    high = small_meshes.grid(9, 7, height=3.0, jitter=0.2)
    return unusual_graphs.map_points(high, lambda points: points @ quarter)


def _transposed_grid() -> Mesh:
    return replace(small_meshes.grid(7, 9, width=3.0, jitter=0.2), name="9 by 7 grid")


_MESHES: Sequence[Callable[[], Mesh]] = (_wide_grid, _high_grid, _transposed_grid)


def _in_parts(name: str, graph: Graph, parts: int, seed: int = 0) -> Case:
    target = Target(parts=parts)
    return Case(f"{name} in {parts} parts", (graph, seeds_for(1, seed), target))


def _hierarchy(mesh: Mesh, labels: Int) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [labels], [{"n_parts": int(labels.max()) + 1}], nested=True)
