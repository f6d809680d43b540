"""The bisector ``gnn``: a small graph network on each block's raster chooses the cut, without torch."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.authoring import Float, Graph, Int, OptionError, Target, UInt64, frozen_float
from agglo_core.graph.sweep import sweep_arrays
from agglo_core.split.piece_growth import PieceGrowth
from agglo_gnn.space.network import SPATIAL_SHAPES

SHAPES: Mapping[str, tuple[int, ...]] = {
    "sage1.own": (4, 16), "sage1.near": (4, 16), "sage1.bias": (16,),
    "sage2.own": (16, 16), "sage2.near": (16, 16), "sage2.bias": (16,),
    "dense1.weight": (29, 48), "dense1.bias": (48,),
    "dense2.weight": (48, 48), "dense2.bias": (48,),
    "dense3.weight": (48, 2), "dense3.bias": (2,),
}  # fmt: skip
"""Parameter shapes in the order of the forward pass: 4,562 numbers."""

_WEIGHTS = Path(__file__).parents[1] / "weights"  # folder of the shipped models
_MODELS = {2: ("fast", SHAPES), 3: ("fast3d", SPATIAL_SHAPES)}  # file name and parameter shapes by dimension


class FastGNN:
    """Bisect at the best threshold along a direction that a small neural network predicts.

    In 2-D a block of at least 400 cells is rasterised in its principal frame. Two SAGE layers on the
    raster, pooling and three dense layers give the cut direction. The threshold near the mean with the
    lowest cost is chosen by :func:`agglo_core.graph.sweep.sweep`. Smaller blocks try their axes and
    diagonals instead, blocks of equal cells try them in addition, and both then try the best of these
    directions rotated by ± 22.5°. Below 96 cells all thresholds are tried, and rotated directions from 24
    cells on.

    In 3-D a network of two dense layers evaluates the block moments, up to the fourth: it scores the three
    principal axes and tilts each. The block is swept along the best axis, and along axes with nearly equal
    scores.

    Neither side is ever empty, and no random numbers are used.

    Parameters
    ----------
    weights : path or mapping of arrays, optional
        A model file written by ``agglo train --preset fast`` or ``fast3d``, or its arrays, for meshes with
        its dimension; by default the shipped models, for both dimensions.
    lookahead : int
        If positive, this many cuts are tried for each block by splitting both sides down to the target
        size, and the cut with the fewest parts is chosen. Much slower. The target must then be a size, not
        a part count; without a target, lookahead has no effect. 2-D only.

    Raises
    ------
    FileError
        If the model file is missing, corrupt or has another architecture.
    OptionError
        For an invalid option, or weights for the other dimension.
    """

    needs_points = True

    def __init__(
        self,
        weights: str | os.PathLike[str] | Mapping[str, Any] | None = None,
        lookahead: int = 0,
    ) -> None:
        if isinstance(lookahead, bool) or not isinstance(lookahead, int) or lookahead < 0:
            raise OptionError(f"gnn: lookahead must be a whole number, 0 or more, given {lookahead!r}")
        self.lookahead = lookahead
        self._nets = {} if weights is None else _parameters(weights)
        self._h_star: float | None = None

    def for_target(self, target: Target) -> FastGNN:
        """Return this bisector, or with lookahead a copy for the target size.

        Raises
        ------
        OptionError
            If lookahead is set, and the target is a part count.
        """
        if not self.lookahead:
            return self
        if target.h_star is None:
            raise OptionError(
                "gnn: lookahead needs a target size, h_star or h_factor, "
                f"given a number of parts ({target.parts})"
            )
        ahead = copy(self)
        ahead._h_star = target.h_star
        return ahead

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Return each node's side ``(n,)``, independent of the ``seeds``."""
        if self._h_star is not None:
            if level.dim != 2:
                raise OptionError("gnn: lookahead works in 2-D only, given a 3-D mesh")
            from agglo_gnn.plane.lookahead import look_ahead

            return look_ahead(level, self.fast_sides, self.lookahead, self._h_star)
        return self.fast_sides(level)

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> PieceGrowth | None:
        """Perform all splits of a level in one compiled call.

        Returns None with lookahead, which needs the step-by-step path.

        Only the built-in refiner, or none, and the built-in fixer allow this.
        """
        if self._h_star is not None:
            return None
        if graph.dim == 2:
            from agglo_gnn.plane.kernels import split_fast as split
        else:
            from agglo_gnn.space.kernels import split_solids as split

        return PieceGrowth.for_components(graph, pieces, partial(split, self.net(graph.dim)), refiners, fixer)

    def fast_sides(self, level: Graph) -> Int:
        """Return each node's side ``(n,)``, always without lookahead."""
        if level.dim == 2:
            from agglo_gnn.plane.kernels import bisect_fast as bisect
        else:
            from agglo_gnn.space.kernels import bisect_solids as bisect

        sides: Int = bisect(*sweep_arrays(level), self.net(level.dim))
        return sides

    def net(self, dim: int) -> tuple[Float, ...]:
        """Return the network parameters for meshes with dimension ``dim``.

        Raises
        ------
        OptionError
            If weights for the other dimension were given.
        """
        if self._nets and dim not in self._nets:
            (other,) = self._nets
            raise OptionError(f"gnn: these weights are for {other}-D meshes, given a {dim}-D one")
        return self._nets[dim] if self._nets else _shipped_parameters(dim)


def _parameters(weights: str | os.PathLike[str] | Mapping[str, Any]) -> dict[int, tuple[Float, ...]]:
    """Return the network parameters in order, keyed by the mesh dimension that they are for."""
    if isinstance(weights, Mapping):
        arrays: Mapping[str, Any] = weights
        dim = 3 if set(arrays) == set(SPATIAL_SHAPES) else 2
        shapes = _MODELS[dim][1]
        wrong = [key for key, shape in shapes.items() if np.shape(arrays.get(key, 0.0)) != shape]
        if wrong or set(arrays) != set(shapes):
            raise OptionError(f"gnn: weights must be arrays with these names and shapes: {dict(shapes)}")
    elif isinstance(weights, str | os.PathLike):
        from agglo_gnn import model_file

        path = Path(weights)
        dim = 3 if model_file.read_header(path)["architecture"] == _MODELS[3][0] else 2
        architecture, shapes = _MODELS[dim]
        arrays, _ = model_file.load(path, architecture=architecture, shapes=shapes)
    else:
        raise OptionError(f"gnn: weights must be a model file or a mapping of arrays, given {weights!r}")
    return {dim: tuple(frozen_float(arrays[key]) for key in shapes)}


@cache  # reading and checking the file takes longer than splitting a small mesh
def _shipped_parameters(dim: int) -> tuple[Float, ...]:
    return _parameters(_WEIGHTS / f"{_MODELS[dim][0]}.safetensors")[dim]
