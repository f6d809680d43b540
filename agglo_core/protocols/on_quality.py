"""Protocols of metrics and report sections."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

from agglo_core.arrays import Float, Int

if TYPE_CHECKING:
    from agglo_core.graph import Graph
    from agglo_core.mesh import Mesh


@runtime_checkable
class QualityMetric(Protocol):
    """Component that assigns one number to each agglomerate.

    ``homogeneity`` is the power p of a length with which values scale in 2-D: 0 for ratios, 1 for lengths,
    perhaps a fraction. In 3-D ratios are also ratios. For p ≠ 0 lengths may become areas: a power from p to
    2 p.

    The following attributes are optional and false by default. ``undefined``: some agglomerates have no value
    (NaN); reports count them, and means exclude them. ``directional``: values depend on the directions of the
    axes. ``relative``: values depend on distant agglomerates, like diam(P) / h. ``shape_only``: values depend
    neither on an agglomerate's cells nor on the division of its outline into edges.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import QualityMetric
    >>> class CellCount:
    ...     better, bounds, homogeneity = "high", (1.0, np.inf), 0
    ...
    ...     def measure(self, mesh, labels):
    ...         return np.bincount(labels).astype(float)
    >>> isinstance(CellCount(), QualityMetric)
    True
    >>> CellCount().measure(agglo.samples.squares(2), np.array([0, 0, 0, 1]))
    array([3., 1.])
    """

    better: Literal["high", "low"]
    bounds: tuple[float, float]
    homogeneity: float

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the value per agglomerate, shape ``(k,)`` for labels ``0..k-1``."""


@runtime_checkable
class IncrementalMetric(Protocol):
    """Optional protocol: a metric that computes the effect of single moves, for refiners that optimise it.

    Its objective is the sum of the values over all parts, in the direction of ``better``.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import IncrementalMetric
    >>> class SquaredCount:
    ...     def changes(self, graph, labels, cells, parts):
    ...         count, old = np.bincount(labels), labels[cells]
    ...         return np.where(old == parts, 0.0, 2.0 * (count[parts] - count[old] + 1))
    >>> isinstance(SquaredCount(), IncrementalMetric)
    True
    >>> labels = np.array([0, 0, 0, 1])
    >>> SquaredCount().changes(agglo.samples.squares(2).graph, labels, np.array([2, 3]), np.array([1, 0]))
    array([-2.,  6.])
    """

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the change of the sum of all values ``(q,)`` by each move of one cell to another part.

        Move i takes ``cells[i]`` to ``parts[i]``, and leaves all other cells in place. ``labels (n,)`` number
        all blocks' parts, 0..k-1; ``cells`` and ``parts`` are ``(q,)``.
        """


@runtime_checkable
class Section(Protocol):
    """Section of the HTML report, omitted if its fragment is empty.

    Examples
    --------
    >>> from agglo_core.protocols import Section
    >>> class Size:
    ...     title = "Size"
    ...
    ...     def html(self, mesh, runs):
    ...         return f"<p>{mesh.n_cells} cells</p>"
    >>> isinstance(Size(), Section), Size().html(agglo.samples.squares(2), [])
    (True, '<p>4 cells</p>')
    """

    title: str

    def html(self, mesh: Mesh, runs: Sequence[Any]) -> str:
        """Return an HTML fragment about the runs (:class:`agglo_core.measure.RunResult`) on a mesh."""
