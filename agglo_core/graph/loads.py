"""Node quantities of which each part of a run should have an equal amount: cells, measure, weights."""

from __future__ import annotations

from operator import getitem
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, exact_cast, frozen_float, owned, plain_array, trusted_copy
from agglo_core.errors import MeshError

Kind = Literal["cells", "measure", "weights"]


class Loads(NamedTuple):
    """Node quantities that a run balances between the parts.

    Subgraphs select from them, quotients add them up.

    Attributes
    ----------
    kind : "cells", "measure" or "weights"
        Quantity that the run balances.
    mass : (n,) float, optional
        This quantity plus a small share of the measure, to break ties. Default: the measures.
    cells : (n,) float, optional
        Mesh cells in each node. Default: 1.
    weights : (n,) float, optional
        Weights given to the run. Default: those of the graph.
    """

    kind: Kind = "cells"
    mass: Float | None = None
    cells: Float | None = None
    weights: Float | None = None

    def take(self, nodes: Any) -> Loads:
        """Return the quantities of selected nodes."""
        choose = getitem if isinstance(nodes, slice) else np.take  # faster than indexing
        return Loads(
            self.kind, *(None if each is None else frozen_float(choose(each, nodes)) for each in self[1:])
        )

    def added(self, labels: Int) -> Loads:
        """Return the quantities of agglomerates ``labels (n,)``, summed over their nodes."""
        counted = self._replace(cells=np.ones(len(labels)) if self.cells is None else self.cells)
        sums = (None if each is None else frozen_float(np.bincount(labels, each)) for each in counted[1:])
        return Loads(self.kind, *sums)


class Loaded:
    """Base class of :class:`~agglo_core.graph.Graph`: node quantities that a run balances."""

    if TYPE_CHECKING:
        measures: Float
        weights: Float

        @property
        def n(self) -> int: ...

    @property
    def mass(self) -> Float:
        """Node quantity ``(n,)`` in proportion to which the sides of a split receive their parts.

        By default the measures; a run may set another quantity (:meth:`with_mass`).
        """
        return self.measures if self.loads is None or self.loads.mass is None else self.loads.mass

    @property
    def loads(self) -> Loads | None:
        """Node quantities balanced in a run with a given part count.

        The value is None in other runs, and outside of runs.
        """
        return self.__dict__.get("_loads")

    def with_mass(self, mass: ArrayLike) -> Self:
        """Return this graph with another :attr:`mass`, which subgraphs and quotients inherit."""
        values = owned(exact_cast(plain_array(mass, "mass"), np.float64, "mass"))
        if (
            values.shape != (self.n,)
            or not 0.0 <= values.min(initial=0.0) <= values.max(initial=0.0) < np.inf
        ):
            raise MeshError(f"mass must be {self.n} finite, non-negative numbers; given shape {values.shape}")
        return self.with_loads(Loads(mass=frozen_float(values)))

    def with_loads(self, loads: Loads | None) -> Self:
        """Return this graph with other :attr:`loads`, which subgraphs and quotients inherit."""
        made = trusted_copy(self)
        made.__dict__["_loads"] = loads
        return made

    def node_sizes(self, kind: Kind | None = None) -> Float:
        """Return each node's contribution ``(n,)`` to the size of its part.

        Parameters
        ----------
        kind : "cells", "measure" or "weights", optional
            Cell count, measure, or the run weights (else the graph weights). Default: the quantity
            balanced by the run, or cells outside of runs by count.
        """
        loads = self.loads or Loads()
        kind = kind or loads.kind
        if kind == "measure":
            return self.measures
        if kind == "weights":
            return self.weights if loads.weights is None else loads.weights
        return frozen_float(np.ones(self.n)) if loads.cells is None else loads.cells
