"""Inputs of the 2-D network: a raster image and moments of each block."""

from __future__ import annotations

from dataclasses import dataclass

from agglo_core.authoring import Float, Graph, Index, Int

FEATURES = (
    *("bin u", "bin v", "bin area / mean - 1, at most 3", "bin sides without neighbour / 4"),
    *(f"block moment {u}{order - u}" for order in (2, 3, 4) for u in range(order, -1, -1)),
    "3 / sqrt(block cells)",
)
"""Feature names in order: first per bin, then per block."""


@dataclass(frozen=True)
class Rasters:
    """Network inputs for all blocks: each block as a raster with at most about 200 occupied bins.

    A block is described in its frame: origin at the centre of mass, principal axes, each pointing to its
    heavier tail, and one scale that maps a square to [−1, 1]². Shift, scale and rotation of the mesh change
    nothing.

    Attributes
    ----------
    node_offsets : (B + 1,) int64
        Bins of each block.
    nodes : (N, 4) float; near : (N, 4) int32; areas : (N,) float
        Bin features, bin neighbours numbered within the block (−1: none), measure fractions.
    blocks : (B, 13) float
        Block features.
    cells : (n, 2) float; shares : (n,) float
        Cell positions in the block frame, and weight fractions within the block.
    """

    node_offsets: Int
    nodes: Float
    near: Index
    areas: Float
    blocks: Float
    cells: Float
    shares: Float


def rasterise(level: Graph) -> Rasters:
    """Compute rasters and features for all blocks of a 2-D graph."""
    from agglo_gnn.plane.raster_kernels import describe

    return Rasters(*describe(level.offsets, level.centroids, level.weights, level.measures))
