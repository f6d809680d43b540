"""Input features of the fast network: a raster of each block, and moments of the block."""

from __future__ import annotations

from dataclasses import dataclass

from agglo_core.authoring import Float, Graph, Index, Int

FEATURES = (
    *("bin u", "bin v", "bin area / mean - 1, at most 3", "bin sides without neighbour / 4"),
    *(f"block moment {u}{order - u}" for order in (2, 3, 4) for u in range(order, -1, -1)),
    "3 / sqrt(block cells)",
)
"""Features in this order: of each bin, then of the block."""


@dataclass(frozen=True)
class Rasters:
    """All blocks as input of the network: each one a raster of at most about 200 occupied bins.

    A block lies in its frame: origin at the centre of mass, principal axes, each pointing to its
    heavier tail, and one scale that makes a square [−1, 1]². Shift, scale and rotation of the mesh
    change nothing.

    Attributes
    ----------
    node_offsets : (B + 1,) int64
        Bins of each block.
    nodes : (N, 4) float; near : (N, 4) int32; areas : (N,) float
        Features of the bins, their neighbours numbered within the block (−1: none), shares of the measure.
    blocks : (B, 13) float
        Features of the blocks.
    cells : (n, 2) float; shares : (n,) float
        Cells in the frame of their block, and their share of its weight.
    """

    node_offsets: Int
    nodes: Float
    near: Index
    areas: Float
    blocks: Float
    cells: Float
    shares: Float


def rasterise(level: Graph) -> Rasters:
    """Rasters and features of all blocks of a planar graph."""
    from agglo_gnn.plane.raster_kernels import describe

    return Rasters(*describe(level.offsets, level.centroids, level.weights, level.measures))
