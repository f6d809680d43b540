"""``gnn_paper``: bisection by the paper's network, or by one of yours in its place."""

from __future__ import annotations

from pathlib import Path

import torch

from agglo_core.authoring import Float, Graph, ImportPath, Int, OptionError, UInt64, sweep
from agglo_gnn.paper.custom import filled
from agglo_gnn.paper.network import Neighbours, inorm

WEIGHTS = Path(__file__).parents[1] / "weights" / "paper.safetensors"
_PRECISIONS = {"double": torch.float64, "single": torch.float32}
_ROUNDINGS = ("threshold", "sweep")


class PaperGNN:
    """Bisection by the paper's graph neural network (§3): one forward pass per recursion depth.

    The network may put a whole piece on one side, most of all small pieces; the declared fallback then
    splits it, and the run counts that. Plane meshes only.

    Parameters
    ----------
    weights : str, optional
        Model file; by default the one that comes with agglo.
    network : str, optional
        ``module:Class`` of a network of yours (see :mod:`agglo_gnn.paper.custom`), with its ``weights``.
    rounding : str
        ``threshold``: the probability of side 1 is returned, and 0.5 decides, as in the paper;
        ``sweep``: the best threshold of the logits by :func:`agglo_core.graph.sweep.sweep`, never one-sided.
    precision : str
        ``double``, so that rounding errors decide nothing, or ``single``, about three times faster.

    Raises
    ------
    OptionError
        If a value is none of these, or the network cannot be imported.
    FileError
        If the weights cannot be used.
    """

    def __init__(
        self,
        weights: str | None = None,
        network: ImportPath | None = None,
        rounding: str = "threshold",
        precision: str = "double",
    ) -> None:
        if rounding not in _ROUNDINGS:
            raise OptionError(f"gnn_paper: rounding must be {' or '.join(_ROUNDINGS)}, given {rounding!r}")
        if precision not in _PRECISIONS:
            raise OptionError(f"gnn_paper: precision must be {' or '.join(_PRECISIONS)}, given {precision!r}")
        if network is not None and weights is None:
            raise OptionError(f"gnn_paper: network {network!r} needs weights=FILE, trained by agglo train")
        self.rounding, self._type = rounding, _PRECISIONS[precision]
        self._network = filled(network, WEIGHTS if weights is None else weights).to(self._type)

    def bisect_level(self, level: Graph, seeds: UInt64) -> Float | Int:
        """Probability of side 1 of each node ``(n,)``, or sides if swept; ``seeds`` are not used."""
        logits = self.logits(level)
        if self.rounding == "sweep":
            return sweep(level, logits)
        return torch.sigmoid(torch.from_numpy(logits)).numpy()

    def logits(self, level: Graph) -> Float:
        """Log of the odds of side 1 of each node ``(n,)``."""
        features = torch.from_numpy(inorm(level)).to(self._type)
        with torch.inference_mode():
            scores = self._network(features, Neighbours.of([level])).double()
        odds: Float = (scores[:, 1] - scores[:, 0]).numpy()
        return odds
