"""The paper's training set: four families of meshes of the unit square, and pieces of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from agglo_core.authoring import Graph, Mask, samples

FAMILIES = ("squares", "triangles", "random_triangles", "voronoi")
CELLS = (50, 1500)
"""Fewest and most cells of a training mesh: the range of the authors' generator."""

_SMALLEST = 4  # cells of a piece


def draw(count: int, rng: np.random.Generator, pieces: float = 0.0) -> Iterator[Graph]:
    """Yield ``count`` dual graphs, the families in turn, the logarithms of their sizes uniform.

    Parameters
    ----------
    count : int
    rng : numpy.random.Generator
        What comes out depends on it alone.
    pieces : float
        Share, from 0 to 1, of meshes of which only a random piece is kept, as they occur in recursion.
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
    """A connected piece of a connected graph: what one to seven random straight cuts leave.

    Each cut has a random direction, leaves 35 to 65 per cent of the cells on either side, and a random side
    is kept; of that side the largest component stays. Fewer than twelve cells are not cut again.
    """
    for _ in range(rng.integers(1, 8)):
        if graph.n < 3 * _SMALLEST:
            break
        angle = rng.uniform(0, 2 * np.pi)
        along = graph.centroids @ (np.cos(angle), np.sin(angle))
        sides = along > np.quantile(along, rng.uniform(0.35, 0.65))
        graph = _largest(graph, sides if rng.random() < 0.5 else ~sides)
    return graph


def _largest(graph: Graph, chosen: Mask) -> Graph:
    """The largest component of the chosen nodes."""
    component = graph.components(chosen.astype(np.int64))
    counts = np.bincount(component, chosen)
    nodes = np.flatnonzero(component == counts.argmax())
    return graph.subgraph(nodes, [0, len(nodes)])
