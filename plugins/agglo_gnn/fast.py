"""The fast model: a small graph network on a raster of each piece points to the cut. No torch."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, UInt64, frozen_float
from agglo_core.errors import OptionError
from agglo_core.graph import Graph

__all__ = ["SHAPES", "FastGNN"]

SHAPES: Mapping[str, tuple[int, ...]] = {
    "sage1.own": (4, 16), "sage1.near": (4, 16), "sage1.bias": (16,),
    "sage2.own": (16, 16), "sage2.near": (16, 16), "sage2.bias": (16,),
    "dense1.weight": (29, 48), "dense1.bias": (48,),
    "dense2.weight": (48, 48), "dense2.bias": (48,),
    "dense3.weight": (48, 2), "dense3.bias": (2,),
}  # fmt: skip
"""The parameters, in the order of the forward pass: 4,562 numbers."""

_SHIPPED = Path(__file__).parent / "weights" / "fast.safetensors"


class FastGNN:
    """Bisection by a learned direction and an exact sweep across it.

    A block of at least 48 cells is laid on a raster in its principal frame. Two SAGE layers on the
    raster, pooled, and three dense ones give the direction of the cut; of the thresholds near the mean
    the one that costs least by :func:`agglo_core.sweep.sweep` is taken. Blocks of fewer than 400 cells,
    or of equal cells, try their axes and diagonals as well. Smaller blocks are swept along four
    axes, as the bisector ``sweep`` does along eight. Both sides are never empty, and no random numbers.

    Parameters
    ----------
    weights : path or mapping of arrays, optional
        A model file written by ``agglo train --preset fast``, or its arrays; default: those shipped.
    lookahead : int
        If positive: this many cuts of each block are tried by splitting both sides all the way to
        ``h_star``, and the one that leads to the fewest parts is taken. Much slower.
    h_star : float, optional
        Largest diameter of a part, for ``lookahead``.

    Raises
    ------
    FileError
        If the model file is missing, corrupt or of another architecture.
    OptionError
        If an option makes no sense, or the graph is not planar.
    """

    def __init__(
        self,
        weights: str | os.PathLike[str] | Mapping[str, Any] | None = None,
        lookahead: int = 0,
        h_star: float | None = None,
    ) -> None:
        if isinstance(lookahead, bool) or not isinstance(lookahead, int) or lookahead < 0:
            raise OptionError(f"gnn: lookahead must be a whole number, 0 or more, given {lookahead!r}")
        if lookahead and not (h_star is not None and 0 < h_star < np.inf):
            raise OptionError(
                f"gnn: lookahead needs h_star, the largest diameter of a part; given {h_star!r}"
            )
        self.lookahead = lookahead
        self.h_star = h_star
        self.net = _parameters(weights)

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Side of each node ``(n,)``; ``seeds`` are not used."""
        if level.dim != 2:
            raise OptionError(f"gnn: the model splits planar meshes; this one has dimension {level.dim}")
        if self.lookahead:
            from agglo_gnn.lookahead import look_ahead

            assert self.h_star is not None
            return look_ahead(level, self.fast_sides, self.lookahead, self.h_star)
        return self.fast_sides(level)

    def fast_sides(self, level: Graph) -> Int:
        """Side of each node ``(n,)``, without looking ahead."""
        from agglo_gnn.fast_kernels import bisect_fast

        sides: Int = bisect_fast(
            level.offsets,
            level.indptr,
            level.indices,
            level.interface,
            level.centroids,
            level.weights,
            level.measures,
            self.net,
        )
        return sides


def _parameters(weights: str | os.PathLike[str] | Mapping[str, Any] | None) -> tuple[Float, ...]:
    if isinstance(weights, Mapping):
        arrays: Mapping[str, Any] = weights
        wrong = [key for key, shape in SHAPES.items() if np.shape(arrays.get(key, 0.0)) != shape]
        if wrong or set(arrays) != set(SHAPES):
            raise OptionError(f"gnn: weights must be arrays named and shaped as {dict(SHAPES)}")
    elif weights is None or isinstance(weights, str | os.PathLike):
        from agglo_gnn import model_file

        arrays, _ = model_file.load(Path(weights or _SHIPPED), architecture="fast", shapes=SHAPES)
    else:
        raise OptionError(f"gnn: weights must be a model file, given {weights!r}")
    return tuple(frozen_float(arrays[key]) for key in SHAPES)
