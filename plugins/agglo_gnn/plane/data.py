"""Training data of the 2-D network: mesh pieces in flat arrays, and batches of them as tensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.authoring import Float, Graph, Int
from agglo_gnn.plane.features import rasterise
from agglo_gnn.training.flat_arrays import join_arrays, rows_of

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Pieces:
    """Many pieces in flat arrays: ``offsets[p]:offsets[p + 1]`` are the cells, edges or bins of piece p."""

    cell_offsets: Int
    cells: Float
    shares: Float
    edge_offsets: Int
    ends: Int
    lengths: Float
    node_offsets: Int
    nodes: Float
    near: Int
    areas: Float
    blocks: Float

    @property
    def sizes(self) -> Int:
        return np.diff(self.cell_offsets)


def gather(levels: list[Graph]) -> Pieces:
    """Collect the features of all blocks in flat arrays, with lengths relative to √A (A the area)."""
    return Pieces(**join_arrays([_arrays_of(level) for level in levels]))


def _arrays_of(level: Graph) -> dict[str, Any]:
    # 1. Raster of each block, and each edge once
    rasters = rasterise(level)
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    is_upper = rows < level.indices
    rows, columns, block = rows[is_upper], level.indices[is_upper], level.block_ids[rows[is_upper]]
    area = np.bincount(level.block_ids, level.measures)
    first = level.offsets[block]
    # 2. Counts, which become offsets, and lengths over √A
    return {
        "cell_offsets": np.diff(level.offsets),
        "cells": rasters.cells,
        "shares": rasters.shares,
        "edge_offsets": np.bincount(block, minlength=level.n_blocks),
        "ends": np.stack((rows - first, columns - first), axis=1),
        "lengths": level.interface[is_upper] / np.sqrt(area[block]),
        "node_offsets": np.diff(rasters.node_offsets),
        "nodes": rasters.nodes,
        "near": rasters.near.astype(np.int64),
        "areas": rasters.areas,
        "blocks": rasters.blocks,
    }


def batch_of(data: Pieces, chosen: Int) -> dict[str, torch.Tensor]:
    import torch

    # 1. Rows of the chosen pieces
    cells, cell_owner, cell_first = rows_of(data.cell_offsets, chosen)
    edges, edge_owner, _ = rows_of(data.edge_offsets, chosen)
    nodes, node_owner, node_first = rows_of(data.node_offsets, chosen)
    near = data.near[nodes]
    # 2. Arrays, numbered within the batch
    arrays = {
        "cells": data.cells[cells].astype(np.float32),
        "shares": data.shares[cells].astype(np.float32),
        "cell_owner": cell_owner,
        "ends": data.ends[edges] + cell_first[edge_owner][:, None],
        "lengths": data.lengths[edges].astype(np.float32),
        "edge_owner": edge_owner,
        "nodes": data.nodes[nodes].astype(np.float32),
        "near": np.where(near >= 0, near + node_first[node_owner][:, None], -1),
        "areas": data.areas[nodes].astype(np.float32),
        "node_owner": node_owner,
        "blocks": data.blocks[chosen].astype(np.float32),
        "root": np.sqrt(data.sizes[chosen]).astype(np.float32),
    }
    return {key: torch.from_numpy(values) for key, values in arrays.items()}
