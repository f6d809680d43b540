"""Training data of the 3-D network: pieces that arise in recursive bisections of generated meshes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.authoring import (
    Float,
    Graph,
    InertialBisection,
    Int,
    Mask,
    Mesh,
    SweepBisection,
    frozen_int,
    samples,
)
from agglo_gnn.training.flat_arrays import join_arrays, rows_of
from agglo_gnn.training.pieces import FEWEST, bisect_pieces

if TYPE_CHECKING:
    import torch

SPATIAL_RECIPE = (
    "recursion pieces of 10..2500 cells of Voronoi, Delaunay, tetrahedral and hexahedral meshes, half "
    "stretched up to 2.5:1, half cut to random stars with holes and slits; split by inertial or sweep "
    "bisection, half of them refined"
)
# Cells of the largest pieces, about: larger pieces take more training time (benchmarks/constants.py)
_MOST = 2500


def solid_graphs(rng: np.random.Generator, count: int) -> Iterator[Graph]:
    """Yield graphs whose blocks are pieces of recursive bisections, at least ``count`` blocks in total."""
    n_pieces = 0
    while n_pieces < count:
        graph = _domain(rng)
        bisector = (InertialBisection(), SweepBisection())[rng.integers(2)]
        refine = bool(rng.random() < 0.5)
        while graph.n_blocks:
            n_pieces += graph.n_blocks
            yield graph
            graph = bisect_pieces(graph, bisector, refine)


def _domain(rng: np.random.Generator) -> Graph:
    """Return the largest component of a random mesh, possibly stretched or restricted to a random domain."""
    n = int(np.exp(rng.uniform(np.log(150), np.log(_MOST))))
    blob = rng.random() < 0.5
    mesh = _mesh(rng, int(2.0 * n) if blob else n)
    if rng.random() < 0.5:
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        factors = rng.uniform(1.0, 2.5, 3)
        mesh = replace(mesh, points=mesh.points @ (turn * factors) @ turn.T)
    graph = mesh.graph
    inside = _blob(rng, graph.centroids) if blob else np.ones(graph.n, bool)
    if inside.sum() < 2 * FEWEST:
        return graph
    labels = graph.components(frozen_int(inside)) + 1
    largest = np.argmax(np.bincount(labels * inside)[1:]) + 1
    return graph.subgraph(np.flatnonzero(labels == largest), [0, int((labels == largest).sum())])


def _mesh(rng: np.random.Generator, n: int) -> Mesh:
    seed, kind = int(rng.integers(2**31)), rng.integers(4)
    if kind == 0:
        return samples.voronoi3d(n, seed)
    if kind == 1:
        return samples.random_tetrahedra(max(n // 6, 4), seed)
    if kind == 2:
        return samples.tetrahedra(max(2, round(np.cbrt(n / 6))))
    return samples.boxes(max(3, round(np.cbrt(n))))


def _blob(rng: np.random.Generator, centroids: Float) -> Mask:
    """Return a mask of the cells in a random star-shaped domain without some balls and slits.

    The star is r(u) = 1 + waves along random axes.
    """
    x = (centroids - centroids.mean(axis=0)) / np.ptp(centroids, axis=0).max() * 2.0
    radius = np.linalg.norm(x, axis=1)
    waves = rng.standard_normal((6, 3)) * rng.uniform(0.5, 2.5, (6, 1))
    height = rng.normal(size=6) * rng.uniform(0.1, 0.4)
    phase = rng.uniform(0, 2 * np.pi, 6)
    inside = radius < 0.8 * (1 + np.cos(x / radius[:, None] @ waves.T + phase) @ height)
    for _ in range(rng.integers(3)):
        inside &= np.linalg.norm(x - rng.uniform(-0.7, 0.7, 3), axis=1) > rng.uniform(0.1, 0.4)
    for _ in range(rng.integers(3)):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        along, across, _ = ((x - rng.uniform(-0.7, 0.7, 3)) @ turn).T
        inside &= (np.abs(across) > 0.08) | (along < 0) | (along > rng.uniform(0.5, 1.5))
    return np.asarray(inside)


@dataclass(frozen=True)
class SpatialPieces:
    """Many pieces in flat arrays: ``cell_offsets[p]:cell_offsets[p + 1]`` are the cells of piece p."""

    cell_offsets: Int
    edge_offsets: Int
    cells: Float
    shares: Float
    ends: Int
    areas: Float
    even: Float
    odd: Float
    frames: Float

    @property
    def sizes(self) -> Int:
        return np.diff(self.cell_offsets)


def gather_solids(levels: list[Graph]) -> SpatialPieces:
    """Collect the features of all blocks in flat arrays, with face areas relative to a typical section."""
    return SpatialPieces(**join_arrays([_arrays_of(level) for level in levels]))


def _arrays_of(level: Graph) -> dict[str, Any]:
    from agglo_gnn.space.moments import describe_solids

    even, odd, frames, _, cells, shares, sections = describe_solids(
        level.offsets, level.centroids, level.weights, level.measures
    )
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    is_upper = rows < level.indices
    block = level.block_ids[rows[is_upper]]
    ends: Int = np.stack((rows[is_upper], level.indices[is_upper]), axis=1)
    return {
        "cell_offsets": np.diff(level.offsets),
        "edge_offsets": np.bincount(block, minlength=level.n_blocks),
        "cells": cells,
        "shares": shares,
        "ends": ends - level.offsets[block][:, None],
        "areas": level.interface[is_upper] * sections[block],
        "even": even,
        "odd": odd,
        "frames": frames,
    }


def tensors_of(data: SpatialPieces, chosen: Int) -> dict[str, torch.Tensor]:
    """Return the chosen pieces as one tensor batch."""
    import torch

    cells, cell_owner, cell_first = rows_of(data.cell_offsets, chosen)
    edges, edge_owner, _ = rows_of(data.edge_offsets, chosen)
    arrays = {
        "cells": data.cells[cells].astype(np.float32),
        "shares": data.shares[cells].astype(np.float32),
        "cell_owner": cell_owner,
        "ends": data.ends[edges] + cell_first[edge_owner][:, None],
        "areas": data.areas[edges].astype(np.float32),
        "edge_owner": edge_owner,
        "sizes": data.sizes[chosen].astype(np.float32),
        **{key: getattr(data, key)[chosen].astype(np.float32) for key in ("even", "odd", "frames")},
    }
    return {key: torch.from_numpy(values) for key, values in arrays.items()}
