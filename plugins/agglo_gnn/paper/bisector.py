"""The bisector ``gnn_paper``, which uses the paper's network or a user-defined network."""

from __future__ import annotations

from pathlib import Path

import torch

from agglo_core.authoring import Float, Graph, ImportPath, Int, OptionError, UInt64
from agglo_core.graph.sweep import sweep
from agglo_gnn.paper.custom import load_network
from agglo_gnn.paper.network import Neighbours, inorm

WEIGHTS = Path(__file__).parents[1] / "weights" / "paper.safetensors"  # the shipped model
_PRECISIONS = {"double": torch.float64, "single": torch.float32}
_ROUNDINGS = ("threshold", "sweep")


class PaperGNN:
    """Bisect by the paper's graph neural network (§3), evaluated once per recursion depth.

    The network may put a whole piece, in particular a small piece, on one side. The declared fallback then
    splits the piece, and the run counts these cases. 2-D meshes only.

    Parameters
    ----------
    weights : str, optional
        Model file; by default the file shipped with agglo.
    network : str, optional
        User-defined network ``module:Class`` (see :mod:`agglo_gnn.paper.custom`); requires ``weights``.
    rounding : str
        ``threshold``: return the probability of side 1, cut at 0.5 as in the paper; ``sweep``: return the
        best logit threshold by :func:`agglo_core.graph.sweep.sweep`, never one-sided.
    precision : str
        ``double``, so that rounding errors have no influence, or ``single``, about three times faster.

    Raises
    ------
    OptionError
        For any other value, or if the network cannot be imported.
    FileError
        If the weights cannot be used.
    """

    needs_points = True

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
        self._network = load_network(network, WEIGHTS if weights is None else weights).to(self._type)

    def bisect_level(self, level: Graph, seeds: UInt64) -> Float | Int:
        """Return the probability of side 1 for each node ``(n,)``, or the sides with ``rounding="sweep"``.

        ``seeds`` are ignored.
        """
        logits = self.logits(level)
        if self.rounding == "sweep":
            return sweep(level, logits)
        return torch.sigmoid(torch.from_numpy(logits)).numpy()

    def logits(self, level: Graph) -> Float:
        """Return the log odds of side 1 against side 0 for each node ``(n,)``."""
        features = torch.from_numpy(inorm(level)).to(self._type)
        with torch.inference_mode():
            scores = self._network(features, Neighbours.of([level])).double()
        odds: Float = (scores[:, 1] - scores[:, 0]).numpy()
        return odds
