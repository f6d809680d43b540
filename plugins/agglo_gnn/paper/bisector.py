"""The bisector ``gnn_paper``, which uses the paper's network or a user-defined network."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from agglo_core.authoring import Float, Graph, ImportPath, Int, OptionError, Target, UInt64
from agglo_core.graph.sweep import sweep
from agglo_gnn.device.graph import DeviceGraph
from agglo_gnn.device.polish import mend, polish
from agglo_gnn.device.recursion import bisect_to_parts
from agglo_gnn.paper.custom import load_network
from agglo_gnn.paper.network import Neighbours, inorm, require_plane

WEIGHTS = Path(__file__).parents[1] / "weights" / "paper.safetensors"  # the shipped model
_PRECISIONS = {"double": torch.float64, "single": torch.float32}
_ROUNDINGS = ("threshold", "sweep")
_DEVICES = ("cpu", "cuda")


class PaperGNN:
    """Bisect by the paper's graph neural network (§3), evaluated once per recursion depth.

    The network may put a whole piece, in particular a small piece, on one side. The declared fallback then
    splits the piece, and the run counts these cases. 2-D meshes only.

    With ``method="kway"`` all steps of a level run on the device: inference for all pieces at a depth, exact
    part counts, connected parts and their polish. Refiners and the run's polish are then not used.

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
    device : str
        ``cpu``, or ``cuda`` for a GPU. Labels agree up to rounding in the network.

    Raises
    ------
    OptionError
        For any other value, or if the network cannot be imported.
    FileError
        If the weights cannot be used.
    """

    needs_points = True
    final_parts = True  # the k-way partition is polished already

    def __init__(
        self,
        weights: str | None = None,
        network: ImportPath | None = None,
        rounding: str = "threshold",
        precision: str = "double",
        device: str = "cpu",
    ) -> None:
        if rounding not in _ROUNDINGS:
            raise OptionError(f"gnn_paper: rounding must be {' or '.join(_ROUNDINGS)}, given {rounding!r}")
        if precision not in _PRECISIONS:
            raise OptionError(f"gnn_paper: precision must be {' or '.join(_PRECISIONS)}, given {precision!r}")
        if device not in _DEVICES:
            raise OptionError(f"gnn_paper: device must be {' or '.join(_DEVICES)}, given {device!r}")
        if device == "cuda" and not torch.cuda.is_available():
            raise OptionError("gnn_paper: device='cuda', but torch finds no CUDA device; use device='cpu'")
        if network is not None and weights is None:
            raise OptionError(f"gnn_paper: network {network!r} needs weights=FILE, trained by agglo train")
        self.rounding, self.device, self._type = rounding, device, _PRECISIONS[precision]
        loaded = load_network(network, WEIGHTS if weights is None else weights)
        self._network = loaded.to(device, self._type)

    def bisect_level(self, level: Graph, seeds: UInt64) -> Float | Int:
        """Return the probability of side 1 for each node ``(n,)``, or the sides with ``rounding="sweep"``.

        ``seeds`` are ignored.
        """
        logits = self.logits(level)
        if self.rounding == "sweep":
            return sweep(level, logits)
        return torch.sigmoid(torch.from_numpy(logits)).numpy()

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Partition a connected graph into ``target.parts`` connected parts, and return the labels ``(n,)``.

        ``seed`` is ignored.

        Raises
        ------
        OptionError
            Without ``target.parts``, with ``rounding="sweep"``, or for a 3-D graph.
        """
        if target.parts is None or target.parts < 1:
            raise OptionError(
                f"gnn_paper: partition needs a positive number of parts, given {target.parts!r}"
            )
        if self.rounding != "threshold":
            raise OptionError(
                f"gnn_paper: method='kway' needs rounding=threshold, given rounding={self.rounding}"
            )
        require_plane(graph)
        parts = min(target.parts, graph.n)
        with torch.inference_mode():
            on_device = DeviceGraph.of(graph, self.device)
            labels = bisect_to_parts(on_device, parts, self._odds)
            labels = polish(on_device, mend(on_device, labels, parts), parts)
        result: Int = labels.cpu().numpy()
        return result

    def logits(self, level: Graph) -> Float:
        """Return the log odds of side 1 against side 0 for each node ``(n,)``."""
        with torch.inference_mode():
            features = torch.from_numpy(inorm(level)).to(self.device)
            odds: Float = self._odds(features, Neighbours.of([level], self.device)).cpu().numpy()
        return odds

    def _odds(self, features: Tensor, neighbours: Neighbours) -> Tensor:
        scores: Tensor = self._network(features.to(self._type), neighbours).double()
        return scores[:, 1] - scores[:, 0]
