"""The fast model: a small graph network on a raster of each piece points to the cut. No torch."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.authoring import (
    Float,
    Graph,
    Int,
    OptionError,
    PieceGrowth,
    Target,
    UInt64,
    frozen_float,
    sweep_arrays,
)

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

    A block of at least 96 cells is rasterised in its principal frame. Two SAGE layers on the
    raster, pooled, and three dense ones give the direction of the cut; of the thresholds near the mean
    the one of least cost by :func:`agglo_core.graph.sweep.sweep` is taken. Blocks of fewer than 400 cells,
    or of equal cells, try their axes and diagonals as well, and the best of these directions turned
    by ± 22.5° and then ± 11.25°. Smaller blocks are swept along four axes, turned likewise from 16 and
    32 cells on. Neither side is ever empty, and no random numbers are used.

    Parameters
    ----------
    weights : path or mapping of arrays, optional
        A model file written by ``agglo train --preset fast``, or its arrays; default: those shipped.
    lookahead : int
        If positive: this many cuts of each block are tried by splitting both sides all the way to the
        size that is the target, and the one that leads to the fewest parts is taken. Much slower. A
        number of parts cannot be the target then; without a target there is nothing to look ahead to.

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
    ) -> None:
        if isinstance(lookahead, bool) or not isinstance(lookahead, int) or lookahead < 0:
            raise OptionError(f"gnn: lookahead must be a whole number, 0 or more, given {lookahead!r}")
        self.lookahead = lookahead
        self.net = _parameters(weights)
        self._h_star: float | None = None

    def for_target(self, target: Target) -> FastGNN:
        """This bisector, or one that looks ahead to the size that ``target`` asks for.

        Raises
        ------
        OptionError
            If it is to look ahead, and the target is a number of parts.
        """
        if not self.lookahead:
            return self
        if target.h_star is None:
            raise OptionError(
                "gnn: lookahead works with a target size, h_star, "
                f"not with a number of parts ({target.parts})"
            )
        ahead = copy(self)
        ahead._h_star = target.h_star
        return ahead

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Side of each node ``(n,)``; ``seeds`` are not used."""
        if level.dim != 2:
            raise OptionError(f"gnn: the model splits planar meshes; this one has dimension {level.dim}")
        if self._h_star is not None:
            from agglo_gnn.lookahead import look_ahead

            return look_ahead(level, self.fast_sides, self.lookahead, self._h_star)
        return self.fast_sides(level)

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """All splits of a run in one call, with the built-in refiner or none and the built-in fixer.

        Not when it looks ahead, nor in space, where there is nothing that it could do.
        """
        if self._h_star is not None or graph.dim != 2:
            return None
        from agglo_gnn.fast_kernels import split_fast

        return PieceGrowth.for_components(graph, pieces, partial(split_fast, self.net), refiners, fixer)

    def fast_sides(self, level: Graph) -> Int:
        """Side of each node ``(n,)``, without looking ahead."""
        from agglo_gnn.fast_kernels import bisect_fast

        sides: Int = bisect_fast(*sweep_arrays(level), self.net)
        return sides


def _parameters(weights: str | os.PathLike[str] | Mapping[str, Any] | None) -> tuple[Float, ...]:
    if weights is None:
        return _shipped()
    if isinstance(weights, Mapping):
        arrays: Mapping[str, Any] = weights
        wrong = [key for key, shape in SHAPES.items() if np.shape(arrays.get(key, 0.0)) != shape]
        if wrong or set(arrays) != set(SHAPES):
            raise OptionError(f"gnn: weights must be arrays named and shaped as {dict(SHAPES)}")
    elif isinstance(weights, str | os.PathLike):
        from agglo_gnn import model_file

        arrays, _ = model_file.load(Path(weights), architecture="fast", shapes=SHAPES)
    else:
        raise OptionError(f"gnn: weights must be a model file, given {weights!r}")
    return tuple(frozen_float(arrays[key]) for key in SHAPES)


@cache  # to read and check the file takes longer than to split a small mesh
def _shipped() -> tuple[Float, ...]:
    return _parameters(_SHIPPED)
