"""Protocols of constraints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from agglo_core.arrays import Int, Mask

if TYPE_CHECKING:
    from agglo_core.graph import Graph


@runtime_checkable
class Forbidding(Protocol):
    """A constraint on pairs of neighbours.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Forbidding
    >>> class Fault:
    ...     def forbidden(self, graph):
    ...         left = graph.centroids[:, 0] < 0.0  # of the middle of the mesh
    ...         return np.repeat(left, np.diff(graph.indptr)) != left[graph.indices]
    >>> isinstance(Fault(), Forbidding), int(Fault().forbidden(agglo.samples.squares(2).graph).sum())
    (True, 4)
    """

    def forbidden(self, graph: Graph) -> Mask:
        """Return ``(m,)``, for each CSR entry whether nothing may be joined across it; both directions agree.

        A part is connected without such edges; it may reach around the end of a barrier.
        """


@runtime_checkable
class Admitting(Protocol):
    """A constraint on what a part may hold; each piece of an admissible part must be admissible, too.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Admitting
    >>> class AtMostTwo:
    ...     def admissible(self, graph, labels):
    ...         return np.bincount(labels) <= 2
    >>> isinstance(AtMostTwo(), Admitting)
    True
    >>> AtMostTwo().admissible(agglo.samples.squares(2).graph, np.array([0, 0, 0, 1]))
    array([False,  True])
    """

    def admissible(self, graph: Graph, labels: Int) -> Mask:
        """Return ``(k,)``, for each part of ``labels (n,)`` whether it is allowed; others are split."""


@runtime_checkable
class Completing(Protocol):
    """A constraint on what a part should hold at least.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Completing
    >>> class AtLeastTwo:
    ...     def incomplete(self, graph, labels):
    ...         return np.bincount(labels) < 2
    >>> isinstance(AtLeastTwo(), Completing)
    True
    >>> AtLeastTwo().incomplete(agglo.samples.squares(2).graph, np.array([0, 0, 0, 1]))
    array([False,  True])
    """

    def incomplete(self, graph: Graph, labels: Int) -> Mask:
        """Return ``(k,)``, for each part whether it should join a neighbour, where nothing forbids it."""


Constraint = Forbidding | Admitting | Completing
"""A constraint has any of the three, or ``for_mesh(mesh)``, which returns such a one, if it needs faces."""
