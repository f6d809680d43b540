"""The paper's network in torch: input normalisation (INorm), four SAGE and three linear layers, loss.

A batch is one block-diagonal graph in CSR form: the meshes of a mini-batch in training, the pieces at a
recursion depth in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from agglo_core.authoring import Float, Graph, OptionError
from agglo_core.graph.blocks import principal_frames

ARCHITECTURE = "paper"
FEATURES = ("measure", "x", "y")
_HIDDEN, _LAYERS = 64, 4  # width of the layers, and number of SAGE layers, as in the paper


def require_plane(graph: Graph) -> None:
    """Raise OptionError if the graph is not two-dimensional."""
    if graph.dim != 2:
        raise OptionError(f"gnn_paper splits 2-D meshes only, given a {graph.dim}-D one")


def inorm(level: Graph) -> Float:
    """Return the normalised inputs of the paper's network: measure and centroid per cell ``(n, 3)``.

    Each block is normalised by itself: the paper's INorm.

    Measures are divided by their maximum. Centroids are taken relative to the centre of mass, in principal
    axes, and both coordinates are divided by the largest absolute value. The paper rotates pieces longer in
    y by 90 degrees, and scales x and y each by its own maximum. The principal frame with one scale does
    this for axis-parallel pieces, and is also equivariant for rotated pieces.

    Raises
    ------
    OptionError
        If the graph is not two-dimensional.
    """
    require_plane(level)
    first, block = level.offsets[:-1], level.block_ids
    local = principal_frames(level)[1]
    size = np.maximum.reduceat(np.abs(local).max(axis=1), first)
    largest = np.maximum.reduceat(level.measures, first)
    columns = np.column_stack((level.measures, local))
    scales = np.column_stack((largest, size, size))[block]
    scaled: Float = np.divide(columns, scales, out=np.zeros_like(columns), where=scales > 0)
    return scaled


@dataclass(frozen=True)
class Neighbours:
    """Edges of several graphs evaluated as one batch, and each node's block.

    Attributes
    ----------
    indptr : (n + 1,) int64 tensor; indices : (m,) int64 tensor
        CSR of the neighbours, both directions.
    blocks : (n,) int64 tensor
        Block of each node, 0..n_blocks−1.
    n_blocks : int
    """

    indptr: Tensor
    indices: Tensor
    blocks: Tensor
    n_blocks: int

    @classmethod
    def of(cls, graphs: Sequence[Graph], device: str = "cpu") -> Neighbours:
        """Join graphs into one batch without edges between them, keeping their blocks."""
        starts = np.cumsum([0, *(graph.n for graph in graphs)])
        edges = np.cumsum([0, *(len(graph.indices) for graph in graphs)])
        before = np.cumsum([0, *(graph.n_blocks for graph in graphs)])
        join = np.concatenate
        indptr = join([[0], *(graph.indptr[1:] + e for graph, e in zip(graphs, edges, strict=False))])
        indices = join([graph.indices + s for graph, s in zip(graphs, starts, strict=False)])
        blocks = join([graph.block_ids + b for graph, b in zip(graphs, before, strict=False)])
        tensors = [torch.from_numpy(each.astype(np.int64)).to(device) for each in (indptr, indices, blocks)]
        return cls(tensors[0], tensors[1], tensors[2], int(before[-1]))

    def sum(self, values: Tensor) -> Tensor:
        """Return the sum of ``values (n, f)`` over each node's neighbours."""
        summed: Tensor = _NeighbourSum.apply(values, self.indptr, self.indices)  # type: ignore[no-untyped-call]
        return summed

    def mean(self, values: Tensor) -> Tensor:
        """Return the mean of ``values (n, f)`` over each node's neighbours, 0 without neighbours."""
        return self.sum(values) / self.degrees(values.dtype).clamp(min=1.0)

    def degrees(self, dtype: torch.dtype) -> Tensor:
        """Return the neighbour count per node ``(n, 1)``."""
        return (self.indptr[1:] - self.indptr[:-1]).to(dtype)[:, None]

    def block_sums(self, values: Tensor) -> Tensor:
        """Return the sum of ``values (n, f)`` over each block, ``(n_blocks, f)``."""
        zeros = values.new_zeros(self.n_blocks, values.shape[1])
        return zeros.index_add(0, self.blocks, values)


class _NeighbourSum(torch.autograd.Function):
    """The product A H with a symmetric adjacency matrix A, differentiable by torch."""

    @staticmethod
    def forward(ctx, values, indptr, indices):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(indptr, indices)
        return nn.functional.embedding_bag(indices, values, indptr[:-1], mode="sum")

    @staticmethod
    def backward(ctx, gradient):  # type: ignore[no-untyped-def]
        indptr, indices = ctx.saved_tensors
        back = nn.functional.embedding_bag(indices, gradient.contiguous(), indptr[:-1], mode="sum")
        return back, None, None


class PaperNetwork(nn.Module):
    """Four SAGE layers with width 64, then linear layers to 32, 8 and 2 (paper, §3.2 and §3.3).

    A SAGE layer is H' = tanh(H W₁ + mean over neighbours(H) W₂ + b). The first two linear layers are
    followed by tanh, too, as in the authors' programs; the paper leaves this open. About 28k parameters.
    """

    def __init__(self) -> None:
        super().__init__()
        widths = [len(FEATURES)] + [_HIDDEN] * _LAYERS
        pairs = list(pairwise(widths))
        self.own = nn.ModuleList(nn.Linear(a, b) for a, b in pairs)
        self.near = nn.ModuleList(nn.Linear(a, b, bias=False) for a, b in pairs)
        self.dense = nn.ModuleList(nn.Linear(a, b) for a, b in ((_HIDDEN, 32), (32, 8), (8, 2)))

    def forward(self, x: Tensor, neighbours: Neighbours) -> Tensor:
        """Return two scores per node, the logits ``(n, 2)`` of the sides, for features ``(n, 3)``.

        The softmax of a row is the paper's Y.
        """
        for own, near in zip(self.own, self.near, strict=True):
            x = torch.tanh(own(x) + near(neighbours.mean(x)))
        for dense in self.dense[:-1]:
            x = torch.tanh(dense(x))
        logits: Tensor = self.dense[-1](x)
        return logits


def expected_normalised_cut(logits: Tensor, neighbours: Neighbours) -> Tensor:
    """Return the paper's loss per block ``(n_blocks,)``: Σ_k expected cut / expected volume of side k.

    Edges count 1 and nodes their degree, as in :mod:`agglo_core.graph.functionals`.
    """
    Y = torch.softmax(logits, dim=1)
    degrees = neighbours.degrees(Y.dtype)
    cuts = neighbours.block_sums(Y * (degrees - neighbours.sum(Y)))
    volumes = neighbours.block_sums(degrees * Y)
    return (cuts / volumes.clamp(min=torch.finfo(Y.dtype).tiny)).sum(dim=1)
