"""Training data of the 2-D network: pieces that arise in recursive bisections of generated meshes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from agglo_core.authoring import (
    Float,
    Graph,
    InertialBisection,
    InterfaceRefiner,
    Mask,
    Mesh,
    SweepBisection,
    Target,
    UInt64,
    frozen_int,
    samples,
)

RECIPE = (
    "recursion pieces of 10..1200 cells of Voronoi, Delaunay and grid meshes, half stretched up to 2.5:1, "
    "half cut to random stars with holes and slits; split by inertial, sweep1 or sweep8 bisection, "
    "half of them refined"
)
# Cells of the smallest pieces, and about of the largest: larger take more time (benchmarks/constants.py)
FEWEST, _MOST = 10, 1200


def piece_graphs(rng: np.random.Generator, count: int) -> Iterator[Graph]:
    """Yield graphs whose blocks are pieces of recursive bisections, at least ``count`` blocks in total."""
    n_pieces = 0
    while n_pieces < count:
        graph = _domain(rng)
        bisector = (InertialBisection(), SweepBisection(1), SweepBisection(8))[rng.integers(3)]
        refine = bool(rng.random() < 0.5)
        while graph.n_blocks:
            n_pieces += graph.n_blocks
            yield graph
            graph = bisect_pieces(graph, bisector, refine)


def bisect_pieces(level: Graph, bisector: InertialBisection | SweepBisection, refine: bool) -> Graph:
    """Bisect all pieces, and return the connected components of the sides that are large enough."""
    seeds: UInt64 = np.zeros(level.n_blocks, np.uint64)
    sides = frozen_int(bisector.bisect_level(level, seeds))
    if refine:
        sides = InterfaceRefiner().refine(level, sides, seeds, Target())
    pieces = level.split(level.components(2 * level.block_ids + sides))[0]
    return pieces.take(np.flatnonzero(np.diff(pieces.offsets) >= FEWEST))


def _domain(rng: np.random.Generator) -> Graph:
    """Return the largest component of a random mesh, possibly stretched or restricted to a random domain."""
    n = int(np.exp(rng.uniform(np.log(80), np.log(_MOST))))
    blob = rng.random() < 0.5
    mesh = _mesh(rng, int(1.6 * n) if blob else n)
    if rng.random() < 0.5:
        stretch = np.sqrt(rng.uniform(1.0, 2.5))
        loops = mesh.boundary_loops
        points = (mesh.points @ _turn(rng.uniform(0, np.pi))) * (stretch, 1 / stretch)
        mesh = Mesh.from_polygons(points, (loops.loop_offsets, loops.vertices))
    graph = mesh.graph
    inside = _blob(rng, graph.centroids) if blob else np.ones(graph.n, bool)
    if inside.sum() < 2 * FEWEST:
        return graph
    labels = graph.components(frozen_int(inside)) + 1
    largest = np.argmax(np.bincount(labels * inside)[1:]) + 1
    return graph.subgraph(np.flatnonzero(labels == largest), [0, int((labels == largest).sum())])


def _mesh(rng: np.random.Generator, n: int) -> Mesh:
    seed = int(rng.integers(2**31))
    kind = rng.integers(4)
    if kind == 0:
        return samples.voronoi(n, seed)
    if kind == 1:
        return samples.random_triangles(max(n // 2, 4), seed)
    side = max(3, round(np.sqrt(n if kind == 2 else n / 2)))
    mesh = samples.squares(side) if kind == 2 else samples.triangles(side)
    points = mesh.points + rng.uniform(-0.2, 0.2, mesh.points.shape) * rng.random() / side
    loops = mesh.boundary_loops
    return Mesh.from_polygons(points, (loops.loop_offsets, loops.vertices))


def _blob(rng: np.random.Generator, centroids: Float) -> Mask:
    """Return a mask of the cells in a random star-shaped domain r(θ) without some discs and slits.

    The radius r(θ) is a random Fourier series.
    """
    x = centroids / np.abs(centroids).max(axis=0)
    radius, angle = np.hypot(*x.T), np.arctan2(x[:, 1], x[:, 0])
    orders = np.arange(1, 8)
    amplitude = rng.normal(size=7) * rng.uniform(0.1, 0.6) / orders**0.7
    phase = rng.uniform(0, 2 * np.pi, 7)
    inside = radius < 0.75 * (1 + np.cos(angle[:, None] * orders + phase) @ amplitude)
    for _ in range(rng.integers(3)):
        inside &= np.hypot(*(x - rng.uniform(-0.7, 0.7, 2)).T) > rng.uniform(0.08, 0.3)
    for _ in range(rng.integers(3)):
        along, across = ((x - rng.uniform(-0.7, 0.7, 2)) @ _turn(rng.uniform(0, np.pi))).T
        inside &= (np.abs(across) > 0.04) | (along < 0) | (along > rng.uniform(0.5, 1.5))
    return np.asarray(inside)


def _turn(angle: float) -> Float:
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
