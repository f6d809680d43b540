"""The paper's training set: dual graphs of four mesh families on the unit square, and parts of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from agglo_core.authoring import Graph, Mask, samples

FAMILIES = ("squares", "triangles", "random_triangles", "voronoi")
CELLS = (50, 1500)
"""Smallest and largest number of cells in a training mesh, as in the authors' generator."""

_SMALLEST = 4  # minimum cells of a piece; pieces below three times as many are not cut again


def draw(count: int, rng: np.random.Generator, pieces: float = 0.0) -> Iterator[Graph]:
    """Yield ``count`` dual graphs, from each mesh family in turn, with log-uniformly distributed sizes.

    Parameters
    ----------
    count : int
    rng : numpy.random.Generator
        Determines the result.
    pieces : float
        Fraction, from 0 to 1, of meshes reduced to a random piece, as they occur in recursion.
    """
    for number in range(count):
        graph = _mesh(FAMILIES[number % len(FAMILIES)], rng)
        yield random_piece(graph, rng) if rng.random() < pieces else graph


def _mesh(family: str, rng: np.random.Generator) -> Graph:
    side = np.exp(0.5 * rng.uniform(*np.log(CELLS)))
    seed = int(rng.integers(2**31))
    match family:
        case "squares":
            mesh = samples.squares(round(side))
        case "triangles":
            mesh = samples.triangles(round(side / np.sqrt(2)))
        case "random_triangles":  # about two triangles a point
            mesh = samples.random_triangles(max(4, round(side * side / 2)), seed)
        case _:
            mesh = samples.voronoi(round(side * side), seed)
    return mesh.graph


def random_piece(graph: Graph, rng: np.random.Generator) -> Graph:
    """Return a connected subgraph of a connected graph, left by one to seven random straight cuts.

    Each cut has a random direction and leaves 35 to 65 per cent of the cells on either side. The largest
    component of a random side is kept. Pieces with fewer than twelve cells are not cut again.
    """
    for _ in range(rng.integers(1, 8)):
        if graph.n < 3 * _SMALLEST:
            break
        angle = rng.uniform(0, 2 * np.pi)
        along = graph.centroids @ (np.cos(angle), np.sin(angle))
        sides = along > np.quantile(along, rng.uniform(0.35, 0.65))
        graph = _largest(graph, sides if rng.random() < 0.5 else ~sides)
    return graph


def _largest(graph: Graph, mask: Mask) -> Graph:
    """Return the largest connected component of the subgraph on the nodes in the mask."""
    component = graph.components(mask.astype(np.int64))
    counts = np.bincount(component, mask)
    nodes = np.flatnonzero(component == counts.argmax())
    return graph.subgraph(nodes, [0, len(nodes)])
